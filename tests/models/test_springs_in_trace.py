"""Springs of feet and legs in a trace: which channels see that they are compensated."""

from functools import lru_cache

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from surefoot.models.attribution.evidence import linearise, log_under_model, table_of
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.effects import effect, known_effects
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

ROBOT = Robot.load("spot_class")
LAYOUT = layout_for(ROBOT.limbs)
SPRINGS = [
    ("foot_elasticity", "normal", 3e-5),
    ("foot_elasticity", "tangential", 3e-5),
    ("leg_compliance", "all", 8e-4),
]


@lru_cache
def case_with(*spring):
    course = Scenario("straight", (Segment(5.0, 0.5),), Ground(0.8), stand=0.5)
    log = walk(course, ROBOT, seed=3, effects=[effect(*spring)], declared=False)
    return log_under_model(log, ROBOT)


@pytest.mark.parametrize("spring", SPRINGS)
def test_channels_of_what_stays_where_the_encoders_say_are_as_read(spring):
    """The noise of the load, differentiated, would fill them."""
    case, unseen = case_with(*spring), known_effects()[spring[0]].unseen_by
    as_read, known = table_of(case, ()), table_of(case, [effect(*spring)])
    columns = LAYOUT.of(*unseen)
    assert_array_equal(known[:, columns], as_read[:, columns])
    legs = LAYOUT.of("leg_velocity")
    left = [np.nanstd(table[:, legs]) for table in (as_read, known)]
    assert left[1] < left[0]


@pytest.mark.parametrize("spring", SPRINGS)
def test_a_regressor_of_a_spring_has_nothing_in_channels_that_do_not_see_it(spring):
    case, key = case_with(*spring), spring[:2]
    unseen = set(LAYOUT.of(*known_effects()[key[0]].unseen_by))
    for chosen in ([], [effect(*spring)]):
        (one,) = linearise([case], chosen, [key]).X
        assert len(one.columns)
        assert not unseen & set(one.columns)


def test_another_effect_has_the_same_regressor_beside_elastic_feet_where_they_do_not_show():
    """It is a difference of two tables that both have the feet's springs, or neither."""
    spring, key = SPRINGS[0], ("link_mass", "FL_calf")
    case = case_with(*spring)
    plain, beside = (linearise([case], e, [key]).X[0] for e in ([], [effect(*spring)]))
    columns = LAYOUT.of("joint_torque")
    one, other = (x.values[:, np.isin(x.columns, columns)] for x in (plain, beside))
    assert np.nanstd(one - other) < 0.1 * np.nanstd(one)
