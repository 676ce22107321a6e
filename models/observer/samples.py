"""Inputs and target of the observer, from a log at 100 Hz."""

from dataclasses import dataclass

import numpy as np

from surefoot.models.observer.decimate import decimate, observer_rows
from surefoot.models.observer.observer import ObserverError, signals
from surefoot.sim.log import Log, LogError, reference_velocity
from surefoot.sim.log.derived import JOINT_WINDOW, derivative

DQ_ZERO_PHASE = "dq (zero-phase)"
DQ_CAUSAL = "dq (causal)"


@dataclass(frozen=True)
class Samples:
    """A log at the observer's rows.

    Attributes:
        rows: indices into the log (M,).
        t: (M,) [s].
        x: unscaled signals for the inputs (M, S) (surefoot.models.observer.observer.signals);
            contacts are 0 to 1.
        causal_dq: whether dq among them was derived from q.
    """

    rows: np.ndarray
    t: np.ndarray
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
        log.require(*("imu" if name == "gyro" else name for name in read), *("q" * derives))
    except LogError as error:
        raise ObserverError(f"{error}; the observer reads {','.join(inputs)}") from None
    groups = {name: getattr(log, name) for name in read}
    if derives:
        groups["dq"] = derivative(log.t, log.q, JOINT_WINDOW, causal=True)
    groups = {name: groups[name] for name in wanted}
    causal_dq = derives or ("dq" in groups and DQ_CAUSAL in log.meta.derived)
    t = log.t
    rows = observer_rows(log)
    x = decimate(t, np.concatenate(list(groups.values()), axis=1), rows)
    return Samples(rows, t[rows], x, causal_dq)


def body_velocity(log: Log, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reference v_I = R_GI^T v_GI (M, 3) [m/s] at `rows`, and a mask of those that were measured
    (M,).

    Raises LogError where the log has no reference.
    """
    log.require("reference")
    v_I = np.einsum("mji,mj->mi", log.ref_R_GI[rows], reference_velocity(log)[rows])
    return v_I, log.ref_ok[rows]
