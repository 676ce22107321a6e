"""The verdict's rules, on made-up levels."""

import pytest

from surefoot.models.attribution.effect_sizes import Found
from surefoot.models.attribution.forces import Push
from surefoot.models.attribution.judgement import ChannelLevel, Findings, verdict_of
from surefoot.sim.effects import effect

CALF = Found(effect("link_length", "FL_calf", 0.004), (0.003, 0.005))
PUSH = Push(log=0, begin=4.0, end=5.0, force=21.0, unit="N")


def level(before, after, floor=1.0, highest=1.1):
    return ChannelLevel(before, after, floor, "m/s", highest)


def verdict(found, before, after, **more):
    levels = {"leg_velocity": level(before, after)}
    return verdict_of(Findings(found, levels, **more))


def test_what_explains_the_residual_down_to_its_floor_is_attributed():
    assert verdict([CALF], 2.0, 1.0) == ("attributed", ())
    assert verdict([], 1.0, 1.0) == ("no_residual", ())


def test_what_is_left_above_the_floor_is_a_reason():
    name, (why,) = verdict([CALF], 4.0, 2.0)
    assert name == "none_of_these"
    assert why == "leg_velocity: 2 m/s is left, above its noise floor of 1"


def test_nothing_is_attributed_that_takes_nothing_off_what_no_fit_has_seen():
    name, (why,) = verdict([CALF], 0.95, 0.96)
    assert name == "not_identifiable"
    assert why == "the effects found do not reduce the residual on unseen data"


def test_a_size_at_its_bound_fails():
    long = Found(effect("link_length", "FL_calf", 0.03), (0.02, 0.04))
    name, (why,) = verdict([long], 2.0, 1.0)
    assert name == "none_of_these"
    assert why == "link_length FL_calf: its size is at its bound"


def test_an_effect_that_the_others_may_imitate_is_not_attributed():
    key = (CALF.effect.name, CALF.effect.target)
    name, (why,) = verdict([CALF], 2.0, 1.0, imitated=frozenset([key]))
    assert name == "confounded"
    assert why.startswith("link_length FL_calf")


@pytest.mark.parametrize(
    ("found", "away", "name"),
    [([], [], "not_identifiable"), ([], [CALF], "not_identifiable"), ([CALF], [], "attributed")],
)
def test_outside_forces_are_no_effect_of_the_robot(found, away, name):
    said, reasons = verdict(found, 2.0, 1.0, pushes=[PUSH], pushed_away=away)
    assert said == name
    if not found:
        assert reasons[-1] == "outside forces of up to 21 N from 4.0 to 5.0 s of run 1"
    if away:
        assert reasons[0] == "link_length FL_calf: explains nothing but outside forces"
