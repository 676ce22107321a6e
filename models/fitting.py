"""Weighted least squares on an evidence: sizes of effects, their errors, and what they gain."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.candidates import Evidence, Key
from models.masking import Trust, biases

BLOCK = 2.0
"""s; residuals of one step resemble the next step's, blocks of this length hardly each other."""


@dataclass(frozen=True)
class Whitened:
    """An evidence divided by its noise: y (M, 18), X (M, 18, C + B) with biases last, weight
    (M, 18), keys (C,), block (M,) a number for each stretch of BLOCK seconds."""

    y: np.ndarray
    X: np.ndarray
    weight: np.ndarray
    keys: tuple[Key, ...]
    block: np.ndarray

    def columns(self, keys: Sequence[Key]) -> list[int]:
        """Where these keys and all biases are in X."""
        return [self.keys.index(key) for key in keys] + list(range(len(self.keys), self.X.shape[2]))

    def rows(self, which: np.ndarray) -> "Whitened":
        """The part at some bins (mask or indices)."""
        return Whitened(
            self.y[which], self.X[which], self.weight[which], self.keys, self.block[which]
        )


def whiten(evidence: Evidence, trusted: Trust) -> Whitened:
    """The evidence in units of its noise, missing entries at weight zero."""
    sigma = trusted.sigma
    X = np.concatenate([evidence.X, biases(evidence)], axis=2) / sigma[:, None]
    block = np.floor((evidence.t - evidence.t.min()) / BLOCK).astype(int)
    return Whitened(
        y=np.where(np.isfinite(evidence.table), evidence.table, 0.0) / sigma,
        X=X,
        weight=trusted.weight,
        keys=evidence.keys,
        block=block + evidence.log * (block.max() + 1),
    )


@dataclass(frozen=True)
class Fit:
    """Sizes of the keys and then of the biases, (C + B,), with their covariance from blocks."""

    sizes: np.ndarray
    covariance: np.ndarray


def fit(data: Whitened, keys: Sequence[Key]) -> Fit:
    """Least squares of y on these keys and the biases; errors by the sandwich over blocks.

    A column that the data do not excite at all gets size zero and infinite variance.
    """
    columns = data.columns(keys)
    X = data.X[:, :, columns].reshape(-1, len(columns))
    w = data.weight.reshape(-1, 1)
    normal = X.T @ (X * w)
    scale = np.sqrt(np.diag(normal))
    dead = scale < 1e-9
    scale = np.where(dead, 1.0, scale)
    inverse = np.linalg.pinv(normal / scale / scale[:, None], rcond=1e-10) / scale / scale[:, None]
    sizes = inverse @ (X.T @ (w * data.y.reshape(-1, 1)))[:, 0]
    score = (X * (w * (data.y.reshape(-1, 1) - X @ sizes[:, None]))).reshape(len(data.y), 18, -1)
    _, number = np.unique(data.block, return_inverse=True)
    blocks = np.zeros((number.max() + 1, len(columns)))
    np.add.at(blocks, number, score.sum(axis=1))
    covariance = inverse @ (blocks.T @ blocks) @ inverse
    covariance[dead, dead] = np.inf
    return Fit(sizes, covariance)


def loss(data: Whitened, keys: Sequence[Key], sizes: np.ndarray) -> np.ndarray:
    """Weighted squared error of each bin (M,) once these keys and biases are taken off."""
    left = data.y - data.X[:, :, data.columns(keys)] @ sizes
    return np.sum(data.weight * left**2, axis=1)


def by_block(data: Whitened, values: np.ndarray) -> np.ndarray:
    """Sums of values (M,) over the blocks, (K,)."""
    _, number = np.unique(data.block, return_inverse=True)
    return np.bincount(number, weights=values)


def resampled(sums: np.ndarray, rng: np.random.Generator, draws: int = 1000) -> np.ndarray:
    """Totals (draws, ...) of block sums (K, ...) drawn with replacement: the block bootstrap."""
    pick = rng.integers(0, len(sums), (draws, len(sums)))
    counts = np.stack([np.bincount(row, minlength=len(sums)) for row in pick])
    return np.tensordot(counts, sums, axes=1)


def overlap(data: Whitened, one: Key, other: Key, given: Sequence[Key]) -> float:
    """Cosine (0..1) between two regressors once `given` and the biases are projected out of both.

    At one, no size of the other could be told from some size of the first with these data.
    """
    base = data.columns(given)
    w = np.sqrt(data.weight).reshape(-1, 1)
    pair = [data.keys.index(one), data.keys.index(other)]
    A = data.X[:, :, base].reshape(-1, len(base)) * w
    P = data.X[:, :, pair].reshape(-1, 2) * w
    P = P - A @ np.linalg.lstsq(A, P, rcond=1e-10)[0]
    norms = np.linalg.norm(P, axis=0)
    return float(abs(P[:, 0] @ P[:, 1]) / max(norms[0] * norms[1], 1e-300))
