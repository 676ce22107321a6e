"""Noise of sensors in pieces: normal numbers, and a first-order Gauss-Markov process."""

from copy import deepcopy

import numpy as np

from surefoot.sim.common.series import recursion

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


class GaussMarkov:
    """A stationary first-order Gauss-Markov process of three axes, drawn in pieces. The numbers do
    not depend on the pieces.
    """

    def __init__(self, rng: np.random.Generator, n: int, sigma: float, time: float, rate: float):
        """Advances `rng` as drawing the whole process would.

        Args:
            rng: random generator.
            n: total number of rows.
            sigma: stationary standard deviation, in the unit of the result.
            time: correlation time [s].
            rate: sampling rate [Hz].
        """
        self._keep = np.exp(-1.0 / (time * rate))
        self._drive = sigma * np.sqrt(1.0 - self._keep**2)
        self._rng = deferred_normals(rng, 3 * n)
        self._first: np.ndarray | None = rng.normal(0.0, sigma, 3)
        self._state = np.zeros(3)

    def next(self, rows: int) -> np.ndarray:
        """The next rows of the process, (rows, 3)."""
        drive = self._rng.normal(0.0, self._drive, (rows, 3))
        if self._first is not None:
            drive[0], self._first = self._first, None
        process, self._state = recursion(drive, 1.0, self._keep, self._state)
        return process
