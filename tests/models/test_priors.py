"""How large effects are, and what it costs them to be on some parts only."""

from dataclasses import replace

import numpy as np
import pytest

from surefoot.models.attribution.effect_sizes import plausible_size, price_of_some_parts
from surefoot.sim.effects import known_effects
from surefoot.sim.effects.base import Prior
from surefoot.sim.effects.masses import Payload
from surefoot.sim.robot.limbs import QUADRUPED, Limbs


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


def test_large_machines_on_a_fixed_base_carry_more_and_have_larger_rotors():
    gantry = Limbs((), ("lift", "turn"), (), inertia=(40.0, 0.01), mass=500.0)
    assert plausible_size("link_mass", "turn", gantry) == pytest.approx(200.0)
    assert plausible_size("armature", "lift", gantry) == pytest.approx(40.0)
    for name, target in (("link_mass", "FL_calf"), ("armature", "FL_calf")):
        within = known_effects()[name].size_prior().within
        assert plausible_size(name, target, QUADRUPED) == within
    assert plausible_size("armature", "turn", gantry) == within


def test_an_effect_without_a_prior_is_as_plausible_as_its_bounds():
    class Own(Payload):
        traced = replace(Payload.traced, prior=Prior(2.5, "weighed"))

    assert Own.size_prior().within == 2.5
    Own.traced = replace(Own.traced, prior=None)
    assert Own.size_prior().within == 30.0
