"""The picture of the viewer in the README, from the recording of `surefoot demo`.

`python docs/viewer_picture.py out/demo` (or `make readme`, which runs the demo first). It needs a
Vulkan driver, on Debian mesa-vulkan-drivers, and no screen.
"""

import os
import sys
import time
from pathlib import Path

from rerun.experimental import ViewerClient

PICTURE = Path(__file__).resolve().parent / "viewer.png"
MOMENT = 38.0
"""s of the walk: the robot steps onto the second slippery patch."""
PATIENCE = 60.0
"""s until the recording is loaded."""


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
    draw(Path(sys.argv[1]) / "walk.rrd")
