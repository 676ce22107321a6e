"""Gauss-Legendre rules, and the number of nodes for a piece of a normal density."""

import numpy as np

from surefoot.sim.common.kernels import kernel

MOST = 64
"""Nodes of the largest rule; longer pieces are divided."""


MOST_PIECES = 15
"""Divisions of a window at most, which limits the run time for extreme boxes. Reached where
correlations are within 1e-8 of one.
"""


def _tables() -> tuple[np.ndarray, np.ndarray]:
    """Nodes on [0, 1] and weights of the rules with 2, 4 ... MOST points, concatenated."""
    rules = [np.polynomial.legendre.leggauss(n) for n in range(2, MOST + 1, 2)]
    return (
        np.concatenate([0.5 * (1.0 + x) for x, _ in rules]),
        np.concatenate([0.5 * w for _, w in rules]),
    )


NODES, WEIGHTS = _tables()


@kernel
def rule(length: float, scale: float, drop: float) -> tuple[int, int, int]:
    """Pieces to divide `length` into, then nodes of each piece and first index of its rule.

    For exp(-f) times a quadratic, where f has at most the curvature of a normal density with
    standard deviation `scale` and changes by at most `drop`. The numbers of nodes, 4.5 + 3.3 (half
    length / scale) for the density and 4 + 2.6 sqrt(drop) for an exponential, were found by trial
    for a relative error of 1e-12.
    """
    half = 0.5 * length / scale
    pieces = 1 + int(min(half / 12.0, MOST_PIECES))
    count = max(4.5 + 3.3 * half / pieces, 4.0 + 2.6 * np.sqrt(drop))
    pairs = min(int(np.ceil(0.5 * count)), MOST // 2)
    return pieces, 2 * pairs, pairs * (pairs - 1)


@kernel
def drop_between(left: float, right: float, best: float, inside: bool) -> float:
    """Largest change of a convex f over a piece.

    left, right: f at the ends; best: its minimum; inside: whether that is in the piece.
    """
    if inside:
        return max(left, right) - best
    return abs(left - right)
