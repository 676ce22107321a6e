"""The table of residuals is made from the channels there are, for any number of legs and joints."""

import numpy as np
import pytest

from surefoot.models.residuals.layout import layout_for
from surefoot.models.residuals.registry import channels
from surefoot.sim.robot.limbs import QUADRUPED, limbs_by_name

BIPED = limbs_by_name(("L", "R"), ("L_hip", "L_knee", "L_ankle", "R_hip", "R_knee", "R_ankle"))
ARM = limbs_by_name((), ("shoulder", "elbow"))


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


@pytest.mark.parametrize("limbs", [BIPED, ARM, QUADRUPED])
def test_every_column_has_a_name_a_group_a_kind_and_noise(limbs):
    layout = layout_for(limbs)
    assert len(set(layout.names)) == layout.width
    for parts in (layout.groups, layout.alike):
        assert np.array_equal(np.sort(np.concatenate(parts)), np.arange(layout.width))
    for name in layout.channels:
        assert channels()[name].unit
        assert layout.columns[layout.channels[name].start].unit
