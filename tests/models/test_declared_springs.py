"""Channels that do not see a spring have the same residual with a declared one as with one that is
compensated by the search."""

import numpy as np
import pytest

from surefoot.models.attribution.evidence import log_under_model, table_of, with_compensated
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.effects import effect
from surefoot.sim.robot import Robot

SPRING = effect("leg_compliance", "all", 1e-3)
ZERO = effect("encoder_offset", "FL_thigh", 0.02)


@pytest.mark.parametrize("more", [(), (ZERO,)])
def test_what_is_declared_leaves_what_a_search_would(log, more):
    robot = Robot.load("spot_class")
    plain = log_under_model(log, robot)
    declared = log_under_model(log, robot, [SPRING])
    if more:
        declared = with_compensated(declared, more)
    searched, known = table_of(plain, [SPRING, *more]), table_of(declared, ())
    unseen = layout_for(robot.limbs).of(*SPRING.traced.unseen_by)
    assert np.isfinite(searched[:, unseen]).any()
    np.testing.assert_allclose(known[:, unseen], searched[:, unseen], atol=1e-9)
