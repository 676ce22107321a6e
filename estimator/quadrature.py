"""Gauss-Legendre rules, and how many nodes a bell of a given width needs."""

import numpy as np
from numba import njit

MOST = 64
"""Nodes of the largest rule; longer pieces are cut."""


def _tables() -> tuple[np.ndarray, np.ndarray]:
    """Nodes on [0, 1] and weights of the rules with 2, 4 ... MOST points, one after the other."""
    rules = [np.polynomial.legendre.leggauss(n) for n in range(2, MOST + 1, 2)]
    return (
        np.concatenate([0.5 * (1.0 + x) for x, _ in rules]),
        np.concatenate([0.5 * w for _, w in rules]),
    )


NODES, WEIGHTS = _tables()


@njit(cache=True)
def rule(length: float, scale: float) -> tuple[int, int, int]:
    """Pieces to cut `length` into, and the number of nodes and first table index for each.

    Integrates exp(-x^2/2) times a polynomial to 1e-12 where `scale` is its standard deviation,
    wherever the piece lies on the bell: 5.5 + 3.5 (half length / scale) nodes, found by trial.
    """
    half = 0.5 * length / scale
    pieces = 1 + int(half / 12.0)
    half /= pieces
    pairs = min(int(np.ceil(0.5 * (5.5 + 3.5 * half))), MOST // 2)
    return pieces, 2 * pairs, pairs * (pairs - 1)
