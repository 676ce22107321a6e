"""The commanded course: it obeys its ramps, integrates its velocity, ends where it should."""

import numpy as np
import pytest
from ground_course import whole_course

from surefoot.sim.gait.course import ACCELERATION, TURN_ACCELERATION
from surefoot.sim.scenario import Segment

DT = 0.004


def test_velocity_obeys_the_ramps_and_ends_at_rest():
    course = whole_course((Segment(3, 1.0), Segment(2, 0.2, 0.1, -1.0), Segment(1, -0.3)), DT, 1.0)
    rates = np.diff(course.velocity, axis=0) / DT
    assert np.abs(rates[:, :2]).max() <= ACCELERATION + 1e-9
    assert np.abs(rates[:, 2]).max() <= TURN_ACCELERATION + 1e-9
    assert not course.velocity[:200].any()
    np.testing.assert_allclose(course.velocity[-1], 0.0, atol=1e-12)


def test_pose_is_the_integral_of_the_velocity():
    course = whole_course((Segment(3, 0.8, 0.1, 0.4), Segment(2, 0.4, 0.0, -0.9)), DT, 0.5)
    yaw = course.pose[:, 2]
    c, s = np.cos(yaw[1:]), np.sin(yaw[1:])
    forward, lateral, turn = course.velocity[1:].T
    step = np.diff(course.pose, axis=0) / DT
    np.testing.assert_allclose(step[:, 0], c * forward - s * lateral, atol=1e-12)
    np.testing.assert_allclose(step[:, 1], s * forward + c * lateral, atol=1e-12)
    np.testing.assert_allclose(step[:, 2], turn, atol=1e-12)


def test_a_turn_that_starts_and_ends_straight_turns_by_its_angle():
    corner = (Segment(2, 0.8), Segment(np.pi / 2 / 0.6, 0.5, turn=0.6), Segment(2, 0.8))
    assert whole_course(corner, DT, 1.0).pose[-1, 2] == pytest.approx(np.pi / 2, abs=0.003)


def test_laps_of_a_square_close():
    side = (Segment(5, 0.8), Segment(np.pi / 2 / 0.6, 0.5, turn=0.6))
    course = whole_course(side * 4, DT, 1.0, laps=2)
    one = whole_course(side * 4, DT, 1.0, laps=1)
    assert len(course.t) - len(one.t) == pytest.approx(4 * (5 + np.pi / 2 / 0.6) / DT, abs=4)
    # What is left is the run-out of the last stop.
    assert np.abs(course.pose[-1, :2]).max() < 1.5
