"""Verdicts, levels of channels that they rest on, and priors of sizes."""

from dataclasses import replace

import numpy as np
import pytest

from surefoot.models.attribution.effect_sizes import Found, plausible_size, price_of_some_parts
from surefoot.models.attribution.forces import Push
from surefoot.models.attribution.judgement import (
    ChannelLevel,
    Findings,
    _by_chance,
    scatter_of_rms,
    verdict_of,
)
from surefoot.sim.effects import effect, known_effects
from surefoot.sim.effects.base import Prior
from surefoot.sim.effects.masses import Payload
from surefoot.sim.robot.limbs import QUADRUPED, Limbs

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
    assert why.startswith("leg_velocity: 2 m/s is left")
    assert why.endswith("above its noise floor of 1")


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


@pytest.mark.parametrize(
    ("before", "after", "worse"),
    [
        (1.0, 0.9, False),
        (1.0, 1.01, False),  # hardly more
        (1.15, 1.21, False),  # less than the floor's walks differ by
        (1.0, 1.3, True),
        (0.5, 0.95, False),  # below what the declared model leaves
        (0.5, 1.3, True),
    ],
)
def test_harm_is_more_than_the_floors_walks_differ_by(before, after, worse):
    assert ChannelLevel(before, after, 1.0, "m", 1.2).worse == worse


def test_a_tenth_more_above_all_walks_is_harm_however_much_these_scatter():
    level = ChannelLevel(1.0, 1.12, 0.5, "m", 1.11)
    assert level.worse
    assert replace(level, by_chance=True).worse
    assert not replace(level, highest=1.13).worse
    assert not replace(level, after=1.09, highest=1.05).worse
    assert not replace(level, same_bins=(1.0, 1.05)).worse


def test_other_bins_are_no_harm():
    """Undone late touch-downs leave whole stances, of which the log as it is has few."""
    level = ChannelLevel(0.2, 1.1, 0.2, "mm", 0.4)
    assert level.worse
    assert not replace(level, same_bins=(0.2, 0.3)).worse
    assert replace(level, same_bins=(0.2, 0.9)).worse
    assert not replace(level, same_bins=(0.0, 0.0)).worse  # it has none of them


def test_without_a_floor_any_more_is_harm():
    assert ChannelLevel(1.0, 1.1, None, "m").worse
    assert not ChannelLevel(1.0, 1.0, None, "m").worse
    assert ChannelLevel(1.0, 1.1, None, "m").at_floor  # nothing says that it is not


def test_a_channel_is_at_its_floor_up_to_what_walks_reach():
    assert ChannelLevel(3.0, 1.2, 1.0, "m", 1.2).at_floor
    assert not ChannelLevel(3.0, 1.3, 1.0, "m", 1.2).at_floor
    assert ChannelLevel(3.0, 1.3, 1.0, "m", 1.2, low_share=0.9).at_floor


def test_the_level_of_a_few_values_scatters_as_drawn_ones_do():
    rng = np.random.default_rng(0)
    for values in (rng.normal(size=4000), rng.standard_t(6, size=4000)):
        drawn = np.sqrt(np.mean(rng.choice(values, (3000, 60)) ** 2, axis=1))
        assert scatter_of_rms(values**2, 60) == pytest.approx(drawn.std() / drawn.mean(), rel=0.1)


def test_a_few_events_are_worse_only_by_more_than_chance():
    rng = np.random.default_rng(1)
    before = rng.normal(size=(40, 2))
    one_off = before.copy()
    one_off[7, 0] = 5.0
    assert _by_chance(before, one_off)
    assert _by_chance(before, 0.9 * before)
    assert not _by_chance(before, 1.3 * before)
    assert _by_chance(np.full((3, 1), np.nan), np.ones((3, 1)))


def test_every_prior_is_within_the_bounds_and_has_a_source():
    for kind in known_effects().values():
        prior = kind.size_prior()
        assert 0 < prior.within <= np.max(np.abs(kind.bounds))
        assert len(prior.source) > 10
        assert prior.within < prior.most


def test_what_machines_have_by_construction_costs_more_on_some_parts_only():
    spread = known_effects()["foot_rolling"].traced.spread
    costs = [price_of_some_parts("foot_rolling", at, QUADRUPED) for at in ("all", "FL")]
    assert costs == [0.0, pytest.approx((1.96 / spread) ** 2)]
    some = [price_of_some_parts("leg_compliance", at, QUADRUPED) for at in ("calf", "FL_calf")]
    assert some[0] == 0.0 < some[1]
    assert price_of_some_parts("gyro_scale", "z", QUADRUPED) == 0.0


def test_machines_on_a_fixed_base_carry_and_have_rotors_by_their_size():
    gantry = Limbs((), ("lift", "turn"), (), inertia=(40.0, 0.01), mass=500.0)
    assert plausible_size("link_mass", "turn", gantry) == pytest.approx(200.0)
    assert plausible_size("armature", "lift", gantry) == pytest.approx(40.0)
    for name, target in (("link_mass", "FL_calf"), ("armature", "FL_calf")):
        within = known_effects()[name].size_prior().within
        assert plausible_size(name, target, QUADRUPED) == within
    assert plausible_size("armature", "turn", gantry) == pytest.approx(0.01)


def test_an_effect_without_a_prior_is_as_plausible_as_its_bounds():
    class Own(Payload):
        traced = replace(Payload.traced, prior=Prior(2.5, "weighed"))

    assert Own.size_prior().within == 2.5
    Own.traced = replace(Own.traced, prior=None)
    assert Own.size_prior().within == 30.0
