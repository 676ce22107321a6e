"""Dead and inverted contacts are found in logs of a second, with and without a reference."""

import numpy as np
import pytest

from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import LEGS, Log
from surefoot.sim.plausibility import check_log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

ROBOT = Robot.load("spot_class")
DEAD, INVERTED = "dead sensor", "inverted"
FAULTS = {  # legs, what their contact becomes, the cause that is named
    "all on": (LEGS, lambda x: np.ones_like(x), DEAD),
    "all off": (LEGS, lambda x: np.zeros_like(x), DEAD),
    "one on": (("FL",), lambda x: np.ones_like(x), DEAD),
    "one off": (("RR",), lambda x: np.zeros_like(x), DEAD),
    "a diagonal on": (("FR", "RL"), lambda x: np.ones_like(x), DEAD),
    "two in front off": (("FL", "FR"), lambda x: np.zeros_like(x), DEAD),
    "one inverted": (("RL",), lambda x: 1.0 - x, INVERTED),
    "all inverted": (LEGS, lambda x: 1.0 - x, INVERTED),
}


@pytest.fixture(scope="module")
def walked() -> Log:
    """One second of standing, then a walk."""
    course = Scenario("short", (Segment(4.0, 0.6, 0.0, 0.0),), Ground(0.8))
    return walk(course, ROBOT, 0)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("reference", [True, False])
def test_a_fault_is_named_in_a_second_of_walking(walked, fault, reference):
    legs, change, cause = FAULTS[fault]
    log = walked.rows((walked.t >= 2.5) & (walked.t < 3.5))
    log = log.with_columns({f"contact_{x}": change(log.frame[f"contact_{x}"]) for x in legs})
    if not reference:
        kept = [name for name in log.frame if not str(name).startswith("ref_")]
        log = Log(log.frame[kept], log.meta, log.name)
    found = check_log(log, ROBOT)
    if fault == "all off" and not reference:
        assert found == (), "it may hang in the air"
        return
    assert all(cause in one.cause for one in found)
    named = {name for one in found for name in one.streams}
    assert named >= {f"contact_{leg}" for leg in legs}


@pytest.mark.parametrize("seconds", [0.5, 1.0])
def test_good_contacts_of_short_logs_are_not_doubted(walked, seconds):
    for start in np.arange(0.0, 3.0, 0.7):  # standing, the first steps, walking
        log = walked.rows((walked.t >= start) & (walked.t < start + seconds))
        assert not [x for x in check_log(log, ROBOT) if x.streams[0].startswith("contact")]
