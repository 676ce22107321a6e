"""Any box at all: random ones by the thousand, checked in a compiled loop."""

import numpy as np
import pytest

from surefoot.estimator.box import box_moments_kernel
from surefoot.estimator.core.checks import is_definite
from surefoot.sim.common.kernels import kernel

ROUNDING = 1e-9
"""By how much a variance may exceed the prior's, in units of the prior's variances."""
WORDS = (
    "fine",
    "log probability is not finite or above zero",
    "mean lies outside the box",
    "a variance is not a positive number",
    "covariance is not positive definite",
    "covariance is above the prior's",
)


def boxes(rng, count: int):
    """means (B, 3), covs (B, 3, 3), lowers and uppers (B, 3): everything a filter might meet.

    Determinants of the correlation down to 1e-8, distances up to 100 deviations, half widths of
    1e-3 to 30 deviations mixed on one box, a third of the boxes with infinite bounds, among them
    one or two free axes; units from 1e-3 to 1e3.
    """
    Q = np.linalg.qr(rng.standard_normal((count, 3, 3)))[0]
    lengths = 10.0 ** np.stack(
        [np.zeros(count), rng.uniform(-1.0, 0.0, count), rng.uniform(-4.0, 0.0, count)], axis=1
    )
    covs = np.einsum("bik,bk,bjk->bij", Q, lengths**2, Q)
    # Half of them: one strongly correlated pair, the third axis by itself.
    pair = rng.random(count) < 0.5
    rho = (1.0 - 10.0 ** rng.uniform(-8.0, 0.0, count)) * rng.choice([-1.0, 1.0], count)
    plain = np.zeros((count, 3, 3)) + np.eye(3)
    plain[:, 0, 1] = plain[:, 1, 0] = rho
    covs[pair] = plain[pair]
    spread = np.sqrt(np.einsum("bii->bi", covs))
    covs = covs / spread[:, :, None] / spread[:, None, :]
    # Rounding can take what little a determinant of 1e-8 leaves.
    covs[np.linalg.det(covs) < 1e-8] = np.eye(3)
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    near = rng.random(count) < 0.5
    distance = np.where(near, rng.uniform(0.0, 3.0, count), 10.0 ** rng.uniform(0.0, 2.0, count))
    half = 10.0 ** rng.uniform(-3.0, 1.5, (count, 3))
    alike = rng.random(count) < 0.5
    half[alike] = half[alike, :1] * rng.uniform(0.5, 1.5, (alike.sum(), 3))
    lower, upper = distance[:, None] * direction - half, distance[:, None] * direction + half
    cut = rng.integers(0, 4, (count, 3)) * (rng.random(count) < 1 / 3)[:, None]
    lower[(cut == 1) | (cut == 3)] = -np.inf
    upper[(cut == 2) | (cut == 3)] = np.inf
    unit = 10.0 ** rng.uniform(-3.0, 3.0, (count, 3))
    mean = rng.standard_normal((count, 3))
    return (
        mean * unit,
        covs * unit[:, :, None] * unit[:, None, :],
        (mean + lower) * unit,
        (mean + upper) * unit,
    )


@kernel
def check(means, covs, lowers, uppers, verdicts):
    """The first of WORDS that holds for each box."""
    mean, cov, scaled, left = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for n in range(len(means)):
        log_prob = box_moments_kernel(means[n], covs[n], lowers[n], uppers[n], mean, cov)
        verdicts[n] = 0
        if not (np.isfinite(log_prob) and log_prob <= 0.0):
            verdicts[n] = 1
            continue
        for i in range(3):
            if not lowers[n, i] <= mean[i] <= uppers[n, i]:
                verdicts[n] = 2
            if not 0.0 < cov[i, i] < np.inf:
                verdicts[n] = 3
        if verdicts[n]:
            continue
        for i in range(3):
            for j in range(3):
                scaled[i, j] = cov[i, j] / np.sqrt(cov[i, i] * cov[j, j])
                left[i, j] = covs[n, i, j] - cov[i, j] + (ROUNDING * covs[n, i, i] if i == j else 0)
                left[i, j] /= np.sqrt(covs[n, i, i] * covs[n, j, j])
        if not is_definite(scaled):
            verdicts[n] = 4
        elif not is_definite(left):
            verdicts[n] = 5


def complaints(seed: int, count: int) -> list[str]:
    """One line for each of the first bad boxes."""
    lines = []
    for part in range(0, count, 20_000):
        made = boxes(np.random.default_rng([seed, part]), min(20_000, count - part))
        verdicts = np.empty(len(made[0]), dtype=np.int64)
        check(*made, verdicts)
        for n in np.flatnonzero(verdicts)[:5]:
            lines.append(f"seed {seed}, part {part}, box {n}: {WORDS[verdicts[n]]}")
    return lines


def test_twenty_thousand_boxes_of_every_kind():
    assert complaints(1, 20_000) == []


@pytest.mark.slow
def test_a_million_boxes_of_every_kind():
    assert complaints(2, 1_000_000) == []
