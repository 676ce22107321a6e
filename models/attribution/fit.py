"""Weighted least squares on an evidence: sizes of effects, their covariance, and the gain.

Normal equations are summed over blocks of two seconds once; every combination of candidates is then
solved from these sums, without another pass over the data.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from surefoot.models.attribution.evidence import Evidence, Key
from surefoot.models.attribution.settings import DEFAULT, TraceSettings
from surefoot.sim.common.kernels import kernel

LEAST_EIGENVALUE = 1e-9
"""Share of the largest eigenvalue below which one of scaled normal equations counts as zero."""


@dataclass(frozen=True)
class Design:
    """An evidence sorted by column of the table.

    Attributes:
        evidence: the evidence.
        y: residuals, zero where missing.
        there: where the table has a value.
        which: per column, indices (k,) of the candidates and nuisance parameters that affect it.
        rows: per column, indices (n,) of the bins with a value.
        X: per column, their regressors (n, k).
    """

    evidence: Evidence
    y: np.ndarray  # (M, W), zero where missing
    there: np.ndarray  # (M, W)
    which: tuple[np.ndarray, ...]
    rows: tuple[np.ndarray, ...]
    X: tuple[np.ndarray, ...]

    @property
    def size(self) -> int:
        """Number of candidates and nuisance parameters."""
        return len(self.evidence.X) + len(self.evidence.Z)

    @cached_property
    def singles(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """X (n, k) and `which` (k,) of each column without groups, which are sums of their
        members.
        """
        single = self.evidence.single
        own = (single[which] for which in self.which)
        return tuple(
            (X, which) if one.all() else (np.ascontiguousarray(X[:, one]), which[one])
            for X, which, one in zip(self.X, self.which, own, strict=True)
        )

    def explained(self, sizes: np.ndarray) -> np.ndarray:
        """X sizes (M, W), for sizes (C + B,) of the candidates and nuisance parameters."""
        out = np.zeros_like(self.y)
        for column, (rows, X, which) in enumerate(zip(self.rows, self.X, self.which, strict=True)):
            out[rows, column] = X @ sizes[which]
        return out


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


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of K blocks.

    Attributes:
        G: Gram matrices (K, P, P) of the whitened residual, the candidates and the nuisance
            parameters, P = 1 + C + B.
        keys: the C candidates.
        limits: bounds of the nuisance parameters (B,).
        described_by: see `Evidence`.
        entries: number of table entries in each block (K,).
        part: part of the split that each block belongs to (K,).
        deviation_of: see `Evidence`.
        settings: of the trace.
    """

    G: np.ndarray
    keys: tuple[Key, ...]
    limits: np.ndarray
    described_by: tuple[Key | None, ...]
    entries: np.ndarray
    part: np.ndarray
    deviation_of: tuple[Key | None, ...] = ()
    settings: TraceSettings = DEFAULT

    @cached_property
    def whole(self) -> np.ndarray:
        """Gram matrix summed over all blocks (P, P)."""
        return self.G.sum(axis=0)

    def rows(self, which: np.ndarray) -> "NormalEquations":
        """Select blocks by a mask (K,) or indices."""
        return replace(self, G=self.G[which], entries=self.entries[which], part=self.part[which])

    def free_nuisance(self, keys: Sequence[Key]) -> list[int]:
        """Indices in G of the nuisance parameters that are free in a fit of these keys."""
        along = self.deviation_of or (None,) * len(self.described_by)
        return [
            1 + len(self.keys) + i
            for i, (one, other) in enumerate(zip(self.described_by, along, strict=True))
            if (one is None or one not in keys) and (other is None or other in keys)
        ]

    def by_run(self, key: Key, vector: np.ndarray) -> np.ndarray:
        """Deviation of a candidate's size in each log (L,) from the shared one, by a fit's
        `vector`; a zero (1,) where it has one size for all.
        """
        first = 1 + len(self.keys)
        own = -vector[[first + i for i, one in enumerate(self.deviation_of) if one == key]]
        return np.append(own, -own.sum())


