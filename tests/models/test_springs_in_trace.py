"""Springs of feet and legs in a trace: which channels see that they are compensated."""

from functools import lru_cache

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from surefoot.models.attribution.evidence import (
    linearise,
    log_under_model,
    table_of,
    with_compensated,
)
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

ROBOT = Robot.load("spot_class")


LAYOUT = layout_for(ROBOT.limbs)


OF_MOTORS = ("joint_rate", "command")


OF_LINKS = ("joint_torque", "base_wrench", *OF_MOTORS)


SPRINGS = [
    (("foot_elasticity", "normal", 3e-5), OF_LINKS),
    (("foot_elasticity", "tangential", 3e-5), OF_LINKS),
    (("leg_compliance", "all", 8e-4), OF_MOTORS),
]


@lru_cache
def case_with(*spring):
    course = Scenario("straight", (Segment(5.0, 0.5),), Ground(0.8), stand=0.5)
    log = walk(course, ROBOT, seed=3, effects=[effect(*spring)], declared=False)
    return log_under_model(log, ROBOT)


@pytest.mark.parametrize(("spring", "unseen"), SPRINGS)
def test_channels_of_what_stays_where_the_encoders_say_are_as_read(spring, unseen):
    """The noise of the load, differentiated, would fill them."""
    case = case_with(*spring)
    as_read, known = table_of(case, ()), table_of(case, [effect(*spring)])
    columns = LAYOUT.of(*unseen)
    assert np.isfinite(as_read[:, columns]).any(axis=0).all()
    assert_array_equal(known[:, columns], as_read[:, columns])
    legs = LAYOUT.of("leg_velocity")
    left = [np.nanstd(table[:, legs]) for table in (as_read, known)]
    assert left[1] < left[0]


@pytest.mark.parametrize(("spring", "unseen"), SPRINGS)
def test_a_regressor_of_a_spring_has_nothing_in_channels_that_do_not_see_it(spring, unseen):
    case, key = case_with(*spring), spring[:2]
    for chosen in ([], [effect(*spring)]):
        (one,) = linearise([case], chosen, [key]).X
        assert len(one.columns)
        assert not set(LAYOUT.of(*unseen)) & set(one.columns)


@pytest.mark.parametrize(
    ("key", "channel"),
    [(("link_mass", "FL_calf"), "joint_torque"), (("reference_delay", "all"), "base_wrench")],
)
def test_another_effect_has_the_same_regressor_beside_elastic_feet_where_they_do_not_show(
    key, channel
):
    """Or nearly so: both sides of its difference are at the angles by which the feet are where they
    are."""
    spring, _ = SPRINGS[0]
    case = case_with(*spring)
    plain, beside = (linearise([case], e, [key]).X[0] for e in ([], [effect(*spring)]))
    columns = LAYOUT.of(channel)
    one, other = (x.values[:, np.isin(x.columns, columns)] for x in (plain, beside))
    assert np.nanstd(one - other) < 0.1 * np.nanstd(one)


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
