"""The table of residuals is made from the channels there are, for any number of legs and joints."""

import numpy as np
import pytest
from synthetic import synthetic_walk, without

from surefoot.models.residuals.binning import reference_motion
from surefoot.models.residuals.channel import Channel, ResidualInputs
from surefoot.models.residuals.channels import CHANNELS, channels
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import LEGS, Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import QUADRUPED, Limbs

BIPED = Limbs(
    ("L", "R"),
    ("L_hip", "L_knee", "L_ankle", "R_hip", "R_knee", "R_ankle"),
    ((0, 1, 2), (3, 4, 5)),
    ("L_knee", "L_ankle", "R_knee", "R_ankle"),
)
ARM = Limbs((), ("shoulder", "elbow"), ())


def test_a_biped_has_columns_for_its_two_legs_and_six_joints():
    layout = layout_for(BIPED)
    widths = {name: columns.stop - columns.start for name, columns in layout.channels.items()}
    assert widths == {
        "imu_gyro": 3,
        "imu_accel": 3,
        "leg_velocity": 6,
        "stance_velocity": 6,
        "stance_displacement": 4,
        "foot_height": 2,
        "joint_torque": 6,
        "base_wrench": 6,
        "joint_rate": 6,
        "contact_timing": 4,
        "command": 6,
    }
    assert layout.by_leg("leg_velocity").tolist() == [[6, 7, 8], [9, 10, 11]]
    torque = layout.of("joint_torque")
    knees = [c for c in torque if layout.names[c].endswith("_knee")]
    assert knees in [list(columns) for columns in layout.alike]


def test_an_arm_has_its_joints_channels_alone_and_each_joint_noise_of_its_own():
    layout = layout_for(ARM)
    assert list(layout.channels) == ["joint_torque", "joint_rate", "command"]
    kinds = ("torque", "rate", "command")
    assert layout.names == tuple(f"{kind}_{joint}" for kind in kinds for joint in ARM.joints)
    assert layout.alike == tuple([k] for k in range(6))
    assert layout.by_leg("leg_velocity").shape == (0,)


def test_feet_alone_have_the_channels_of_the_imu_and_of_feet():
    """Nothing is known of joints, torques and links."""
    layout = layout_for(Limbs(("left", "right"), (), ()))
    of_feet = ["leg_velocity", "stance_velocity", "foot_height", "contact_timing"]
    assert list(layout.channels) == ["imu_gyro", "imu_accel", *of_feet]


def walk_with_contacts() -> Log:
    """All feet of a walk stand all the time."""
    log = synthetic_walk(0, 1.0, robot="spot_class")
    return log.with_columns({f"contact_{leg}": np.ones(len(log.t)) for leg in LEGS})


def test_feet_that_stand_tell_nothing_where_the_log_does_not_show_them():
    """Contacts alone are no feet: they are at the ends of legs whose angles are not known."""
    robot, log = Robot.load("spot_class"), walk_with_contacts()
    for seen, shown in ((log, True), (without(log, "q_", "dq_", "tau_"), False)):
        inputs = ResidualInputs(seen, robot, reference_motion(seen, robot.limbs))
        assert (inputs.feet is not None) == shown
        assert (inputs.leg_velocities is not None) == shown


def test_a_channel_is_there_where_base_ground_and_columns_are_as_it_needs():
    """Velocities by legs go over any ground, heights of feet over level ground alone; an arm has
    neither."""
    log = walk_with_contacts()
    for name, on_slopes in (("leg_velocity", True), ("foot_height", False)):
        channel = channels()[name]
        assert channel.is_available(log, fixed=False, level=True)
        assert channel.is_available(log, fixed=False, level=False) == on_slopes
        assert not channel.is_available(log, fixed=True, level=True)


def test_a_walk_lacks_its_contacts_and_its_reference_and_an_arm_neither():
    torques = channels()["joint_torque"]
    log = walk_with_contacts()
    assert torques.missing_groups(log, fixed=False) == ()
    assert torques.missing_groups(without(log, "contact", "tau"), fixed=False) == ("tau", "contact")
    assert torques.missing_groups(without(log, "contact", "ref", "tau"), fixed=True) == ("tau",)


def test_a_channel_of_ones_own_is_a_subclass_that_has_its_name():
    class Warmth(Channel):
        name, unit, needs = "warmth", "K", ("x_warmth",)

    CHANNELS.check_member("warmth", Warmth)
    for name, kind, words in (
        ("cold", Warmth, "calls itself warmth"),
        ("warmth", Warmth(), "must be a class"),
        ("warmth", object, "lacks name, unit, needs"),
    ):
        with pytest.raises(SurefootError, match=words):
            CHANNELS.check_member(name, kind)


@pytest.mark.parametrize("limbs", [BIPED, ARM, QUADRUPED])
def test_every_column_has_a_name_a_group_a_kind_and_noise(limbs):
    layout = layout_for(limbs)
    assert len(set(layout.names)) == layout.width
    for parts in (layout.groups, layout.alike):
        assert np.array_equal(np.sort(np.concatenate(parts)), np.arange(layout.width))
    for name in layout.channels:
        assert channels()[name].unit
        assert layout.columns[layout.channels[name].start].unit