def normal_equations(
    data: Design, sigma: np.ndarray, weight: np.ndarray, part: np.ndarray | None = None
) -> NormalEquations:
    """Sum a design over blocks, its columns having noise sigma (W,) and weight (M, W).

    part (M,): part of the split that each bin belongs to, negative for none.
    """
    evidence = data.evidence
    part = np.zeros(len(evidence.t), dtype=int) if part is None else part
    stretch = np.floor((evidence.t - evidence.t.min()) / evidence.settings.block).astype(int)
    number = (evidence.log * (stretch.max() + 1) + stretch) * (part.max() + 1) + part
    # In a short log the parts alternate faster than blocks end; each turn is its own block.
    turns = np.cumsum(np.diff(np.where(part < 0, -1, number), prepend=-1) != 0)
    label = np.where(part < 0, -1, turns)
    # The rows of a block are contiguous: `many` of them from `first` on.
    blocks, first, many = np.unique(label, return_index=True, return_counts=True)
    first, many = (x[blocks >= 0] for x in (first, many))
    return _summed(data, sigma, weight, part, first, many)


def total_normal_equations(data: Design, sigma: np.ndarray, weight: np.ndarray) -> NormalEquations:
    """Sum a design over all bins: enough for sizes, not for their covariance."""
    bins = len(data.y)
    part = np.zeros(bins, dtype=int)
    return _summed(data, sigma, weight, part, np.array([0]), np.array([bins]))


def _summed(
    data: Design,
    sigma: np.ndarray,
    weight: np.ndarray,
    part: np.ndarray,
    first: np.ndarray,
    many: np.ndarray,
) -> NormalEquations:
    """Normal equations of K blocks.

    Args:
        data: the design.
        sigma: noise of the columns (W,).
        weight: of the entries (M, W).
        part: part of the split that each bin belongs to (M,).
        first: first bin of each block (K,).
        many: number of its bins (K,).
    """
    evidence, size = data.evidence, 1 + data.size
    G = np.zeros((len(first), size, size))
    fitted = evidence.layout.fitted
    for column in fitted[weight[:, fitted].any(axis=0)]:
        rows, X, which = data.rows[column], data.X[column], data.which[column]
        begin, end = np.searchsorted(rows, first), np.searchsorted(rows, first + many)
        place = np.concatenate([[0], 1 + which])
        A = np.column_stack([data.y[rows, column], X]) / sigma[column]
        A = A * np.sqrt(weight[rows, column])[:, None]
        # Block by block, since adding to all at once strides through memory.
        for sums, i, j in zip(G, begin, end, strict=True):
            add_block(sums, place, A[i:j].T @ A[i:j])
    known = np.count_nonzero(weight[:, fitted], axis=1)
    entries = np.array([known[i : i + n].sum() for i, n in zip(first, many, strict=True)], float)
    parts = part[first].astype(int)
    return NormalEquations(
        G=G,
        keys=evidence.keys,
        limits=evidence.limits,
        described_by=evidence.described_by,
        entries=entries,
        part=parts,
        deviation_of=evidence.deviation_of,
        settings=evidence.settings,
    )


