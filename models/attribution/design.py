"""An evidence sorted by column, and sums of products over its rows."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from surefoot.models.attribution.evidence import Evidence
from surefoot.sim.common.kernels import kernel

TURN_ON_LIMIT = 4.5
"""Standard deviations of a turn-on bias beyond which it is an effect."""
FREE = 1e-9
"""Precision of a nuisance parameter without a prior."""


@dataclass(frozen=True)
class Design:
    """An evidence sorted by column of the table.

    Attributes:
        evidence: the evidence.
        y: residuals (M, W), zero where missing.
        there: where the table has a value (M, W).
        which: per column, indices (k,) of the candidates and nuisance parameters that affect it.
        rows: per column, indices (n,) of the bins with a value.
        X: per column, their regressors (n, k).
    """

    evidence: Evidence
    y: np.ndarray
    there: np.ndarray
    which: tuple[np.ndarray, ...]
    rows: tuple[np.ndarray, ...]
    X: tuple[np.ndarray, ...]

    @property
    def size(self) -> int:
        """Number of candidates and nuisance parameters."""
        return len(self.evidence.X) + len(self.evidence.Z)

    def explained(self, sizes: np.ndarray) -> np.ndarray:
        """X sizes (M, W), for sizes (C + B,) of the candidates and nuisance parameters."""
        out = np.zeros_like(self.y)
        for column, (rows, X, which) in enumerate(zip(self.rows, self.X, self.which, strict=True)):
            out[rows, column] = X @ sizes[which]
        return out

    def grams(
        self, y: np.ndarray, root: np.ndarray, columns: Iterable[int], part: np.ndarray
    ) -> np.ndarray:
        """Products (K, P, P), P = 1 + C + B, of y, candidates and nuisance parameters over the
        bins of each of K parts.

        Args:
            y: (M, W).
            root: factor of each entry (M, W).
            columns: of the table that are used.
            part: number (M,) of the part of each bin, which does not decrease.
        """
        G = np.zeros((part.max(initial=0) + 1, 1 + self.size, 1 + self.size))
        for c, k, rows, X in self._parts(columns, part):
            weight, known = root[rows, c] ** 2, y[rows, c]
            weighted = X * weight[:, None]
            right = known @ weighted
            add_block(G[k], 1 + self.which[c], weighted.T @ X)
            G[k, 0, 0] += known @ (weight * known)
            G[k, 0, 1 + self.which[c]] += right
            G[k, 1 + self.which[c], 0] += right
        return G

    def products(self, values: np.ndarray, columns: Iterable[int], part: np.ndarray) -> np.ndarray:
        """Products (K, C + B, n) of candidates and nuisance parameters with values (n, M, W), as of
        `grams`.
        """
        out = np.zeros((part.max(initial=0) + 1, self.size, len(values)))
        for c, k, rows, X in self._parts(columns, part):
            out[k, self.which[c]] += X.T @ values[:, rows, c].T
        return out

    def _parts(
        self, columns: Iterable[int], part: np.ndarray
    ) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
        """Column, number of a part, its bins with a value (n,), and their regressors (n, k)."""
        ends = np.arange(part.max(initial=0) + 2)
        for c in columns:
            rows = self.rows[c]
            for k, (i, j) in enumerate(pairwise(np.searchsorted(part[rows], ends))):
                if j > i:
                    yield c, k, rows[i:j], self.X[c][i:j]


def design(evidence: Evidence) -> Design:
    """Sort an evidence by column."""
    there = np.isfinite(evidence.table)
    which: list[list[int]] = [[] for _ in range(evidence.layout.width)]
    X: list[list[np.ndarray]] = [[] for _ in range(evidence.layout.width)]
    for i, one in enumerate((*evidence.X, *evidence.Z)):
        for n, column in enumerate(one.columns):
            which[column].append(i)
            X[column].append(one.values[:, n])
    rows = [np.flatnonzero(column) for column in there.T]
    stacked = [
        np.column_stack([one[here] for one in x]) if x else np.zeros((len(here), 0))
        for x, here in zip(X, rows, strict=True)
    ]
    return Design(
        evidence,
        np.where(there, evidence.table, 0.0),
        there,
        tuple(np.array(w, dtype=int) for w in which),
        tuple(rows),
        tuple(stacked),
    )


@kernel
def add_block(sums, place, block):
    """Add a block (k, k) to the rows and columns `place` (k,) of sums (P, P)."""
    for i in range(len(place)):
        for j in range(len(place)):
            sums[place[i], place[j]] += block[i, j]


def scaled_inverse(A: np.ndarray) -> np.ndarray:
    """Inverse of a positive definite matrix whose entries differ by orders of magnitude."""
    scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
    inverse = np.linalg.inv(A / scale / scale[:, None] + 1e-12 * np.eye(len(A)))
    return inverse / scale / scale[:, None]


def nuisance_precision(evidence: Evidence) -> np.ndarray:
    """Prior precision (B,) of the nuisance parameters."""
    return np.maximum(np.maximum(evidence.deviations, 1e-12) ** -2.0, FREE)


def without_nuisance(
    evidence: Evidence, sigma: np.ndarray, weight: np.ndarray, use: np.ndarray
) -> np.ndarray:
    """Residual table (M, W) less the nuisance parameters; NaN where an entry has no weight.

    Args:
        evidence: with the effects compensated.
        sigma: noise of the columns (W,).
        weight: of the entries (M, W).
        use: mask (M,) of the bins that the nuisance parameters are fitted on.
    """
    data = design(evidence.only(()))
    root = np.sqrt(weight * use[:, None]) / sigma
    (G,) = data.grams(data.y, root, evidence.layout.fitted, np.zeros(len(root), int))
    limits = TURN_ON_LIMIT * evidence.deviations
    inner = G[1:, 1:] + np.diag(nuisance_precision(evidence))
    sizes = scaled_inverse(inner) @ G[1:, 0]
    if (beyond := np.abs(sizes) > limits).any():
        # What is beyond its limit is for an effect to explain.
        held, free = np.clip(sizes, -limits, limits)[beyond], ~beyond
        right = G[1:, 0][free] - inner[np.ix_(free, beyond)] @ held
        sizes[beyond] = held
        sizes[free] = scaled_inverse(inner[np.ix_(free, free)]) @ right
    left = np.where(data.there, data.y - data.explained(sizes), np.nan)
    return np.where(weight > 0, left, np.nan)
