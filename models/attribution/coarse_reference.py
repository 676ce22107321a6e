"""How coarse a measured reference is, and a walk of the model seen by one that is as coarse.

Poses between two samples of a reference are interpolated, which bends at every sample: that shows
when those were. How much they err follows from the IMU, whose turns and gains of velocity between
samples hardly do. Simulated references have a sample a row.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation, Slerp

from surefoot.models.attribution.settings import DEFAULT, TraceSettings
from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.effects.base import with_columns
from surefoot.sim.log import Log


@dataclass(frozen=True)
class Coarse:
    """Times between samples of a reference (K,) [s], and the standard deviations of a sample's
    position [m] and attitude [rad], an error of its stamp included."""

    intervals: tuple[float, ...]
    position: float
    angle: float


def coarseness(log: Log, settings: TraceSettings = DEFAULT) -> Coarse | None:
    """How coarse the reference of a log is; None where it has a sample a row, or too few."""
    at = _samples(log, settings.bend)
    if len(at) < settings.coarse_samples or len(at) > settings.coarse_share * len(log.t):
        return None
    t = np.interp(at, np.arange(len(log.t)), log.t)
    intervals = np.diff(t)
    angle = position = 0.0
    if log.has("imu"):
        angle, position = _noise(log, t)
    return Coarse(tuple(np.round(intervals, 6)), position, angle)


def as_coarse(log: Log, coarse: Coarse, rng: np.random.Generator) -> Log:
    """The log with its reference sampled, in error and interpolated as in `coarse`."""
    t = log.t
    repeats = int(np.ceil((t[-1] - t[0]) / sum(coarse.intervals)))
    then = t[0] + np.cumsum(np.tile(coarse.intervals, repeats))
    then = np.concatenate([t[:1], then[then < t[-1]], t[-1:]])
    p_GI = _at(then, t, log.ref_p)
    p_GI += rng.normal(0.0, coarse.position, p_GI.shape)
    turned = Rotation.from_rotvec(rng.normal(0.0, coarse.angle, p_GI.shape))
    R_GI = Slerp(t, Rotation.from_matrix(log.ref_R_GI))(then) * turned
    q_GI = quaternion_from_matrix(Slerp(then, R_GI)(t).as_matrix())
    path = _at(t, then, p_GI)
    columns = {f"ref_p_{a}": path[:, i] for i, a in enumerate("xyz")}
    columns |= {f"ref_q_{a}": q_GI[:, i] for i, a in enumerate("wxyz")}
    return with_columns(log, columns)


def _samples(log: Log, bend: float) -> np.ndarray:
    """Rows (K,), between two of them, at which the reference's path bends."""
    slope = np.diff(log.ref_p, axis=0) / np.diff(log.t)[:, None]
    bent = 1 + np.flatnonzero(np.linalg.norm(np.diff(slope, axis=0), axis=1) > bend)
    bends = np.split(bent, np.flatnonzero(np.diff(bent) > 1) + 1)
    return np.array([np.mean(one) for one in bends if len(one)])


def _noise(log: Log, t: np.ndarray) -> tuple[float, float]:
    """Standard deviations of a sample's attitude [rad] and position [m], at the times t (K,) [s],
    by what the reference does between samples less what the IMU measures."""
    step = np.diff(t)[:, None]
    R_GI = Slerp(log.t, Rotation.from_matrix(log.ref_R_GI))(t)
    turn = (R_GI[:-1].inv() * R_GI[1:]).as_rotvec()
    turn -= np.diff(_at(t, log.t, _integral(log.gyro, log.t)), axis=0)
    force = np.einsum("nij,nj->ni", log.ref_R_GI, log.accel) + GRAVITY_G
    travelled = _integral(_integral(force, log.t), log.t)
    left = _at(t, log.t, log.ref_p - travelled)
    bend = np.diff(np.diff(left, axis=0) / step, axis=0)
    # What errors of one size at three samples do to the change of slope between them.
    spread = np.sqrt(1 / step[1:] ** 2 + 1 / step[:-1] ** 2 + (1 / step[1:] + 1 / step[:-1]) ** 2)
    return _level(turn) / np.sqrt(2.0), _level(bend / spread)


def _at(then: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """values (N, 3), of the times t (N,), at the times `then` (K,)."""
    return np.column_stack([np.interp(then, t, x) for x in values.T])


def _integral(values: np.ndarray, t: np.ndarray) -> np.ndarray:
    return cumulative_trapezoid(values, t, axis=0, initial=0.0)


def _level(values: np.ndarray) -> float:
    """Root mean square of all but the largest hundredth, less their mean."""
    square = np.sort(((values - values.mean(axis=0)) ** 2).ravel())
    return float(np.sqrt(square[: round(0.99 * len(square))].mean()))
