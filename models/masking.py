"""Which parts of a residual to believe: robust weights, and stances on which a foot slid.

Both are judged by what the whole catalogue together cannot explain, so that neither can hide an
effect of the catalogue: a mask takes a stance that stands out from its own foot's bulk, not a foot
that is wrong at every step.
"""

from dataclasses import dataclass

import numpy as np

from models.candidates import Evidence
from models.residual import BIN

GROUPS = (slice(0, 3), slice(3, 6), *(slice(6 + 3 * leg, 9 + 3 * leg) for leg in range(4)))
"""Columns that one reading fills: gyro, accelerometer, each foot."""
SOFT = 2.5
"""Standard deviations beyond which an entry loses weight."""
OUTLYING = 6.0
"""Robust deviations above the foot's median at which a stance is taken for a slip."""
SLOWEST_SLIP = 0.02
"""m/s. Below this a standing foot creeps, as compliant contacts do."""


@dataclass(frozen=True)
class Trust:
    """sigma (18,): noise of each column in the residual's unit; weight (M, 18) in 0..1, zero where
    missing or masked; masked (M, 4): foot bins taken for slips, of which share is the share."""

    sigma: np.ndarray
    weight: np.ndarray
    masked: np.ndarray
    share: float


def trust(evidence: Evidence, floor: np.ndarray) -> Trust:
    """Weights of an evidence whose columns the declared model leaves at `floor` (18,)."""
    table = evidence.table
    there = np.isfinite(table)
    y = np.where(there, table, 0.0)
    masked = np.zeros((len(table), 4), dtype=bool)
    sigma, weight, left = floor.copy(), there.astype(float), y
    for last in (False, True):
        for _ in range(6):
            left = y - _explained(evidence, y / sigma, weight, sigma)
            left[~there] = np.nan
            sigma = np.maximum(floor, _pooled(left, masked))
            weight = there * _soft(left / sigma)
            for leg in range(4):
                weight[masked[:, leg], GROUPS[2 + leg]] = 0.0
        if not last:
            masked = slips(evidence, left, sigma)
    standing = there[:, 6::3].sum()
    return Trust(sigma, weight, masked, float(masked.sum() / max(standing, 1)))


def slips(evidence: Evidence, left: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Foot bins (M, 4) of the stances that stand out from their foot's own bulk.

    left (M, 18): what the catalogue does not explain. The score of a stance is the speed of
    its fastest bin: a foot that slides sticks again before the stance is over, and a mean over the
    stance would leave every second slip in.
    """
    masked = np.zeros((len(left), 4), dtype=bool)
    for leg in range(4):
        speed = np.sqrt(np.sum(left[:, GROUPS[2 + leg]] ** 2, axis=1))
        stances = stance_bins(evidence, np.isfinite(speed))
        if len(stances) < 5:
            continue
        score = np.array([speed[bins].max() for bins in stances])
        middle = np.median(score)
        # From below: slips only add speed, and many of them would widen a spread from both sides.
        spread = 1.4826 * (middle - np.quantile(score, 0.25))
        limit = max(middle + OUTLYING * spread, SLOWEST_SLIP)
        for bins, size in zip(stances, score, strict=True):
            masked[bins, leg] = size > limit
    return masked


def stance_bins(evidence: Evidence, standing: np.ndarray) -> list[np.ndarray]:
    """Runs of consecutive bins with standing (M,) true, as index arrays, one a stance."""
    rows = np.flatnonzero(standing)
    if not len(rows):
        return []
    apart = (np.diff(evidence.t[rows]) > 1.5 * BIN) | (np.diff(evidence.log[rows]) != 0)
    return np.split(rows, np.flatnonzero(apart) + 1)


def _explained(evidence: Evidence, y: np.ndarray, weight: np.ndarray, sigma: np.ndarray):
    """Best joint fit of every candidate and bias to the whitened y (M, 18), in the table's unit."""
    X = np.concatenate([evidence.X, biases(evidence)], axis=2) / sigma[:, None]
    A = (X * weight[:, :, None]).reshape(-1, X.shape[2])
    normal = A.T @ X.reshape(A.shape)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    # A ridge far below what data say keeps twins apart without moving anything that they tell.
    normal = normal / size / size[:, None] + 1e-9 * np.eye(len(size))
    fit = np.linalg.solve(normal, A.T @ y.ravel() / size) / size
    return (X @ fit) * sigma


def biases(evidence: Evidence) -> np.ndarray:
    """Z with columns of its own for each log, (M, 18, 6 L)."""
    logs = range(int(evidence.log.max()) + 1)
    return np.concatenate([evidence.Z * (evidence.log == i)[:, None, None] for i in logs], axis=2)


def _pooled(left: np.ndarray, masked: np.ndarray) -> np.ndarray:
    """Robust standard deviation of each column, that of a foot's axis over all feet."""
    sigma = np.empty(18)
    left = left.copy()
    for leg in range(4):
        left[masked[:, leg], GROUPS[2 + leg]] = np.nan
    columns = [[i] for i in range(6)] + [list(range(6 + axis, 18, 3)) for axis in range(3)]
    for group in columns:
        values = np.abs(left[:, group])
        values = values[np.isfinite(values)]
        sigma[group] = 1.4826 * np.median(values) if len(values) else 0.0
    return sigma


def _soft(z: np.ndarray) -> np.ndarray:
    """Weights (M, 18): one for the bulk, falling as the inverse square beyond SOFT deviations."""
    weight = np.ones_like(z)
    for group in GROUPS:
        size = np.sqrt(np.nansum(z[:, group] ** 2, axis=1) / 3)
        weight[:, group] = np.minimum(1.0, (SOFT / np.maximum(size, SOFT)) ** 2)[:, None]
    return weight