@kernel
def add_block(sums, place, block):
    """Add a block (k, k) to the rows and columns `place` (k,) of sums (P, P)."""
    for i in range(len(place)):
        for j in range(len(place)):
            sums[place[i], place[j]] += block[i, j]


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes:
        sizes: of the keys (C,).
        covariance: of the sizes (C, C), from the scatter between blocks.
        vector: (P,) one for the residual and minus each size; G vector is what remains.
    """

    sizes: np.ndarray
    covariance: np.ndarray
    vector: np.ndarray


def fit(
    data: NormalEquations,
    keys: Sequence[Key],
    errors: bool = True,
    given: Mapping[Key, float] | None = None,
) -> Fit:
    """Least squares of these keys and the nuisance parameters within their bounds.

    Other candidates are held at the sizes `given`. A nuisance parameter that describes the same
    error as one of the keys is dropped. A column without excitation gets size zero and infinite
    variance. The covariance is the sandwich estimator over blocks.
    """
    G = data.whole
    first = 1 + len(data.keys)
    own = [1 + data.keys.index(key) for key in keys]
    free = data.free_nuisance(keys)
    vector = np.zeros(len(G))
    vector[0] = 1.0
    held = [1 + data.keys.index(key) for key in given or ()]
    vector[held] = [-size for size in (given or {}).values()]
    while True:
        use = own + [f for f in free if f not in held]
        sizes, inverse, dead = _solve(G, vector, use, held)
        sized = [(f, s) for f, s in zip(use, sizes, strict=True) if f >= first]
        beyond = [(f, s) for f, s in sized if abs(s) > data.limits[f - first]]
        if not beyond:
            break
        for f, s in beyond:
            held.append(f)
            vector[f] = -np.sign(s) * data.limits[f - first]
    vector[use] = -sizes
    covariance = np.full((len(keys), len(keys)), np.nan)
    if errors:
        there = np.flatnonzero(vector)
        scores = data.G[:, np.array(use, dtype=int)[:, None], there] @ vector[there]
        covariance = (inverse @ (scores.T @ scores) @ inverse)[: len(keys), : len(keys)]
        covariance[dead[: len(keys)], dead[: len(keys)]] = np.inf
        # A bias effect is known no better than the declared turn-on bias that it replaces.
        for i, key in enumerate(keys):
            if key in data.described_by:
                limit = data.limits[data.described_by.index(key)]
                covariance[i, i] += (limit / data.settings.turn_on_limit) ** 2
    return Fit(sizes[: len(keys)], covariance, vector)


def _solve(G: np.ndarray, vector: np.ndarray, use: list[int], held: list[int]):
    known = [0, *held]
    right = G[np.ix_(use, known)] @ vector[known]
    normal = G[np.ix_(use, use)]
    scale = np.sqrt(np.maximum(np.diag(normal), 0.0))
    dead = scale < 1e-9
    scale = np.where(dead, 1.0, scale)
    inverse = _inverse(normal / scale / scale[:, None]) / scale / scale[:, None]
    return inverse @ right, inverse, dead


def _inverse(normal: np.ndarray) -> np.ndarray:
    """Inverse of a scaled normal matrix, its pseudo-inverse where it is nearly singular.

    The same up to rounding where no eigenvalue would be cut off, and several times faster.
    """
    with suppress(np.linalg.LinAlgError):
        inverse = np.linalg.inv(normal)
        # The product of the norms is at least the ratio of the largest eigenvalue to the smallest.
        if np.linalg.norm(normal) * np.linalg.norm(inverse) < 1.0 / LEAST_EIGENVALUE:
            return inverse
    return np.linalg.pinv(normal, rcond=LEAST_EIGENVALUE, hermitian=True)


def loss(data: NormalEquations, vector: np.ndarray) -> np.ndarray:
    """Weighted squared error (K,) of each block that remains with the sizes in `vector`."""
    there = np.flatnonzero(vector)
    return (data.G[:, there[:, None], there] @ vector[there]) @ vector[there]


def overlap(data: NormalEquations, one: Key, other: Key, given: Sequence[Key]) -> float:
    """Cosine (0 to 1) between two regressors after projecting out `given` and the nuisance
    parameters.

    At one, the data cannot distinguish the two candidates.
    """
    G = data.whole
    pair = [1 + data.keys.index(one), 1 + data.keys.index(other)]
    base = [1 + data.keys.index(key) for key in given]
    base += data.free_nuisance([*given, one, other])
    A, B = G[np.ix_(base, base)], G[np.ix_(base, pair)]
    scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
    inverse = _inverse(A / scale / scale[:, None])
    P = G[np.ix_(pair, pair)] - B.T @ (inverse / scale / scale[:, None]) @ B
    return float(abs(P[0, 1]) / max(np.sqrt(max(P[0, 0] * P[1, 1], 0.0)), 1e-300))
