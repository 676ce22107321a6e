"""Inputs and target of the observer: a log at 100 Hz.

The anti-alias filter is a Hann window over the last 20 ms. Its first zero is at 100 Hz, so what
would alias to zero frequency is removed, its gain is one half at 50 Hz, and its delay is 10 ms, one
step of the observer, at any rate of the log. The target is the undelayed velocity at the update row
itself; the observer learns to compensate for the delay.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from surefoot.models.observer.observer import ObserverError, signals
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log, LogError, reference_velocity
from surefoot.sim.log.derived import JOINT_WINDOW, derivative

RATE = 100.0
"""Rate of the observer and of the filters' velocity updates [Hz]."""
ANTI_ALIAS_SPAN = 0.020
"""Length of the anti-alias window [s]."""
DQ_ZERO_PHASE = "dq (zero-phase)"
DQ_CAUSAL = "dq (causal)"


class DecimationError(SurefootError):
    """A log too slow, or too short, for the observer's rate."""


def check_rate(rate: float, prefix: str = "") -> None:
    """Raise DecimationError, with a prefix, for a rate [Hz] below the observer's."""
    if rate < RATE * (1 - 1e-3):
        raise DecimationError(
            f"{prefix}sampled at {rate:g} Hz, the observer needs {RATE:g} Hz at least"
        )


def anti_alias(age: np.ndarray) -> np.ndarray:
    """Unnormalised weight of a sample that is `age` seconds old at the output's time."""
    inside = (age > -1e-9) & (age < ANTI_ALIAS_SPAN)
    return np.where(inside, np.sin(np.pi * age / ANTI_ALIAS_SPAN) ** 2, 0.0)


def observer_rows(log: Log) -> np.ndarray:
    """Row indices (M,) of the 100 Hz updates, strictly increasing.

    The grid starts at the first row, and each update takes the row nearest to its grid point; grid
    points inside a gap of the log have no update. Raises DecimationError where the log is slower
    than 100 Hz.
    """
    t = log.t
    check_rate(log.rate, f"{log.name}: ")
    step = 1.0 / RATE
    # Only grid points next to a row: over a gap of hours the whole grid would not fit into memory.
    last = int((t[-1] - t[0]) / step + 1e-3)
    below = np.floor((t - t[0]) / step).astype(int)
    grid = t[0] + step * np.unique(np.clip([below, below + 1], 0, last))
    after = np.clip(np.searchsorted(t, grid), 1, max(len(t) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(t) - 1)
    # Ties, within the nanosecond accuracy of stamps, go to the later row.
    rows = np.where(grid - t[before] < t[after] - grid - 1e-7, before, after)
    nearest = np.minimum(1.0 / log.rate, 0.5 * step)
    return np.unique(rows[np.abs(t[rows] - grid) <= nearest + 1e-7])


def decimate(t: np.ndarray, x: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Filtered samples (M, C) of x (N, C), in its unit, at `rows` (M,); t (N,) in seconds.

    Row m is the weighted mean of the samples within ANTI_ALIAS_SPAN before t[rows[m]], including
    that row, by the actual time stamps; at the start of the log, of those that exist.
    """
    first = np.searchsorted(t, t[rows] - ANTI_ALIAS_SPAN, side="right")
    back = np.arange(int((rows - first).max()) + 1 if len(rows) else 0)
    row = rows[:, None] - back
    inside, row = row >= first[:, None], np.maximum(row, 0)
    weights = np.where(inside, anti_alias(t[rows][:, None] - t[row]), 0.0)
    # One row of the matrix for each output.
    ends = len(back) * np.arange(len(rows) + 1)
    mean = csr_array((weights.ravel(), row.ravel(), ends), shape=(len(rows), len(t)))
    norm = mean @ np.ones(len(t))
    alone = norm <= 1e-6
    filtered = mean @ x / np.where(alone, 1.0, norm)[:, None]
    return np.where(alone[:, None], x[rows], filtered)


@dataclass(frozen=True)
class Samples:
    """A log at the observer's rows.

    Attributes:
        rows: indices into the log (M,).
        x: unscaled signals for the inputs (M, S) (surefoot.models.observer.observer.signals);
            contacts are 0 to 1.
        causal_dq: whether dq among them was derived from q.
    """

    rows: np.ndarray
    x: np.ndarray
    causal_dq: bool


def observer_samples(log: Log, inputs: tuple[str, ...]) -> Samples:
    """Anti-aliased signals of a log for these inputs (surefoot.models.observer.observer.INPUTS).

    Raises ObserverError naming the missing columns; nothing is filled in. Joint velocities that the
    log lacks are derived causally from q, and so are those that it declares as zero-phase
    derivatives, which look into the future.
    """
    wanted = signals(inputs)
    derives = "dq" in wanted and (DQ_ZERO_PHASE in log.meta.derived or not log.has("dq"))
    read = [name for name in wanted if not (derives and name == "dq")]
    try:
        log.require(*read, *("q" * derives))
    except LogError as error:
        raise ObserverError(f"{error}; the observer reads {','.join(inputs)}") from None
    groups = {name: getattr(log, name) for name in read}
    if derives:
        groups["dq"] = derivative(log.t, log.q, JOINT_WINDOW, causal=True)
    causal_dq = derives or ("dq" in groups and DQ_CAUSAL in log.meta.derived)
    rows, signal = observer_rows(log), np.concatenate([groups[name] for name in wanted], axis=1)
    return Samples(rows, decimate(log.t, signal, rows), causal_dq)


def body_velocity(log: Log, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reference v_I = R_GI^T v_GI (M, 3) [m/s] at `rows`, and a mask of those that were measured
    (M,).

    Raises LogError where the log has no reference.
    """
    log.require("reference")
    v_I = np.einsum("mji,mj->mi", log.ref_R_GI[rows], reference_velocity(log)[rows])
    return v_I, log.ref_ok[rows]
