"""The chain rule against the true residual: one small effect at a time, on a walk."""

import numpy as np
import pytest

from surefoot.models.attribution.evidence import _Linear, all_keys, log_under_model, table_of
from surefoot.models.residuals.layout import layout_of
from surefoot.sim.effects import CATALOGUE, effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import JOINTS
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

SPOT = Robot.load("spot_class")
SCENARIO = Scenario("short", (Segment(4.0, 0.5, 0.1, 0.3),), Ground(0.8))
# An offset and a torque of one joint, of a leg and of the base: every branch of the chain.
KEYS = (
    ("encoder_offset", "RL_thigh"), ("encoder_scale", "FR_calf"), ("torque_scale", "FL_calf"),
    ("torque_bias", "RR_hip"), ("joint_compliance", "RR_calf"), ("gyro_scale", "z"),
    ("armature", "FL_thigh"), ("hip_offset", "FR_y"), ("link_length", "RL_thigh"),
    ("link_length", "FL_calf"), ("foot_rolling", "all"), ("payload", "all"), ("com_offset", "x"),
)  # fmt: skip


@pytest.fixture(scope="module")
def case():
    return log_under_model(walk(SCENARIO, SPOT, 7), SPOT)


@pytest.mark.parametrize("key", KEYS, ids=" ".join)
def test_a_regressor_is_the_slope_of_the_true_residual(case, key):
    assert key in all_keys(case)
    one = _Linear(case, ()).regressor(key)
    step = 1e-2 * CATALOGUE[key[0]].step
    table = table_of(case, ())
    slope = (table - table_of(case, [effect(key[0], key[1], step)])) / step
    slope = np.where(np.isfinite(table), slope, 0.0)
    whole = np.zeros_like(table)
    whole[:, one.columns] = one.values
    for name, columns in layout_of(JOINTS).channels.items():
        # What is left of two changes that cancel; and when feet move, which is for delays to say.
        if name in ("joint_rate", "contact_timing"):
            continue
        # Products of means over a bin are not quite the means of products.
        apart = np.linalg.norm(whole[:, columns] - slope[:, columns])
        assert apart <= 0.03 * np.linalg.norm(slope[:, columns]) + 1e-6 * np.linalg.norm(slope)
