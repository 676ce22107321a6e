"""Random numbers that one generator would draw in long arrays in turn, drawn in pieces."""

from copy import deepcopy

import numpy as np

_AT_ONCE = 1 << 16  # numbers: half a megabyte


def deferred_normals(rng: np.random.Generator, count: int) -> np.random.Generator:
    """A generator of the next `count` normal numbers of `rng`, which is left behind them.

    How far a normal number takes a generator is not known before it is drawn: they are drawn twice.
    """
    own = deepcopy(rng)
    for first in range(0, count, _AT_ONCE):
        rng.standard_normal(min(_AT_ONCE, count - first))
    return own
