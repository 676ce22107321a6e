"""The recording as the viewer draws it, by a software renderer, without a screen."""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import Walk
from matplotlib.image import imread
from rerun.experimental import ViewerClient

from scenarios.palette import OBSERVER, estimator_color, friction_color, rgba
from scenarios.recording import write_recording
from sim.terrain import Ground, Strip

PATIENCE = 60.0  # s


@pytest.fixture
def viewer(tmp_path):
    """A headless viewer on a free port of 127.0.0.1; skips where there is nothing to draw with."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [
        sys.executable,
        "-m",
        "rerun",
        "--headless",
        "--bind",
        "127.0.0.1",
        "--port",
        str(port),
    ]
    errors = tmp_path / "viewer.log"
    with errors.open("w") as stream:
        # A process group of its own: the launcher's child is the viewer.
        process = subprocess.Popen(
            [*command, "--window-size", "1280x720"], stdout=stream, stderr=stream,
            env={**os.environ, "RUST_LOG": "error"},
            start_new_session=True,
        )  # fmt: skip
    try:
        yield connected(process, port, errors)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, 9)
        process.wait()


def connected(process: subprocess.Popen, port: int, errors: Path) -> ViewerClient:
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        if process.poll() is not None:
            reason = errors.read_text().strip().splitlines() or ["no message"]
            pytest.skip(f"the viewer cannot draw here (mesa-vulkan-drivers?): {reason[-1][:200]}")
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
            return client
        except Exception:
            time.sleep(0.3)
    pytest.skip(f"the headless viewer did not answer within {PATIENCE:.0f} s")


def picture(client: ViewerClient, recording: Path, t: float, path: Path) -> np.ndarray:
    """The viewer's window (rows, columns, 3) in 0..255 at time t of the recording."""
    client.open(str(recording))
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        state = client.get_state()
        if state.recordings and not state.loading:
            break
        time.sleep(0.2)
    client.set_time("time", duration=t, play_state="paused")
    time.sleep(1.0)
    client.save_screenshot(str(path))
    return np.round(255 * imread(path)[:, :, :3]).astype(int)


def near(image: np.ndarray, color: str, tolerance: int = 30) -> int:
    """How many pixels have about that colour."""
    return int((np.abs(image - np.array(rgba(color)[:3])) <= tolerance).all(axis=2).sum())


def test_the_picture_shows_robot_ground_estimates_and_series(viewer, walk: Walk, tmp_path):
    recording = tmp_path / "walk.rrd"
    write_recording(
        recording, walk.log, walk.robot, walk.trajectories, walk.prediction, walk.bounds,
        ground=Ground(0.8, walk.patches),
    )  # fmt: skip
    image = picture(viewer, recording, 2.0, tmp_path / "walk.png")
    rows, columns, _ = image.shape
    scene, plots = image[:, : columns // 2], image[:, columns // 2 :]
    assert image.std() > 20, "blank"
    assert near(scene, friction_color(0.8)) > 0.05 * rows * columns / 2, "no floor"
    assert near(scene, friction_color(0.2)) > 500, "no slippery patch"
    assert near(scene, "#EDB833", 50) > 200, "no robot in its yellow shell"
    for name in walk.trajectories:
        assert near(scene, estimator_color(name)) > 50, f"{name} is not in the scene"
        assert near(plots, estimator_color(name)) > 50, f"{name} is not in the plots"
    assert near(plots, OBSERVER) > 50, "no observer in the plots"


def test_stairs_slopes_and_bumps_are_in_the_picture(viewer, walk: Walk, tmp_path):
    """The same walk twice from the same eye: level ground hides what terrain shows."""
    rough = Strip((-1.0, 3.6), (3.0, 3.6), 1.6, rough=0.12, mu=0.3)
    strips = (
        Strip((2.2, 2.0), (3.4, 2.0), 1.6, heights=(0.0, 0.6), steps=4),
        Strip((3.4, 2.0), (5.0, 2.0), 1.6, heights=(0.6, 0.6)),
        Strip((-1.0, 0.0), (1.5, 0.0), 1.6, heights=(0.0, 0.5)),
        Strip((1.5, 0.0), (3.0, 0.0), 1.6, heights=(0.5, 0.5)),
        rough.roughened(np.random.default_rng(0)),
    )
    images = []
    for name, ground in (("level", Ground(0.8)), ("course", Ground(0.8, walk.patches, 20, strips))):
        recording = tmp_path / f"{name}.rrd"
        write_recording(recording, walk.log, walk.robot, walk.trajectories, ground=ground)
        images.append(picture(viewer, recording, 2.0, tmp_path / f"{name}.png"))
    level, course = images
    scene = np.s_[:, : level.shape[1] // 2]
    changed = np.abs(level[scene] - course[scene]).max(axis=2) > 20
    assert changed.mean() > 0.05, "the terrain does not show"
    icy = [near(image[scene], friction_color(0.3), 45) for image in images]
    assert icy[1] > icy[0] + 500, "no bumps in the colour of their friction"
