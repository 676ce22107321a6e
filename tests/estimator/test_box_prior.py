"""Covariances held below the prior's."""

import numpy as np

from surefoot.estimator.box import below_prior, clip_to_prior


def test_what_is_above_the_prior_is_clipped_to_it_and_the_rest_is_kept():
    C = np.array([[1.0, 0.999, -0.3], [0.999, 1.0, -0.32], [-0.3, -0.32, 1.0]])
    L = np.linalg.cholesky(C)
    Q = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    within = L @ Q @ np.diag([0.2, 0.9, 1.0 - 1e-6]) @ Q.T @ L.T
    beyond = L @ Q @ np.diag([0.2, 0.9, 1.3]) @ Q.T @ L.T
    exact = L @ Q @ np.diag([0.2, 0.9, 1.0]) @ Q.T @ L.T
    kept, clipped = within.copy(), beyond.copy()
    clip_to_prior(C, kept)
    clip_to_prior(C, clipped)
    assert below_prior(C, within)
    assert not below_prior(C, beyond)
    assert np.abs(kept - within).max() < 1e-12
    assert np.abs(clipped - exact).max() < 1e-12
