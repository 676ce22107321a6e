"""The picture of the viewer in the README, from the walk of `surefoot demo`.

`python docs/viewer_picture.py out/demo` (or `make readme`, which runs the demo first). It needs a
Vulkan driver, on Debian mesa-vulkan-drivers, and no screen.
"""

import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from rerun.experimental import ViewerClient

import surefoot
from surefoot.scenarios.compare import compare_log
from surefoot.scenarios.estimate.estimators import ESTIMATORS, traits
from surefoot.scenarios.estimate.inputs import learnt_from
from surefoot.scenarios.viewer.recording import write_recording

PICTURE = Path(__file__).resolve().parent / "viewer.png"
MOMENT = 38.0
"""s of the walk: the robot steps onto the second slippery patch."""
PATIENCE = 60.0
"""s until the recording is loaded."""


def overview(demo: Path, path: Path) -> None:
    """Write the recording of the demo's walk once more, to open at its overview."""
    log = surefoot.Log.read(demo / "logs" / "walk.parquet")
    robot = surefoot.Robot.for_log(log)
    learnt = learnt_from(
        (demo / "observer_mse.safetensors", demo / "observer_gml.safetensors"),
        (demo / "bounds_mse.json", demo / "bounds_gml.json"),
    )
    drawn = [name for name in ESTIMATORS if traits(name).drawn]
    walk = compare_log(log, robot, learnt, drawn).recorded()
    assert walk is not None
    write_recording(path, walk, tab="Overview")


def draw(recording: Path) -> None:
    """Open the recording in a headless viewer and save its window."""
    # The viewer lies beside this Python, which need not be on the path.
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    client = ViewerClient.spawn(headless=True)
    client.open(str(recording))
    deadline = time.monotonic() + PATIENCE
    while client.get_state().loading or not client.get_state().recordings:
        if time.monotonic() > deadline:
            raise SystemExit(f"{recording}: not loaded within {PATIENCE:g} s")
        time.sleep(0.2)
    client.set_time("time", duration=MOMENT, play_state="paused")
    time.sleep(2.0)
    client.save_screenshot(str(PICTURE))


if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        made = Path(folder) / "walk.rrd"
        overview(Path(sys.argv[1]), made)
        draw(made)
