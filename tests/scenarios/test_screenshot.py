"""The recording as the viewer draws it, by a software renderer, without a screen."""

import os
import socket
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arc_walk import Walk
from matplotlib.image import imread
from rerun.experimental import ViewerClient

from surefoot.scenarios.reporting.palette import OBSERVER, estimator_color, friction_color, rgba
from surefoot.scenarios.viewer.recording import RecordedWalk, write_recording
from surefoot.sim.ground.ground_metadata import ground_metadata
from surefoot.sim.ground.terrain import Ground, Strip

pytestmark = pytest.mark.pictures

PATIENCE = 60.0  # s
NO_DRIVER = "the viewer cannot draw here; try the Debian package mesa-vulkan-drivers"


@pytest.fixture
def viewer(monkeypatch, tmp_path) -> Iterator[ViewerClient]:
    """A headless viewer on a free port of 127.0.0.1; skips where it cannot draw its own window."""
    # The viewer lies beside this Python, which need not be on the path.
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    try:
        client = ViewerClient.spawn(headless=True, port=port)
        client.save_screenshot(str(tmp_path / "empty.png"))
    except Exception as error:  # for want of a graphics driver
        pytest.skip(f"{NO_DRIVER} ({str(error)[:200]})")
    with client:
        yield client


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
    write_recording(recording, RecordedWalk(*walk), tab="Overview")
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
    for name, ground in (("level", Ground(0.8)), ("course", Ground(0.8, (), 20, strips))):
        recording = tmp_path / f"{name}.rrd"
        meta = replace(walk.log.meta, model=ground_metadata(ground))
        write_recording(recording, RecordedWalk(replace(walk.log, meta=meta), *walk[1:3]))
        images.append(picture(viewer, recording, 2.0, tmp_path / f"{name}.png"))
    level, course = images
    scene = np.s_[:, : level.shape[1] // 2]
    changed = np.abs(level[scene] - course[scene]).max(axis=2) > 20
    assert changed.mean() > 0.05, "the terrain does not show"
    icy = [near(image[scene], friction_color(0.3), 45) for image in images]
    assert icy[1] > icy[0] + 500, "no bumps in the colour of their friction"
