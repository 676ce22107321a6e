"""Streams, references and logs as they were at other times, and the lag of the reference behind the
gyro, from the rotations that both show.
"""

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from surefoot.sim.common.quaternion import continuous
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.log import Log
from surefoot.sim.log.schema import named_columns
from surefoot.sim.sensors.streams import Reference, Streams

STREAMS = {
    "imu": ("gyro", "accel"),
    "joints": ("q", "dq", "tau", "foot"),
    "feet": ("force", "contact"),
    "reference": ("ref",),
}
"""Readings of each stream, by the first word of a log's columns; positions of the feet belong to
the joints, and contacts to the feet's forces, from which they are derived.
"""


def streams_at(streams: Streams, names: tuple[str, ...], then: np.ndarray) -> Streams:
    """The streams with the readings `names`, as far as they have them, as they were at the times
    `then` (N,) [s].

    Linear interpolation would low-pass an IMU, unlike a delay, and would begin each contact early.
    """
    t = streams.t
    then = np.clip(then, t[0], t[-1])
    moved = {}
    for name in [name for name in names if hasattr(streams, name)]:
        x = getattr(streams, name)
        if name in STREAMS["imu"]:
            moved[name] = CubicSpline(t, x)(then)
        elif name in STREAMS["feet"]:
            moved[name] = x[_nearest(t, then)]
        else:
            moved[name] = interpolate_rows(then, t, x)
    return replace(streams, **moved)


def reference_at(reference: Reference, names: tuple[str, ...], then: np.ndarray) -> Reference:
    """The reference as it was at the times `then` (N,) [s], if `names` of readings have it."""
    if "ref" not in names:
        return reference
    t = reference.t
    then = np.clip(then, t[0], t[-1])
    turned = Slerp(t, Rotation.from_matrix(reference.R_GI))(then)
    p_GI, v_GI = (interpolate_rows(then, t, x) for x in (reference.p_GI, reference.v_GI))
    return Reference(t, turned.as_matrix(), p_GI, v_GI)


def log_at(log: Log, kinds: tuple[str, ...], then: np.ndarray) -> Log:
    """The log with the columns of these kinds resampled at the times `then` (N,) [s].

    A spline keeps the noise at any fraction of a sample, while linear interpolation would smooth it
    halfway between two. Flags are those of the nearest row.
    """
    t = log.t
    then = np.clip(then, t[0], t[-1])
    names = [n for n in log.columns if n.split("_")[0] in kinds and not _commanded(n)]
    flags = [n for n in names if n.startswith(("contact_", "ref_ok"))]
    turns = [n for n in names if n.startswith("ref_q_")]
    smooth = [n for n in names if n not in flags and n not in turns]
    columns = {}
    for kind in dict.fromkeys(name.split("_")[0] for name in smooth):
        of_kind = [n for n in smooth if n.split("_")[0] == kind]
        values = _spline(log, kind, of_kind)(then)
        columns |= dict(zip(of_kind, values.T, strict=True))
    columns |= {name: log.columns[name][_nearest(t, then)] for name in flags}
    if turns:
        values = CubicSpline(t, continuous(log.ref_q))(then)
        values /= np.linalg.norm(values, axis=1, keepdims=True)
        columns |= named_columns("ref_q", values, "wxyz")
    return log.with_columns(columns)


KEPT_ROWS = 100_000
"""Rows up to which a log keeps its splines: those of twelve joints then take a tenth of a GB."""


def _spline(log: Log, kind: str, names: list[str]) -> CubicSpline:
    """Spline through the columns of one kind: the delays and the clock of a stream are tried one
    after the other.
    """

    def made() -> CubicSpline:
        return CubicSpline(log.t, np.column_stack([log.columns[name] for name in names]))

    return log.once(f"spline of {kind}", names, made) if len(log.t) <= KEPT_ROWS else made()


def _nearest(t: np.ndarray, then: np.ndarray) -> np.ndarray:
    """Index of the row nearest to each time in `then` (N,) [s]."""
    return np.searchsorted(0.5 * (t[1:] + t[:-1]), then)


def _commanded(name: str) -> bool:
    return name.startswith(("q_des_", "dq_des_", "tau_ff_"))


LAG_PIECE = 4.0
"""Length of the pieces of a log over which the lag of a stream is taken to be constant [s]: a few
strides.
"""


FEWEST_LAGS = 6
"""Least number of lags for a drift: three meaningless lags look like a drift in a third of all
draws, six in 2 %.
"""


def reference_lag(log: Log, most: float) -> float:
    """Delay [s] of the reference's rotation relative to the gyro, up to +-`most`.

    Where their correlation is largest, to the row.
    """
    return _turning_lag(_turning(log), most)


class _Turning(NamedTuple):
    """Rotation of a body by its reference and by its gyro, in the K steps between rows.

    Attributes:
        duration: of each step (K,) [s].
        reference: angular rate by the reference (K, 3) [rad/s].
        gyro: angular rate by the gyro (K, 3) [rad/s].
    """

    duration: np.ndarray
    reference: np.ndarray
    gyro: np.ndarray

    def steps(self, which: slice) -> "_Turning":
        return _Turning(*(x[which] for x in self))


def _turning(log: Log) -> _Turning:
    turning, steps = Rotation.from_quat(log.ref_q, scalar_first=True), np.diff(log.t)
    turned = (turning[:-1].inv() * turning[1:]).as_rotvec() / steps[:, None]
    return _Turning(steps, turned, 0.5 * (log.gyro[1:] + log.gyro[:-1]))


def _turning_lag(turning: _Turning, most: float) -> float:
    from scipy.signal import fftconvolve  # which takes half a second to import

    turned, gyro = (x - x.mean(axis=0) for x in (turning.reference, turning.gyro))
    shared = fftconvolve(turned, gyro[::-1], axes=0).sum(axis=1)
    lags = np.arange(1 - len(gyro), len(turned)) * float(np.mean(turning.duration))
    near = np.abs(lags) <= most
    return float(lags[near][np.argmax(shared[near])])


def reference_lag_drift(log: Log, most: float) -> float:
    """Drift [s/s] of the reference's delay relative to the gyro, up to +-`most`.

    Median slope of the lags of pieces of the log (Theil-Sen). 0 if its 95 % interval contains 0, as
    it does if the pieces rotate too little to show a lag.
    """
    from scipy.stats import theilslopes  # which takes half a second to import

    duration = log.t[-1] - log.t[0]
    pieces = max(FEWEST_LAGS, round(duration / LAG_PIECE))
    ends = np.linspace(0, len(log.t), pieces + 1).round().astype(int)
    parts = [(i, j) for i, j in pairwise(ends) if j - i > 2]
    if len(parts) < FEWEST_LAGS:
        return 0.0
    turning = _turning(log)
    lags = [_turning_lag(turning.steps(slice(i, j - 1)), most * duration) for i, j in parts]
    line = theilslopes(lags, [log.t[i:j].mean() for i, j in parts])
    return float(line.slope) if line.low_slope * line.high_slope > 0.0 else 0.0
