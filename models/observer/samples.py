"""Inputs and target of the observer: arrays of a log at 100 Hz."""

from dataclasses import dataclass

import numpy as np

from surefoot.models.observer.decimate import decimate, observer_rows
from surefoot.models.observer.observer import ObserverError, check_inputs, signals
from surefoot.sim.log import Log, LogError, reference_velocity
from surefoot.sim.log.derived import JOINT_WINDOW, derivative

DQ_ZERO_PHASE = "dq (zero-phase)"
DQ_CAUSAL = "dq (causal)"


@dataclass(frozen=True)
class Samples:
    """A log at the observer's rows.

    rows (M,) into the log; t (M,), s; x (M, S) what the inputs are made of
    (surefoot.models.observer.observer.signals), unscaled; causal_dq: whether dq among them was
    derived from q.
    """

    rows: np.ndarray
    t: np.ndarray
    x: np.ndarray
    causal_dq: bool


def observer_samples(log: Log, inputs: tuple[str, ...]) -> Samples:
    """Anti-aliased signals of a log for these inputs.

    Raises ObserverError naming what the log lacks; nothing is filled.

    Joint velocities that the log declares as derived without phase look into the future: they are
    derived again, causally, from q.
    """
    inputs = check_inputs(inputs)
    try:
        log.require(*signals(inputs))
    except LogError as error:
        hint = (
            "; surefoot.sim.log.with_velocities derives dq"
            if log.has("q") and not log.has("dq")
            else ""
        )
        raise ObserverError(f"{error}; the observer reads {','.join(inputs)}{hint}") from None
    groups = {name: getattr(log, name) for name in signals(inputs)}
    if "dq" in groups and DQ_ZERO_PHASE in log.meta.derived:
        groups["dq"] = derivative(log.t, log.q, JOINT_WINDOW, causal=True)
    causal_dq = "dq" in groups and bool({DQ_ZERO_PHASE, DQ_CAUSAL} & set(log.meta.derived))
    t = log.t
    rows = observer_rows(log)
    x = decimate(t, np.concatenate(list(groups.values()), axis=1), rows)
    return Samples(rows, t[rows], x, causal_dq)


def body_velocity(log: Log, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reference v_I = R_GI^T v_GI (M, 3), m/s, at `rows`, and which of them were measured (M,).

    Raises LogError where the log has no reference.
    """
    log.require("reference")
    v_I = np.einsum("mji,mj->mi", log.ref_R_GI[rows], reference_velocity(log)[rows])
    return v_I, log.ref_ok[rows]
