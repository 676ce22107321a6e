"""A foot's pad and its switch: contacts that are sensed late, each step by its own time, or early.

A pad must be squeezed before its switch closes: a contact begins when the load has given it an
impulse. Unloaded, it springs back slowly: the reading falls with a lag of first order, and a
contact ends when it has come down to the threshold. A pad that is long and soft touches the ground
before the foot carries anything.
"""

from collections.abc import Callable

import numpy as np

from surefoot.sim.common.kernels import kernel
from surefoot.sim.sensors.contact import swings

TOUCHING = 1.5
"""Times its threshold, load on a pad that is only touched."""
RECOVERY = 0.03
"""s, time constant with which a squeezed pad comes back in the air: within any swing."""


def begin_late(t: np.ndarray, force: np.ndarray, threshold: float, late: float) -> np.ndarray:
    """What is read (N, L) [N] by feet whose contacts begin late.

    Args:
        t: (N,) [s].
        force: (N, L) [N], loads on the feet.
        threshold: of contact [N].
        late: mean lateness over all steps [s].
    """
    dt = float(np.median(np.diff(t)))
    keep = float(np.exp(-dt / RECOVERY))

    def read(impulse: float) -> np.ndarray:
        return _squeezed(force, dt, threshold, impulse, keep)

    most = dt * float(force.max(initial=0.0)) * len(t)
    return _read_late(read, most, t, force > threshold, threshold, late, True)


def begin_early(t: np.ndarray, force: np.ndarray, threshold: float, early: float) -> np.ndarray:
    """What is read (N, L) [N] by feet whose contacts begin early, as of `begin_late`."""
    read, rows = force.copy(), round(early / float(np.median(np.diff(t))))
    for leg, stands in enumerate((force > threshold).T):
        for land in swings(t, stands)[1]:
            before = slice(max(land - rows, 0), land)
            read[before, leg] = np.maximum(read[before, leg], TOUCHING * threshold)
    return read


def end_late(t: np.ndarray, force: np.ndarray, threshold: float, late: float) -> np.ndarray:
    """What is read (N, L) [N] by feet whose contacts end late, as of `begin_late`."""
    dt = float(np.median(np.diff(t)))

    def read(lag: float) -> np.ndarray:
        return _springs_back(force, float(np.exp(-dt / lag)))

    return _read_late(read, dt * len(t), t, force > threshold, threshold, late, False)


def _read_late(
    read: Callable[[float], np.ndarray],
    most: float,
    t: np.ndarray,
    loaded: np.ndarray,
    threshold: float,
    late: float,
    begins: bool,
) -> np.ndarray:
    """The reading (N, L) of the pad with which contacts are late by `late` on the mean.

    Args:
        read: the reading of a pad of some size.
        most: a size that is surely too large.
        t: (N,) [s].
        loaded: (N, L) bool.
        threshold: of contact [N].
        late: mean lateness [s].
        begins: whether contacts begin late, or end late.
    """
    edges = [swings(t, stands)[begins] for stands in loaded.T]
    low, high = 1e-9 * most, most
    if not late or not sum(map(len, edges)):
        return read(low)
    dt = float(np.median(np.diff(t)))
    while high / low > 1.001:
        size = np.sqrt(low * high)
        stands = read(size) > threshold
        behind = [_first(stands[:, leg], rows, begins) - rows for leg, rows in enumerate(edges)]
        mean = dt * float(np.mean(np.concatenate(behind)))
        low, high = (size, high) if mean < late else (low, size)
    return read(low)


def _first(stands: np.ndarray, rows: np.ndarray, what: bool) -> np.ndarray:
    """The first row from each of `rows` (K,) on at which `stands` (N,) is as `what`; N without."""
    at = np.append(np.flatnonzero(stands == what), len(stands))
    return at[np.searchsorted(at, rows)]


@kernel
def _squeezed(force, dt, threshold, impulse, keep):
    """The loads (N, L) of feet whose pads have got their impulse, else nothing. Feet that stand
    from the first row on have theirs.

    Args:
        force: (N, L) [N].
        dt: time between rows [s].
        threshold: of contact [N].
        impulse: that closes the switch [N s].
        keep: share of it that is left after a row in the air.
    """
    out = force.copy()
    for leg in range(force.shape[1]):
        got = impulse if force[0, leg] > threshold else 0.0
        for k in range(1, len(force)):
            if force[k, leg] > threshold:
                got = min(got + dt * force[k, leg], impulse)
                if got < impulse:
                    out[k, leg] = 0.0
            else:
                got *= keep
    return out


@kernel
def _springs_back(force, keep):
    """The loads (N, L), followed at once where they grow, by a lag of first order where they fall;
    `keep` of the difference is left a row."""
    out = force.copy()
    for leg in range(force.shape[1]):
        for k in range(1, len(force)):
            behind = out[k - 1, leg] - force[k, leg]
            if behind > 0.0:
                out[k, leg] += keep * behind
    return out
