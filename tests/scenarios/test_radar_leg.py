"""The perceptive reference: what the radar adds to the legs, and where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from courses import course_file
from estimates import metrics_of
from refusals import refused

from surefoot import Log, Scenario, walk
from surefoot.scenarios.estimate import radar_velocity as module
from surefoot.scenarios.estimate.radar_velocity import radar_velocity
from surefoot.scenarios.estimate.run import Learnt, run_all, run_filter


@pytest.fixture(scope="module")
def course(tmp_path_factory):
    folder = tmp_path_factory.mktemp("course")
    return course_file(folder, 6.0, "turn = 0.2\n[ground]\nmu = 0.8\n", "radar_test")


@pytest.fixture(scope="module")
def log(course, robot) -> Log:
    return walk(Scenario.load(course), robot, 1)


@pytest.fixture
def known(monkeypatch, course):
    """The test's course, as if it were a bundled one."""
    monkeypatch.setattr(module, "_scenarios", lambda: {"radar_test": course})


def test_velocities_are_those_of_the_walk_within_their_covariances(known, log, robot):
    rows, v_I, cov = radar_velocity(log, robot)
    true = np.einsum("nji,nj->ni", log.ref_R_GI[rows], log.ref_v[rows])
    error = v_I - true
    assert len(rows) > 0.9 * (log.t[-1] - log.t[0]) / 0.055
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.1
    assert np.abs(error.mean(axis=0)).max() < 0.02
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(cov), error)
    assert 1.0 < nees.mean() < 6.0


def test_without_a_foot_on_the_ground_the_radar_carries_the_estimate(known, log, robot):
    blind = log.with_columns({f"contact_{leg}": np.zeros(len(log.t)) for leg in log.legs})
    radar, leg = (metrics_of(name, blind, robot) for name in ("radar_leg", "leg"))
    assert metrics_of("radar_leg", log, robot).ape_trans < 0.1
    assert radar.ape_trans < 0.25
    assert radar.velocity < 0.3 * leg.velocity


def test_a_log_without_a_world_is_left_out_with_the_reason(log, robot):
    refused("radar_leg: needs a radar", run_filter, "radar_leg", log, robot)
    measured = Log(log.frame, replace(log.meta, scenario=None, seed=None))
    results, left_out = run_all(measured, robot, Learnt(), ["leg", "radar_leg"])
    assert [r.filter for r in results] == ["leg"]
    assert "needs a radar" in left_out["radar_leg"]


def test_a_log_whose_reference_is_valid_nowhere_is_left_out_with_the_reason(known, log, robot):
    unseen = replace(log, frame=log.frame.assign(ref_ok=0.0))
    refused(r"radar_leg: .*ref_ok is 0", run_filter, "radar_leg", unseen, robot)


def test_bundled_courses_are_known_by_name():
    module._scenarios.cache_clear()
    assert {"Atrium", "RoomScan", "demo_walk"} <= set(module._scenarios())
