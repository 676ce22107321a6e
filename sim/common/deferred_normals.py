"""Normal random numbers drawn in pieces, equal to those drawn in long arrays in turn."""

from copy import deepcopy

import numpy as np

_AT_ONCE = 1 << 16  # numbers: half a megabyte


def deferred_normals(rng: np.random.Generator, count: int) -> np.random.Generator:
    """A copy of `rng` for its next `count` normal numbers; `rng` itself is advanced past them.

    The state of a generator after some normal numbers is not known in advance, so they are drawn
    twice.
    """
    own = deepcopy(rng)
    for first in range(0, count, _AT_ONCE):
        rng.standard_normal(min(_AT_ONCE, count - first))
    return own
