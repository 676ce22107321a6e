"""Feet that a log gives replace joint angles: kinematics, channels and effects."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from given_feet import with_feet_for_joints

from surefoot.models.attribution.diagnose import logs_under_model
from surefoot.models.attribution.evidence import all_keys, channels_of
from surefoot.models.residuals.binning import binned
from surefoot.models.residuals.channels import channels
from surefoot.models.residuals.feet import foot_heights, leg_velocities, travel_regressors
from surefoot.models.residuals.motion import motion_under_model
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import compensate_all, effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log, MemoisedLog, Meta
from surefoot.sim.log.schema import GROUPS
from surefoot.sim.robot import Robot
from surefoot.sim.robot.feet import PointFeet
from surefoot.sim.robot.machine import GivenFeet, machine_for_log
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

SPOT = Robot.load("spot_class")
POINT_FEET = replace(SPOT, foot_radius=np.zeros(4))


@pytest.fixture(scope="module")
def log():
    course = (Segment(2.0, 0.5, turn=0.3), Segment(2.0, 0.4, 0.1, turn=-0.4))
    return MemoisedLog.of(walk(Scenario("short", course, Ground(0.8)), SPOT, seed=0))


@pytest.fixture(scope="module")
def feet(log):
    return MemoisedLog.of(with_feet_for_joints(log, SPOT))


def test_feet_fixed_to_the_ground_give_the_velocity_of_the_body():
    """A body that turns at omega and moves at v_I sees a fixed foot move at -v_I - omega x foot."""
    rng = np.random.default_rng(0)
    v_I, omega = rng.normal(size=(2, 7, 3))
    feet_I, standing = rng.normal(size=(7, 4, 3)), rng.uniform(size=(7, 4)) < 0.5
    rates_I = -v_I[:, None] - np.cross(omega[:, None], feet_I)
    found = PointFeet().imu_velocity(feet_I, rates_I, omega, omega, standing)
    assert np.isnan(found[~standing]).all()
    expected = np.broadcast_to(v_I[:, None], feet_I.shape)
    np.testing.assert_allclose(found[standing], expected[standing], atol=1e-12)


def test_a_log_of_feet_that_pass_by_gives_the_velocity_of_the_body():
    t, v_I = 0.005 * np.arange(200), np.array([0.5, -0.2, 0.1])
    feet_I = np.array([[0.3, 0.2, -0.5], [0.3, -0.2, -0.5]]) - t[:, None, None] * v_I
    columns = {
        f"foot_{leg}_{axis}": feet_I[:, i, k]
        for i, leg in enumerate(("left", "right"))
        for k, axis in enumerate("xyz")
    }
    log = Log(pd.DataFrame({"t": t, **columns}), Meta(rate=200.0), "feet")
    standing, still = np.ones((200, 2), dtype=bool), np.zeros((200, 3))
    feet = GivenFeet.of_log(log).feet
    found = feet.imu_velocity(*feet.readings(log), still, still, standing)
    np.testing.assert_allclose(found, np.broadcast_to(v_I, found.shape), atol=1e-9)


def test_feet_say_what_joint_angles_do_of_a_robot_with_point_feet(log, feet):
    """Where the rates of the joints, too, are derivatives over 25 ms."""
    kept = [name for name in log.frame if not str(name).startswith("dq_")]
    log, machine = Log(log.frame.filter(items=kept), log.meta, log.name), GivenFeet.of_log(feet)
    motion = motion_under_model(log, POINT_FEET, fixed=False)
    turning = log.gyro, motion.up_I, motion.standing
    given = machine.feet.imu_velocity(*machine.feet.readings(feet), *turning)
    by_joints = POINT_FEET.feet.imu_velocity(*POINT_FEET.feet.readings(log), *turning)
    off = (given - by_joints)[motion.standing]
    assert np.sqrt(np.mean(off**2)) < 5e-4
    bins = [binned(one, m, motion) for one, m in ((log, POINT_FEET), (feet, machine))]
    np.testing.assert_allclose(
        foot_heights(bins[1], machine.feet), foot_heights(bins[0], POINT_FEET.feet), atol=1e-4
    )


def test_feet_that_roll_move_by_a_share_of_their_way(feet):
    """A share is added to the way of each leg on each axis, and found again to 1e-9."""
    machine = GivenFeet.of_log(feet)
    motion = motion_under_model(feet, machine, fixed=False)
    bins = binned(feet, machine, motion)
    shares = np.linspace(0.02, 0.09, 8)
    place, rate = bins.feet
    rolled = rate.copy()
    v_I = machine.feet.imu_velocity(place, rate, bins.omega, bins.R_GI[:, 2], bins.standing)
    rolled[..., :2] -= np.nan_to_num(v_I[..., :2]) * shares.reshape(4, 2)
    moved = replace(bins, feet=(place, rolled))
    change = leg_velocities(moved, machine.feet) - leg_velocities(bins, machine.feet)
    A = np.stack(
        [np.nan_to_num(one).ravel() for one in travel_regressors(bins, machine.feet)], axis=1
    )
    found = np.linalg.lstsq(A, np.nan_to_num(change).ravel())[0]
    np.testing.assert_allclose(found, shares, atol=1e-9)


def test_the_machine_of_a_log_with_feet_needs_no_name(log, feet):
    machine = machine_for_log(feet)
    assert isinstance(machine, GivenFeet)
    assert machine.limbs.legs == feet.legs
    assert machine.limbs.joints == ()
    assert isinstance(machine_for_log(feet, "spot_class"), Robot)
    neither = replace(log, meta=replace(log.meta, robot=None))
    with pytest.raises(SurefootError, match="names no robot"):
        machine_for_log(neither)


def test_channels_and_effects_of_joints_and_bodies_are_left_out(feet):
    (case,) = logs_under_model([feet], machine_for_log(feet), ())
    there = {"imu_gyro", "imu_accel", "leg_velocity", "stance_velocity", "contact_timing"}
    assert {*channels_of(case)} - {"foot_height"} == there
    names = {name for name, _ in all_keys(case)}
    assert {"gyro_bias", "imu_rotation", "reference_delay", "joint_delay", "contact_delay"} <= names
    assert not names & {"encoder_offset", "link_length", "foot_rolling", "payload", "hip_offset"}
    with pytest.raises(SurefootError, match="foot_rolling: needs joint angles and a robot model"):
        compensate_all([effect("foot_rolling", "all", 0.02)], feet, machine_for_log(feet))


def test_contacts_have_a_clock_only_if_they_have_a_sensor(feet):
    def derived(*notes: str) -> Log:
        return replace(feet, meta=replace(feet.meta, derived=(*feet.meta.derived, *notes)))

    for one in (feet, derived("contact from force")):
        (case,) = logs_under_model([one], machine_for_log(one), ())
        assert ("clock_scale", "feet") in all_keys(case)
    gait = derived("contact from gait")
    (case,) = logs_under_model([gait], machine_for_log(gait), ())
    assert ("clock_scale", "feet") not in all_keys(case)
    assert ("clock_scale", "joints") in all_keys(case)


def test_accelerations_need_a_reference_with_velocities(feet):
    kept = [name for name in feet.frame if not str(name).startswith("ref_v_")]
    derived = Log(feet.frame.filter(items=kept), feet.meta, feet.name)
    (case,) = logs_under_model([derived], machine_for_log(feet), ())
    assert "imu_accel" not in channels_of(case)
    assert "imu_gyro" in channels_of(case)


def test_joints_that_no_model_describes_are_not_read(log, feet):
    """As of five-bar legs, whose angles a log may have beside the feet."""
    more = replace(feet, frame=feet.frame.assign(q_FL_motor=log.q[:, 0], dq_FL_motor=0.0))
    (case,) = logs_under_model([more], machine_for_log(more), ())
    assert case.log.joints == ()


def test_late_joints_make_feet_late(feet):
    """The feet are resampled as far ahead as the joints they were computed from were late."""
    late = 0.004
    fixed, _ = effect("joint_delay", "all", late).compensate(feet, SPOT)
    rows = round(late * feet.rate)
    np.testing.assert_allclose(fixed.foot_I[:-rows], feet.foot_I[rows:], atol=1e-9)


def test_derived_velocities_are_no_reference_of_an_accelerometer_by_feet_alone():
    t, readings = np.arange(9.0), [*GROUPS["imu"], *GROUPS["reference"]]
    log, accel = Log(pd.DataFrame({"t": t}), Meta(rate=1.0), "any"), channels()["imu_accel"]
    for known, lacks in ((readings, ("ref_v",)), ([*readings, *GROUPS["ref_v"]], ())):
        log = Log(pd.DataFrame({"t": t, **dict.fromkeys(known, 1.0)}), Meta(rate=1.0), "any")
        assert accel.missing_groups(log, fixed=False, by_feet=True) == lacks
        assert accel.missing_groups(log, fixed=False) == ()


@pytest.mark.parametrize(
    ("lacks", "named"), [("q", "q"), ("contact", "contact"), ("reference", "imu")]
)
def test_what_a_channel_lacks_of_a_walk_is_named(lacks, named):
    """Without a reference, an IMU would do."""
    groups = {"q": ["q_knee"], "contact": ["contact_left"], "reference": GROUPS["reference"]}
    names = [name for group, own in groups.items() if group != lacks for name in own]
    frame = pd.DataFrame({"t": np.arange(9.0), **dict.fromkeys(names, 1.0)})
    log = Log(frame, Meta(rate=1.0), "any")
    assert channels()["leg_velocity"].missing_groups(log, fixed=False) == (named,)
