"""From walks to a table: what must hold for the whole path, on short walks and little training."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from surefoot.models.calibration.calibrate import calibrate
from surefoot.models.calibration.settings import CalibrateSettings
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train
from surefoot.scenarios.compare import compare_log, table, write_comparison
from surefoot.scenarios.demo import demo
from surefoot.scenarios.estimate.run import ESTIMATORS, Learnt, run_filter
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground, Patch
from surefoot.sim.log import Log
from surefoot.sim.scenario import Ranges, Scenario, Segment
from surefoot.sim.walk import walk

SEGMENTS = (Segment(4.0, 0.6), Segment(3.0, 0.4, turn=0.5), Segment(3.0, 0.5, turn=-0.5))
SHORT = TrainSettings(steps=60, batch=4, every=20)
TIMING = "step [us]"


@pytest.fixture(scope="module")
def walks(robot) -> list[Log]:
    ground = Ground(0.8, (Patch(3.0, 0.0, 1.0, 2.0, 0.2),))
    ranges = Ranges(speed=(0.9, 1.1))
    scenario = Scenario("short", SEGMENTS, ground, ranges=ranges, laps=2)
    return [replace(walk(scenario, robot, seed), name=f"walk{seed}") for seed in range(3)]


def learn(walks: list[Log]) -> Learnt:
    observers = tuple(
        train(walks[0], settings=replace(SHORT, loss=loss, seed=0)) for loss in ("mse", "gml")
    )
    return Learnt(
        observers, tuple(calibrate(o, walks[1], CalibrateSettings(K=20)) for o in observers)
    )


@pytest.fixture(scope="module")
def learnt(walks) -> Learnt:
    return learn(walks)


@pytest.fixture(scope="module")
def compared(walks, robot, learnt):
    return compare_log(walks[2], robot, learnt)


def test_every_filter_runs_and_stays_near_the_truth(compared):
    """With an observer that is barely trained: all beat the IMU alone, and report themselves."""
    assert set(compared.left_out) == {"radar_leg"}  # this course is not a bundled one
    found = table([compared])
    assert list(found["filter"]) == [name for name in ESTIMATORS if name != "radar_leg"]
    errors = dict(zip(found["filter"], found["APE_trans [m]"], strict=True))
    assert all(error < errors["imu"] for name, error in errors.items() if name != "imu")
    assert errors["leg"] < 0.1
    shares = dict(zip(found["filter"], found["pi<gamma [%]"], strict=True))
    assert all(0 <= shares[name] <= 100 for name in ("coverage", "coverage_gml"))
    assert sum(isinstance(held, str) for held in found["coverage [%]"]) == 2


def test_outputs_are_whole_and_never_overwritten(compared, tmp_path):
    write_comparison([compared], tmp_path, "title")
    for name in ("table.md", "table.csv", "report.html", "walk2.rrd"):
        assert (tmp_path / name).stat().st_size > 100
    assert len(list((tmp_path / "figures").glob("*.png"))) == 5
    refused("force=True", write_comparison, [compared], tmp_path, "title")


def test_an_mse_observer_is_refused_where_a_covariance_is_needed(walks, robot, learnt):
    mse = Learnt(learnt.observers[:1], learnt.bounds[:1])
    refused(r"loss gml, .*covariance; given: mse", run_filter, "velocity", walks[2], robot, mse)


def test_bounds_of_another_observer_are_refused(walks, robot, learnt):
    mixed = Learnt(learnt.observers[:1], learnt.bounds[1:])
    refused("another observer", run_filter, "coverage", walks[2], robot, mixed)


def test_coverage_holds_exactly_the_bounds_it_was_given(compared, learnt):
    result = next(r for r in compared.results if r.filter == "coverage")
    updates = result.trajectory.updates
    assert updates is not None
    assert np.array_equal(np.unique(updates.epsilon, axis=0), learnt.bounds[0].epsilon[None])
    assert np.array_equal(updates.active, updates.pi < learnt.bounds[0].gamma)


def test_a_declared_effect_is_part_of_the_filters_model(robot):
    """A known encoder offset costs the leg filter little, the same one kept quiet a lot."""
    scenario = Scenario("short", SEGMENTS, Ground(0.8))
    offset = effect("encoder_offset", "FL_thigh", 0.04)
    errors = {}
    for declared in (True, False):
        log = walk(scenario, robot, 0, [offset], declared)
        metrics = run_filter("leg", log, robot).metrics
        assert metrics is not None
        errors[declared] = metrics.ape_trans
    assert errors[True] < 0.5 * errors[False]


@pytest.mark.slow
def test_the_demo_gives_the_same_table_twice(tmp_path):
    first, second = (demo(tmp_path / name, seed=1) for name in ("a", "b"))
    assert first.drop(columns=TIMING).equals(second.drop(columns=TIMING))
    traces = [(tmp_path / name / "trace" / "trace.json").read_text() for name in ("a", "b")]
    assert traces[0] == traces[1]
