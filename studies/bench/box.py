"""Box moments compared with the paper's randomized quasi-Monte Carlo, by kind of box."""

from functools import partial

import numpy as np

from studies.bench.ratio import SAMPLES, Progress, Ratio, in_turn, part_of
from studies.montecarlo.qmc import evaluate_boxes, ordinary_boxes, tensor_moments

_BOXES = 100
Boxes = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Means (B, 3), covariances (B, 3, 3), lower and upper bounds (B, 3)."""
TARGET = 15.0


def box_rows(rounds: int, progress: Progress | None = None) -> list[Ratio]:
    """One line for each kind of box: the time of all its boxes, ours and by sampling."""
    kinds = box_kinds(np.random.default_rng(4), _BOXES)
    rows = []
    for number, (name, boxes) in enumerate(kinds.items()):
        shifts = np.random.default_rng(5).random((1, _BOXES, 3))
        run_ours = partial(evaluate_boxes, *boxes, 0, shifts)
        run_qmc = partial(evaluate_boxes, *boxes, SAMPLES, shifts)
        part = part_of(progress, number, len(kinds))
        fast, slow = in_turn(run_ours, run_qmc, rounds, part)
        ours, theirs = run_ours(), run_qmc()
        note = f"{1e6 * fast / _BOXES:.1f} us a box"
        if name == "ordinary":
            note += f"; {less_error(boxes, ours, theirs):.0e} times less error of the covariance"
        elif not np.isfinite(theirs[0]).all() or not np.isfinite(theirs[2]).all():
            note += f"; no number from the samples in {np.isnan(theirs[2][0, :, 0, 0]).mean():.0%}"
        rows.append(Ratio(f"box moments, {name}", f"QMC, N = {SAMPLES}", slow / fast, TARGET, note))
    return rows


def box_kinds(rng: np.random.Generator, count: int) -> dict[str, Boxes]:
    """Means, covariances, lower and upper bounds by name, in units of the prior's deviations.

    Unless the name says otherwise: correlations of a random factor (`ordinary_boxes`), half widths
    of 0.5 to 2 deviations, centres within one.
    """
    zero, covs, lower, upper = ordinary_boxes(rng, count)
    centre, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    eye = np.broadcast_to(np.eye(3), covs.shape)
    wide = rng.uniform(3.0, 6.0, (count, 3))
    narrow = 10.0 ** rng.uniform(-3.0, -0.5, (count, 3))
    mixed = 10.0 ** rng.uniform(-2.0, 1.0, (count, 3))
    direction = rng.standard_normal((count, 3))
    direction *= 8.0 / np.linalg.norm(direction, axis=1, keepdims=True)
    open_lower, open_upper = lower.copy(), upper.copy()
    which = rng.integers(0, 4, (count, 3))
    open_lower[(which == 1) | (which == 3)] = -np.inf
    open_upper[(which == 2) | (which == 3)] = np.inf
    like_filter = 0.8 * eye + 0.2 * covs
    return {
        "like a filter's": (zero, like_filter, centre - 1.3 * half, centre + 1.3 * half),
        "ordinary": (zero, covs, lower, upper),
        "narrow": (zero, covs, centre - narrow, centre + narrow),
        "wide, 3 to 6 sigma": (zero, covs, centre - wide, centre + wide),
        "narrow and wide mixed": (zero, covs, centre - mixed, centre + mixed),
        "a pair correlated 0.9": (zero, _pair(rng, count, 0.9), lower, upper),
        "a pair correlated 0.999": (zero, _pair(rng, count, 0.999), lower, upper),
        "all correlated 0.9": (zero, 0.1 * eye + 0.9, lower, upper),
        "all correlated 0.999": (zero, 0.001 * eye + 0.999, lower, upper),
        "8 sigma away": (zero, covs, direction - half, direction + half),
        "infinite bounds": (zero, covs, open_lower, open_upper),
    }


def less_error(boxes, ours, theirs) -> float:
    """RMS error of the sampled covariances over that of ours.

    Over the boxes whose covariance has a determinant above 0.03, where the reference, a tensor rule
    of 48 nodes per axis, is accurate.
    """
    clear = np.linalg.det(boxes[1]) > 0.03
    exact = np.array([tensor_moments(*box)[2] for box in zip(*boxes, strict=True)])
    wrong = [np.linalg.norm((found[2][0] - exact)[clear]) for found in (theirs, ours)]
    return float(wrong[0] / wrong[1])


def _pair(rng: np.random.Generator, count: int, rho: float) -> np.ndarray:
    """Correlation matrices (B, 3, 3) with one pair at +-rho and the third axis moderately
    correlated.
    """
    sign = rng.choice([-1.0, 1.0], count)
    first, rest = rng.uniform(-0.6, 0.6, (2, count))
    covs = np.zeros((count, 3, 3)) + np.eye(3)
    covs[:, 0, 1] = covs[:, 1, 0] = sign * rho
    covs[:, 0, 2] = covs[:, 2, 0] = first
    left = np.sqrt((1.0 - rho**2) * (1.0 - first**2))
    covs[:, 1, 2] = covs[:, 2, 1] = sign * rho * first + rest * left
    return covs
