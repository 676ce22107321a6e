"""What an effect costs the filters, before it is known and after."""

from dataclasses import replace

import numpy as np
import pytest

from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.scenarios.estimate.run import Learnt
from surefoot.scenarios.trace.filters import before_and_after, drift
from surefoot.sim.effects.base import Effect, with_columns
from surefoot.sim.robot import Robot


class Drift(Effect):
    """A gyro that drifts with the time since the log began."""

    name = "drift"
    unit = "rad/s^2"
    bounds = (-1.0, 1.0)
    channels = ("imu_gyro",)
    targets = ("all",)

    def compensate(self, log, robot):
        reading = log.frame["gyro_x"].to_numpy() - self.value * (log.t - log.t[0])
        return with_columns(log, {"gyro_x": reading}), robot


def test_an_effect_that_grows_with_time_is_explained_before_the_log_is_cut(log):
    robot = Robot.load("spot_class")
    drifted = log.frame["gyro_x"].to_numpy() + 0.01 * (log.t - log.t[0])
    drifting = with_columns(replace(log), {"gyro_x": drifted})
    found = before_and_after(drifting, robot, [Drift("all", 0.01)], Learnt(), 5.0, log.t[-1])
    right = before_and_after(log, robot, [], Learnt(), 5.0, log.t[-1])
    assert [one.filter for one in found] == [one.filter for one in right]
    for one, other in zip(found, right, strict=True):
        assert one.metrics[1].ape_rot == pytest.approx(other.metrics[0].ape_rot, rel=1e-6)
    imu = next(one for one in found if one.filter == "imu")
    assert imu.metrics[0].ape_rot > 5 * imu.metrics[1].ape_rot
    assert np.isfinite(imu.metrics[1].ape_trans)


def test_who_sways_on_the_spot_has_no_drift_by_the_metre():
    t = np.linspace(0.0, 10.0, 1001)
    still = np.broadcast_to(np.eye(3), (len(t), 3, 3))

    def path(x):
        p_GI = np.column_stack([x, np.zeros((len(t), 2))])
        return Trajectory(t=t, R_GI=still, v_GI=0 * p_GI, p_GI=p_GI, b_a=0 * p_GI, b_g=0 * p_GI)

    away = 0.1 * t
    assert drift(path(0.5 * t), path(0.5 * t + away)) == pytest.approx(0.2)
    assert np.isnan(drift(path(0.01 * np.sin(t)), path(0.01 * np.sin(t) + away)))
