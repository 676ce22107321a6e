"""Gauss-Legendre rules, and the number of nodes for a piece of a bell curve."""

import numpy as np

from surefoot.sim.common.kernels import kernel

MOST = 64
"""Nodes of the largest rule; longer pieces are divided."""


MOST_PIECES = 15
"""Limits the run time for extreme boxes; reached where correlations are within 1e-8 of one."""


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
    """Number of pieces to divide `length` into, and the number of nodes and first table index of
    each.

    For exp(-f) times a quadratic, where f has at most the curvature of a bell with deviation
    `scale` and changes by at most `drop`. Determined by trial, for 1e-12: a whole bell needs 5.5 +
    3.5 (half length / scale) nodes, an exponential that drops by exp(-d) needs 4.5 + 2.7 sqrt(d).
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
