"""How large effects are, and what it costs them to be on some parts only."""

import numpy as np
import pytest

from surefoot.models.attribution.effect_sizes import (
    SPREAD_BETWEEN_PARTS,
    price_of_some_parts,
    prior_of,
    priors,
)
from surefoot.sim.effects import known_effects
from surefoot.sim.robot.limbs import QUADRUPED


def test_every_prior_is_of_an_effect_within_its_bounds_and_has_a_source():
    known = known_effects()
    for kind in known.values():
        prior = prior_of(kind)
        assert 0 < prior.within <= np.max(np.abs(kind.bounds))
        assert len(prior.source) > 10
        assert prior.within < prior.most
    assert set(priors()) <= set(known)


def test_what_machines_have_by_construction_costs_more_on_some_parts_only():
    spread = SPREAD_BETWEEN_PARTS["foot_rolling"]
    costs = [price_of_some_parts("foot_rolling", at, QUADRUPED) for at in ("all", "FL")]
    assert costs == [0.0, pytest.approx((1.96 / spread) ** 2)]
    some = [price_of_some_parts("leg_compliance", at, QUADRUPED) for at in ("calf", "FL_calf")]
    assert some[0] == 0.0 < some[1]
    assert price_of_some_parts("gyro_scale", "z", QUADRUPED) == 0.0


def test_an_effect_of_ones_own_says_how_large_it_is():
    class Own(known_effects()["payload"]):
        name = "own"
        plausible = 2.5

    assert prior_of(Own).within == 2.5
    del Own.plausible
    Own.name = "nowhere"
    assert prior_of(Own).within == 30.0
