"""Leg Jacobians and link rates against finite differences of the kinematics themselves."""

import numpy as np
import pytest

from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import axis_rotation


@pytest.mark.parametrize("name", ["spot_class", "v60_class"])
def test_foot_jacobians_are_the_derivatives_of_the_feet(name):
    robot = Robot.load(name)
    lower, upper = robot.joint_range.T
    q = np.random.default_rng(0).uniform(lower, upper, (50, 12))
    J = robot.feet_jacobian_I(q)
    e = 1e-6
    for joint in range(12):
        step = np.zeros(12)
        step[joint] = e
        slope = (robot.feet_I(q + step) - robot.feet_I(q - step)) / (2 * e)
        leg = joint // 3
        np.testing.assert_allclose(J[:, leg, :, joint % 3], slope[:, leg], atol=1e-8)
        others = np.delete(slope, leg, axis=1)
        np.testing.assert_allclose(others, 0.0, atol=1e-9)


def test_foot_rate_is_that_of_a_rigid_last_link():
    # Of two points on one link: their relative velocity is rate x arm.
    robot = Robot.load("spot_class")
    rng = np.random.default_rng(1)
    q, dq = rng.uniform(-0.5, 0.5, (20, 12)) + robot.q_home, rng.normal(size=(20, 12))
    longer = robot.legs._replace(foot=robot.legs.foot + rng.normal(size=(4, 3)))
    other = type(robot)(**{**robot.__dict__, "legs": longer})
    arm = other.feet_I(q) - robot.feet_I(q)
    e = 1e-6
    spread = [o.feet_I(q + e * dq) - o.feet_I(q - e * dq) for o in (other, robot)]
    relative = (spread[0] - spread[1]) / (2 * e)
    np.testing.assert_allclose(np.cross(robot.foot_rates_I(q, dq), arm), relative, atol=1e-7)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-7, 0.3, np.pi - 1e-9, np.pi, 5.0])
def test_axis_rotation_is_a_rotation_that_adds_up(angle):
    axis = np.array([1.0, -2.0, 0.5])
    axis /= np.linalg.norm(axis)
    R = np.array(axis_rotation(axis, angle)).reshape(3, 3)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R @ axis, axis, atol=1e-14)
    half = np.array(axis_rotation(axis, angle / 2)).reshape(3, 3)
    np.testing.assert_allclose(half @ half, R, atol=1e-14)


def test_joint_angles_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"\(N, 12\)"):
        Robot.load("spot_class").feet_I(np.zeros(12))
