"""What an effect costs the filters, before it is known and after."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.models.attribution.diagnose import logs_under_model
from surefoot.scenarios.estimate.run import Learnt
from surefoot.scenarios.trace.filters import before_and_after, causes_of_drift, drift, drift_parts
from surefoot.sim.effects import effect
from surefoot.sim.effects.base import Effect, Traced, with_columns
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

COURSE = (Segment(5.0, 0.5), Segment(5.0, 0.4, turn=0.5), Segment(4.0, 0.5, turn=-0.4))


class Drift(Effect):
    """A gyro that drifts with the time since the log began."""

    name = "drift"
    unit = "rad/s^2"
    bounds = (-1.0, 1.0)
    targets = ("all",)
    traced = Traced(channels=("imu_gyro",), step=1e-3)

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
    swaying = path(0.01 * np.sin(t)), path(0.01 * np.sin(t) + away)
    assert np.isnan(drift(*swaying))
    assert np.isnan(drift_parts(*swaying)).all()


def test_each_cause_of_drift_is_charged_with_what_it_causes(log, robot):
    """A gyro that reads turns 2 % too large turns the estimate; a short shank sinks it."""
    turns, sinks = effect("gyro_scale", "z", 0.02), effect("link_length", "FR_calf", 0.006)
    course = Scenario("seen", COURSE, Ground(0.8))
    built = walk(course, robot, 4, effects=[turns, sinks], declared=False)
    (case,), (exact,) = (logs_under_model([one], robot, ()) for one in (built, log))
    causes = causes_of_drift([case], [turns, sinks])
    assert causes is not None
    added = {one.name: drift for one, drift in causes.added}
    height, yaw = (np.array([abs(x[k]) for x in added.values()]) for k in (1, 2))
    assert list(added)[int(height.argmax())] == "link_length"
    assert list(added)[int(yaw.argmax())] == "gyro_scale"
    assert height.max() > 3.0 * height.min()
    assert yaw.max() > 3.0 * yaw.min()
    # Small effects add up to what the declared model drifts more than one that has them all.
    more = (causes.declared - causes.left)[1:]
    assert np.sum(list(added.values()), axis=0)[1:] == pytest.approx(more, rel=0.1, abs=1e-4)
    assert causes.added[0][1][0] > causes.added[1][1][0] > 0.0
    none = causes_of_drift([exact], [effect("gyro_scale", "z", 0.0)])
    assert none is not None
    assert np.abs(causes.left - none.declared).max() < 0.2 * np.abs(causes.declared).max()


def test_a_drift_has_a_height_a_yaw_and_a_distance():
    t = np.linspace(0.0, 10.0, 1001)
    zeros = np.zeros((len(t), 3))

    def ahead(scale, climb, turn):
        R_GI = Rotation.from_euler("z", (turn * t)[:, None]).as_matrix()
        p_GI = np.column_stack([scale * t, 0 * t, climb * t])
        return Trajectory(t=t, R_GI=R_GI, v_GI=zeros, p_GI=p_GI, b_a=zeros, b_g=zeros)

    found = drift_parts(ahead(1.0, 0.0, 0.0), ahead(1.02, 0.003, 0.01))
    assert found[1:] == pytest.approx([0.003, 0.01, 0.02], rel=1e-3)
    assert found[0] > np.hypot(0.02, 0.003)  # beside what the turn adds


def test_where_the_leg_filter_does_not_run_no_cause_is_named(log, robot):
    bare = replace(log, frame=log.frame[[c for c in log.frame if not str(c).startswith("contact")]])
    cases = logs_under_model([bare], robot, ())
    assert causes_of_drift(cases, [effect("gyro_scale", "z", 0.02)]) is None
    assert causes_of_drift(cases, []) is None
