"""How large effects are, and what an implausible size costs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from surefoot.models.attribution.effect_sizes import PRIORS, prior_of, prior_penalty
from surefoot.sim.effects import known_effects
from surefoot.sim.robot.limbs import QUADRUPED


def test_every_prior_is_of_an_effect_within_its_bounds_and_has_a_source():
    known = known_effects()
    for kind in known.values():
        prior = prior_of(kind)
        assert 0 < prior.within <= np.max(np.abs(kind.bounds))
        assert len(prior.source) > 10
        assert prior.within < prior.most
    assert len(set(PRIORS) & set(known)) > 15


def test_a_size_costs_what_a_normal_density_says():
    within = PRIORS["gyro_scale"].within
    density = [np.exp(-0.5 * (1.96 * x / within) ** 2) for x in (0.0, 0.16)]
    assert_allclose(
        prior_penalty("gyro_scale", "z", 0.16, QUADRUPED), -2 * np.log(density[1] / density[0])
    )
    assert prior_penalty("gyro_scale", "z", within, QUADRUPED) == pytest.approx(1.96**2)


def test_an_effect_of_ones_own_says_how_large_it_is():
    class Own(known_effects()["payload"]):
        name = "own"
        plausible = 2.5

    assert prior_of(Own).within == 2.5
    del Own.plausible
    Own.name = "nowhere"
    assert prior_of(Own).within == 30.0
