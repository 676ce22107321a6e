"""A foot's pad and contact switch, whose contacts begin or end late, or begin early.

A contact begins late because the load must first compress the pad by a certain impulse. It ends
late because the unloaded pad recovers slowly: the reading falls with a first-order lag down to the
threshold. It begins early if a long, soft pad touches the ground before the foot is loaded. The
delay thus varies from step to step.
"""

import numpy as np

from surefoot.sim.common.kernels import kernel
from surefoot.sim.sensors.stances import swings

TOUCHING = 1.5
"""Load on a pad that only touches, as a multiple of its threshold."""
RECOVERY = 0.03
"""Time constant of a compressed pad's recovery in the air [s], shorter than any swing."""


def late_contacts(
    t: np.ndarray, force: np.ndarray, threshold: float, late: float, begins: bool
) -> np.ndarray:
    """Readings (N, L) [N] of feet whose contacts begin late, or end late, on pads whose size is
    found by bisection.

    Args:
        t: (N,) [s].
        force: loads on the feet (N, L) [N].
        threshold: of contact [N].
        late: mean delay over all steps [s].
        begins: whether contacts begin late, or end late.
    """
    dt = float(np.median(np.diff(t)))
    keep, most = float(np.exp(-dt / RECOVERY)), dt * len(t)
    if begins:
        most = dt * float(force.max(initial=0.0)) * len(t)

    def read(size: float) -> np.ndarray:
        if begins:
            return _squeezed(force, dt, threshold, size, keep)
        return _springs_back(force, float(np.exp(-dt / size)))

    edges = [swings(t, stands)[begins] for stands in (force > threshold).T]
    low, high = 1e-9 * most, most
    if not late or not sum(map(len, edges)):
        return read(low)
    while high / low > 1.001:
        size = np.sqrt(low * high)
        stands = read(size) > threshold
        behind = [_first(stands[:, leg], rows, begins) - rows for leg, rows in enumerate(edges)]
        mean = dt * float(np.mean(np.concatenate(behind)))
        low, high = (size, high) if mean < late else (low, size)
    return read(low)


def begin_early(t: np.ndarray, force: np.ndarray, threshold: float, early: float) -> np.ndarray:
    """Readings (N, L) [N] of feet whose contacts begin early; arguments as of `late_contacts`."""
    read, rows = force.copy(), round(early / float(np.median(np.diff(t))))
    for leg, stands in enumerate((force > threshold).T):
        for land in swings(t, stands)[1]:
            before = slice(max(land - rows, 0), land)
            read[before, leg] = np.maximum(read[before, leg], TOUCHING * threshold)
    return read


def _first(stands: np.ndarray, rows: np.ndarray, what: bool) -> np.ndarray:
    """For each of `rows` (K,), the first row from it on at which `stands` (N,) equals `what`; N
    if none.
    """
    at = np.append(np.flatnonzero(stands == what), len(stands))
    return at[np.searchsorted(at, rows)]


@kernel
def _squeezed(force, dt, threshold, impulse, keep):
    """The loads (N, L) of feet whose pads are compressed, zero for the others. Feet that stand in
    the first row are compressed.

    Args:
        force: (N, L) [N].
        dt: time between rows [s].
        threshold: of contact [N].
        impulse: that closes the switch [N s].
        keep: share of it that remains after a row in the air.
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
    """The loads (N, L), with a first-order lag where they fall: a share `keep` of the difference
    remains after each row.
    """
    out = force.copy()
    for leg in range(force.shape[1]):
        for k in range(1, len(force)):
            behind = out[k - 1, leg] - force[k, leg]
            if behind > 0.0:
                out[k, leg] += keep * behind
    return out
