"""From walks to a table: what must hold for the whole path, on short walks and little training."""

import numpy as np
import pytest
from estimates import metrics_of
from refusals import refused

from surefoot.scenarios.compare import compare_log, table, write_comparison
from surefoot.scenarios.demo import demo
from surefoot.scenarios.estimate.run import ESTIMATORS, Learnt, run_filter
from surefoot.sim.effects import effect
from surefoot.sim.walk import walk

TIMING = "step [us]"


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
    assert "Left out: imu, whose errors" in (tmp_path / "report.html").read_text()
    refused("force=True", write_comparison, [compared], tmp_path, "title")


def test_an_mse_observer_is_refused_where_a_covariance_is_needed(walks, robot, learnt):
    mse = Learnt(learnt.observers[:1], learnt.bounds[:1])
    refused(r"loss gml, .*covariance; given: mse", run_filter, "velocity", walks[2], robot, mse)


def test_coverage_holds_exactly_the_bounds_it_was_given(compared, learnt):
    result = next(r for r in compared.results if r.filter == "coverage")
    updates = result.trajectory.updates
    assert updates is not None
    assert np.array_equal(np.unique(updates.epsilon, axis=0), learnt.bounds[0].epsilon[None])
    assert np.array_equal(updates.active, updates.pi < learnt.bounds[0].gamma)


def test_a_declared_effect_is_part_of_the_filters_model(robot, course):
    """A known encoder offset costs the leg filter little, the same one kept quiet a lot."""
    offset = effect("encoder_offset", "FL_thigh", 0.04)
    known, hidden = (walk(course, robot, 0, [offset], declared) for declared in (True, False))
    error = metrics_of("leg", known, robot).ape_trans
    assert error < 0.5 * metrics_of("leg", hidden, robot).ape_trans


@pytest.mark.slow
def test_the_demo_gives_the_same_table_twice(tmp_path):
    first, second = (demo(tmp_path / name, seed=1) for name in ("a", "b"))
    assert first.drop(columns=TIMING).equals(second.drop(columns=TIMING))
    traces = [(tmp_path / name / "trace" / "trace.json").read_text() for name in ("a", "b")]
    assert traces[0] == traces[1]
