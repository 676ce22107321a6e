"""What tests of this folder share: an arc that is drawn, and walks with what is learnt of them."""

from dataclasses import replace

import pytest
from arc_walk import Walk, make_walk

from surefoot import CalibrateSettings, Learnt, Log, Scenario, TrainSettings, calibrate, train
from surefoot.extend import Ground, Patch, Ranges, Segment
from surefoot.scenarios.datasets import kept_walks
from surefoot.sim.walk import walk as simulated

SEGMENTS = (Segment(4.0, 0.6), Segment(3.0, 0.4, turn=0.5), Segment(3.0, 0.5, turn=-0.5))


@pytest.fixture(scope="session")
def walk() -> Walk:
    return make_walk(seconds=4.0)


@pytest.fixture(scope="session")
def course() -> Scenario:
    ground = Ground(0.8, (Patch(3.0, 0.0, 1.0, 2.0, 0.2),))
    return Scenario("short", SEGMENTS, ground, ranges=Ranges(speed=(0.9, 1.1)), laps=2)


@pytest.fixture(scope="session")
def walks(robot, course) -> list[Log]:
    """To learn from, to calibrate on and to test with."""
    return [replace(simulated(course, robot, seed), name=f"walk{seed}") for seed in range(3)]


@pytest.fixture(scope="session")
def learnt(walks) -> Learnt:
    """An observer of each loss, barely trained, with its bounds."""
    short = TrainSettings(steps=60, batch=4, every=20, seed=0)
    observers = tuple(train(walks[0], settings=replace(short, loss=x)) for x in ("mse", "gml"))
    how = CalibrateSettings(K=20)
    return Learnt(observers, tuple(calibrate(one, walks[1], how) for one in observers))


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    """Walks are kept in a folder of the test."""
    monkeypatch.setattr(kept_walks, "cache_folder", lambda: tmp_path / "cache")
