"""Feet on ground that gives: a model that knows of it is told where they are."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from models.candidates import case_of
from models.residual import residual
from models.sinking import landings, since_landing, sinking
from sim.effects import effect
from sim.robot import Robot
from sim.scenario import Scenario, Segment
from sim.terrain import Ground
from sim.walk import walk

ROBOT = Robot.load("spot_class")


def test_time_runs_from_each_landing_and_not_from_the_first_row():
    t = 0.1 * np.arange(8)
    contact = np.array([[1, 1, 0, 0, 1, 1, 0, 1]], dtype=bool).T
    assert_array_equal(landings(t, contact[:, 0]), [4, 7])
    expected = [np.nan, np.nan, np.nan, np.nan, 0.0, 0.1, np.nan, 0.0]
    assert_allclose(since_landing(t, contact)[:, 0], expected, atol=1e-12)


def test_a_foot_that_bounces_has_not_landed_again():
    t = 0.02 * np.arange(9)
    contact = np.array([[1, 0, 0, 0, 0, 1, 0, 1, 1]], dtype=bool).T
    assert_array_equal(landings(t, contact[:, 0]), [5])
    assert_allclose(since_landing(t, contact)[7:, 0], [0.04, 0.06], atol=1e-12)


def test_a_model_that_knows_of_soft_ground_finds_the_feet_where_they_are():
    soft = effect("soft_ground", "all", 0.03)
    course = Scenario("soft", (Segment(8.0, 0.5, turn=0.3),), Ground(0.8))
    log = walk(course, ROBOT, 4, [soft], declared=False)
    case = case_of(log, ROBOT)
    _, known = soft.explain(log, ROBOT)
    before, after = (
        residual(log, r, replace(case.frame, level=True)).table for r in (ROBOT, known)
    )
    spread = [np.nanstd(table[:, 18:22]) for table in (before, after)]
    assert spread[1] < 0.5 * spread[0]
    speed = [np.sqrt(np.nanmean(table[:, 6:18] ** 2)) for table in (before, after)]
    assert speed[1] < 0.7 * speed[0]
    depth, _ = sinking(log, known, case.frame)
    assert np.all(depth >= 0.0)
