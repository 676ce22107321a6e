"""Sampled series: low-pass filter, noise level, evenly spaced rows; noise drawn in pieces."""

from copy import deepcopy

import numpy as np

from surefoot.sim.common.kernels import kernel


def low_pass(x: np.ndarray, time: float, rate: float) -> np.ndarray:
    """Filter x (N, K), sampled at `rate` [Hz], with a first-order low-pass of time constant `time`
    [s], in equilibrium with its first sample.
    """
    return low_pass_from(None, x, time, rate)[0] if time > 0.0 else x


def low_pass_from(
    state: np.ndarray | None, x: np.ndarray, time: float, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Apply `low_pass` to a piece of the readings; also returns its state at the end.

    Args:
        state: at the end of the previous piece; None for the first.
        x: readings (N, K).
        time: time constant [s], above zero.
        rate: sampling rate [Hz].
    """
    keep = np.exp(-1.0 / (time * rate))
    state = keep * x[0] if state is None else state
    return recursion(np.ascontiguousarray(x, dtype=float), 1.0 - keep, keep, state)


@kernel
def recursion(x, gain, keep, state):
    """First-order recursion y[n] = gain x[n] + keep y[n-1] of x (N, K), each column by itself.

    Args:
        x: (N, K).
        gain: of the input.
        keep: of the output before.
        state: (K,), keep times the output before the first row.

    Returns y (N, K) and the state after the last row.
    """
    out, state = np.empty_like(x), state.copy()
    for n in range(len(x)):
        for k in range(x.shape[1]):
            out[n, k] = state[k] + gain * x[n, k]
            state[k] = keep * out[n, k]
    return out, state


def without_low_pass(x: np.ndarray, time: float, rate: float) -> np.ndarray:
    """Inverse of `low_pass`, for filtered readings x (N, K); amplifies noise added after the
    filter.

    time: time constant [s]; rate: sampling rate [Hz].
    """
    if not time > 0.0:
        return x
    keep = np.exp(-1.0 / (time * rate))
    return np.concatenate([x[:1], (x[1:] - keep * x[:-1]) / (1.0 - keep)])


def white_noise(x: np.ndarray) -> np.ndarray:
    """Standard deviation (...,) of the white noise of readings x (N, ...), N >= 3.

    The second difference has six times the variance of the noise, and little of the motion.
    """
    return np.std(np.diff(x, n=2, axis=0), axis=0) / np.sqrt(6.0)


def rows_every(t: np.ndarray, period: float) -> np.ndarray:
    """Increasing rows of t (N,) [s]: for each multiple of `period` [s] after t[0], the first row at
    or after it.
    """
    rows = np.searchsorted(t, np.arange(t[0], t[-1], period))
    # Rounding may put the last time after the last row.
    return np.unique(np.minimum(rows, len(t) - 1))


def interpolate_rows(then: np.ndarray, t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Values (K, ...) at the times `then` (K,), linear between those of x (N, ...) at t (N,)."""
    columns = [np.interp(then, t, column) for column in x.reshape(len(x), -1).T]
    return np.stack(columns, axis=1).reshape(len(then), *x.shape[1:])


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


SHORTEST_TIME = 1e-6
"""Shortest correlation time of a process [s], which is white noise at any rate."""


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
