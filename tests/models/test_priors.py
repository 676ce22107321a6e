"""How large effects are, and what an implausible size costs."""

import numpy as np
import pytest
from known_evidence import NOISE, evidence
from numpy.testing import assert_allclose

from surefoot.models.attribution.fit import design, normal_equations
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.attribution.priors import PRIORS, prior_of, prior_penalty
from surefoot.models.attribution.robust_weights import robust_weights
from surefoot.models.attribution.selection import SearchState, evaluate_candidates
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


def test_a_gyro_scale_that_no_gyro_has_needs_more_than_chance():
    """Evidence that would be enough for 1 % is not enough for 16 %."""

    def found(size, noise):
        one = evidence((0, 0, size, 0), noise=noise)
        data = design(one)
        weights = robust_weights(data, noise)
        part = np.floor(one.t / 4).astype(int) % 2
        sums = normal_equations(data, weights.sigma, weights.weight, part)
        best = evaluate_candidates(
            sums, NoiseFloor(noise, (), "none"), SearchState(), QUADRUPED, np.random.default_rng(0)
        )
        return next(c for c in best if c.key == ("gyro_scale", "x"))

    few, many = found(0.01, 18 * NOISE), found(0.16, 288 * NOISE)
    assert few.gain == pytest.approx(many.gain, rel=0.2)
    assert few.earned
    assert not many.earned
    assert found(0.16, NOISE).earned
