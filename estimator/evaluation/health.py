"""Tests whether an estimate is trustworthy, from the filter's own record, without a reference.

A filter whose model is correct has white innovations with the claimed covariance, and biases that
stay within their priors. Real filters are tuned by hand and deviate by some factor, which is
reported (`Health.table`) but raises no alarm. The tests fail only if a filter whose claimed
standard deviations are TOLERATED times too small would fail them in less than RUN_ALARM of all
runs. Each test states when it failed first.

- Innovations. Over a window, the sum of white innovations r has the variance sum W, axis by axis,
  so (sum r)^2 / sum W over three axes is chi-square with 3 degrees of freedom, whatever the
  correlations within a stride: windows are the independent samples. It is the sum that moves the
  estimate. The mean of r^T W^-1 r (NIS) is reported as well, but filters whose noise covers
  systematic errors keep it far below its expectation while they are wrong.
- Corrections. Sensors without recorded innovations are judged by their effect: how far updates move
  the velocity from the IMU's prediction, compared with the claimed errors of tilt and
  accelerometer.
- Biases. b(t) - b(0) has at most the covariance of the prior and of the random walk since.
- Rejections. If all feet are rejected for a second, or more than half of a sensor's measurements,
  the estimate or the sensor is wrong (half is the breakdown point of any robust estimate).
- Training. An observer that was trained on many walks knows how far a further one is from these.
- Speed, variances that are not positive, estimates that are not finite.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtri, ndtri

from surefoot.estimator.evaluation.innovation_sums import (
    COUNT,
    LEFT_OUT,
    RESTARTED,
    SQUARED,
    SUM,
    SUM_WINDOW,
    VARIANCE,
    windows_of,
)
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.sim.common.gravity import GRAVITY, GRAVITY_G
from surefoot.sim.log import Log

ACCEL_NOISE = 0.03
"""Largest accelerometer noise density of the bundled filters [m/s^2/sqrt(Hz)]."""
_MERGED = {
    "start": np.minimum,
    "sums": np.add,
    "speed": np.maximum,
    "pushed": np.add,
    "push_claimed": np.maximum,
    "definite": np.logical_and,
    "unlike": np.fmax,
}
"""How the values of a window that lies in two pieces of a run are combined. The biases of the later
piece are kept.
"""
RUN_ALARM = 1e-4
"""Probability that one of the tests fails on a run of a filter whose model is correct."""
TOLERATED = 3.0
"""Factor by which claimed standard deviations may be too small. A filter beyond it has the wrong
noise or is lost.
"""
FASTEST = 13.0
"""Largest plausible speed [m/s]: no legged robot has run faster (Boston Dynamics' Cheetah, 12.7 m/s
in 2012).
"""
BREAKDOWN = 0.5
"""Share of a sensor's measurements that may be rejected: the breakdown point of any robust
estimate.
"""


@dataclass(frozen=True)
class RunSummary:
    """Innovations, biases, speed and corrections of a filter in each window of SUM_WINDOW.

    Attributes:
        start: start of the windows (W,) [s].
        sums: `surefoot.estimator.evaluation.innovation_sums` (W, S, 10); S = 0 without
            innovations.
        bias: b_a [m/s^2] and b_g [rad/s] at the window's end (W, 6).
        speed: the highest (W,) [m/s].
        pushed: total change of the velocity by updates (W,) [m/s].
        push_claimed: standard deviation of an axis of it that the claimed errors of tilt and
            accelerometer explain (W,) [m/s].
        definite: whether all variances are positive (W,).
        unlike: distance (W,) of the walk so far from those that its observer was trained on, 1
            being the farthest of these; NaN where it is not known.
        first: biases at the first estimate (6,).
        prior: their claimed deviations there (6,).
        diverged: whether the estimates end because they were no longer finite.
    """

    start: np.ndarray
    sums: np.ndarray
    bias: np.ndarray
    speed: np.ndarray
    pushed: np.ndarray
    push_claimed: np.ndarray
    definite: np.ndarray
    unlike: np.ndarray
    first: np.ndarray
    prior: np.ndarray
    diverged: bool


def summary_of_run(estimate: Trajectory, log: Log) -> RunSummary:
    """Summarise an estimate of a log, or of a piece of one."""
    if not len(estimate.t):
        none = np.zeros(0)
        sums, bias, flags = np.zeros((0, 0, 10)), np.zeros((0, 6)), np.zeros(0, dtype=bool)
        first = np.zeros(6)
        return RunSummary(
            none, sums, bias, none, none, none, flags, none, first, first, estimate.diverged
        )
    windows = windows_of(estimate.t)
    at = np.flatnonzero(np.r_[True, np.diff(windows) != 0])
    bias = np.concatenate([estimate.b_a, estimate.b_g], axis=1)
    P = estimate.covariance
    variances = np.zeros((len(estimate.t), 15)) if P is None else P.diagonal(axis1=1, axis2=2)
    start = windows[at] * SUM_WINDOW
    sums = np.zeros((len(at), 0, 10))
    if estimate.innovations is not None:
        known = estimate.innovations
        sums = known.sums[np.searchsorted(known.start, start - 0.5 * SUM_WINDOW)]
    return RunSummary(
        start,
        sums,
        bias[np.r_[at[1:] - 1, len(bias) - 1]],
        np.maximum.reduceat(np.linalg.norm(estimate.v_GI, axis=1), at),
        np.linalg.norm(np.add.reduceat(_pushes(estimate, log), at), axis=1),
        np.sqrt(np.maximum.reduceat(_push_variance(variances), at)),
        np.logical_and.reduceat((variances > 0).all(axis=1), at),
        np.full(len(at), np.nan) if estimate.unlike is None else estimate.unlike[at],
        bias[0].copy(),  # without the array that it is a row of
        np.sqrt(variances[0, 9:]),
        estimate.diverged,
    )


def _pushes(estimate: Trajectory, log: Log) -> np.ndarray:
    """Velocity (L, 3) [m/s] in G that updates added to each estimate since the one before."""
    rows = np.searchsorted(log.t, estimate.t - 1e-9)
    dt = np.diff(log.t, prepend=log.t[0])
    force = np.cumsum(log.accel * dt[:, None], axis=0)
    R = 0.5 * (estimate.R_GI[1:] + estimate.R_GI[:-1])
    elapsed = np.diff(estimate.t)[:, None]
    force_I = np.diff(force[rows], axis=0) - 0.5 * elapsed * (estimate.b_a[1:] + estimate.b_a[:-1])
    moved = np.einsum("nij,nj->ni", R, force_I) + GRAVITY_G * elapsed
    return np.concatenate([np.zeros((1, 3)), np.diff(estimate.v_GI, axis=0) - moved])


def _push_variance(variances: np.ndarray) -> np.ndarray:
    """Variance (L,) [m^2/s^2] of the change of an axis of the velocity in a window.

    From variances (L, 15) of the error state: errors of tilt and bias act throughout, and the
    velocity itself is uncertain at both ends.
    """
    tilt, velocity, b_a = (variances[:, at].max(axis=1) for at in ([0, 1], [3, 4, 5], [9, 10, 11]))
    return SUM_WINDOW**2 * (GRAVITY**2 * tilt + b_a) + 2.0 * velocity + ACCEL_NOISE**2 * SUM_WINDOW


def joined_summary(parts: Iterable[RunSummary]) -> RunSummary:
    """Join the summaries of successive pieces; a window may lie in two of them."""
    parts = list(parts)
    known = [part for part in parts if len(part.start)]
    if not known:
        return parts[-1]
    every = {name: np.concatenate([getattr(part, name) for part in known]) for name in _MERGED}
    begins = np.r_[True, np.diff(every["start"]) != 0.0]
    at = np.flatnonzero(begins)
    joint: dict[str, Any] = {name: _MERGED[name].reduceat(x, at) for name, x in every.items()}
    bias = np.concatenate([part.bias for part in known])[np.r_[begins[1:], True]]
    return replace(known[0], **joint, bias=bias, diverged=parts[-1].diverged)


@dataclass(frozen=True)
class Doubt:
    """A reason not to trust an estimate, and the time [s] from which it holds."""

    reason: str
    since: float


@dataclass(frozen=True)
class SensorHealth:
    """Statistics of one sensor's updates.

    Attributes:
        name: of the sensor.
        used: number of updates used.
        rejected: share of the measurements that were rejected.
        nis: mean of r^T W^-1 r, 3 if the claimed covariance W is right.
        whiteness: variance of the sum of a window's innovations over the sum of their variances,
            both as measured: 1 if white, more if correlated.
        drift: the same over the claimed variances: 1 if both hold.
    """

    name: str
    used: int
    rejected: float
    nis: float
    whiteness: float
    drift: float


@dataclass(frozen=True)
class Health:
    """Result of the tests of a run.

    Attributes:
        sensors: in the order of a log's feet, then velocities; those without a measurement are
            omitted.
        biases: largest deviation of b_a and b_g from the first estimate (6,), in standard
            deviations of prior and walk.
        speed: the highest [m/s].
        doubts: in the order of time.
    """

    sensors: tuple[SensorHealth, ...]
    biases: np.ndarray
    speed: float
    doubts: tuple[Doubt, ...]

    @property
    def lost(self) -> bool:
        """Whether the estimate is not to be trusted."""
        return bool(self.doubts)

    @property
    def since(self) -> float:
        """Time of the first doubt [s]; NaN without one."""
        return self.doubts[0].since if self.doubts else np.nan

    def sentence(self, name: str) -> str:
        """Why the estimate of the filter of this name is not to be trusted; empty if it is."""
        if not self.doubts:
            return ""
        reasons = "; ".join(f"{d.reason} (from t = {d.since:.1f} s)" for d in self.doubts)
        return f"{name} is not to be trusted: {reasons}"

    def table(self) -> list[dict[str, float | str]]:
        """One row per sensor, for `surefoot.scenarios.reporting.tables`."""
        return [
            {
                "sensor": one.name,
                "updates": one.used,
                "rejected [%]": 100.0 * one.rejected,
                "NIS / 3": one.nis / 3.0,
                "whiteness": one.whiteness,
                "drift": one.drift,
            }
            for one in self.sensors
        ]


def health(run: RunSummary, names: Sequence[str], walk: tuple[float, float]) -> Health:
    """Test a run.

    Args:
        run: its summary.
        names: of the feet, in the log's order.
        walk: densities of the random walks of b_a [m/s^3/sqrt(Hz)] and b_g [rad/s^2/sqrt(Hz)] that
            the filter assumes.
    """
    if not len(run.start):
        return Health((), np.zeros(6), 0.0, (Doubt("not one of its estimates is finite", 0.0),))
    names = [f"foot {name}" for name in names] if run.sums.shape[1] > 1 else []
    sensors = dict(zip([*names, "velocity"], run.sums.swapaxes(0, 1), strict=False))
    deviations = _bias_deviations(run, walk)
    found = [*_ends(run), *_innovations(run, sensors), *_rejected(run, sensors)]
    found += [*_corrections(run), *_biases(run, deviations), *_unlike_training(run)]
    return Health(
        tuple(_sensor(sums, n) for n, sums in sensors.items() if sums[:, [COUNT, LEFT_OUT]].any()),
        deviations.max(axis=0),
        float(run.speed.max()),
        tuple(sorted(found, key=lambda doubt: doubt.since)),
    )


def _drifts(sums: np.ndarray) -> np.ndarray:
    """(sum r)^2 / sum W of windows (..., 10), summed over the axes; 0 without updates."""
    variance = sums[..., VARIANCE : VARIANCE + 3]
    square = sums[..., SUM : SUM + 3] ** 2
    return np.divide(square, variance, out=np.zeros_like(square), where=variance > 0).sum(axis=-1)


def _sensor(sums: np.ndarray, name: str) -> SensorHealth:
    total = sums.sum(axis=0)
    used = total[COUNT]
    nis = total[SQUARED] / used if used else np.nan
    drift = float(_drifts(sums)[sums[:, COUNT] > 0].mean() / 3.0) if used else np.nan
    rejected = total[LEFT_OUT] / (used + total[LEFT_OUT])
    whiteness = 3.0 * drift / nis if nis > 0 else np.nan
    return SensorHealth(name, int(used), float(rejected), float(nis), float(whiteness), drift)


def _first(run: RunSummary, wrong: np.ndarray, reason: str) -> Iterator[Doubt]:
    """A doubt from the first of the windows `wrong` (W,) on, if there is one."""
    if wrong.any():
        yield Doubt(reason, float(run.start[np.argmax(wrong)]))


def _ends(run: RunSummary) -> Iterator[Doubt]:
    if run.diverged:
        yield Doubt("its estimates are no longer finite", float(run.start[-1]))
    yield from _first(run, ~run.definite, "it claims variances that are not positive")
    yield from _first(run, run.speed > FASTEST, f"it runs at {run.speed.max():.0f} m/s")


def _innovations(run: RunSummary, sensors: dict[str, np.ndarray]) -> Iterator[Doubt]:
    for name, sums in sensors.items():
        drifts = _drifts(sums)
        limit = TOLERATED**2 * chdtri(3, RUN_ALARM / run.sums[..., COUNT].size)
        reason = (
            f"innovations of {name} drift by up to {np.sqrt(drifts.max() / 3.0):.0f} of their "
            "claimed standard deviations"
        )
        yield from _first(run, drifts > limit, reason)


def _rejected(run: RunSummary, sensors: dict[str, np.ndarray]) -> Iterator[Doubt]:
    again = run.sums[:, :, RESTARTED].max(axis=1, initial=0.0)
    times = f"{again.sum():.0f} times" if again.sum() > 1 else "once"
    yield from _first(run, again > 0, f"no foot passed the test of slipping for long, {times}")
    for name, sums in sensors.items():
        used, rejected = sums[:, COUNT], sums[:, LEFT_OUT]
        share = rejected.sum() / max(used.sum() + rejected.sum(), 1.0)
        if share > BREAKDOWN:
            reason = f"{100 * share:.0f} % of {name}'s updates were rejected"
            yield from _first(run, rejected > used, reason)


def _corrections(run: RunSummary) -> Iterator[Doubt]:
    limit = TOLERATED * np.sqrt(chdtri(3, RUN_ALARM / len(run.pushed)))
    ratio = np.divide(run.pushed, run.push_claimed, where=run.push_claimed > 0, out=0 * run.pushed)
    most = run.pushed[ratio > limit].max(initial=0.0)
    reason = f"its updates contradict the IMU by {most:.1f} m/s in a second"
    yield from _first(run, ratio > limit, reason)


def _unlike_training(run: RunSummary) -> Iterator[Doubt]:
    far = run.unlike[-1]
    reason = (
        "the walk is unlike those that its observer was trained on (distance "
        f"{far:.1f}, of these at most 1)"
    )
    yield from _first(run, (run.unlike > 1.0) & (far > 1.0), reason)


def _bias_deviations(run: RunSummary, walk: tuple[float, float]) -> np.ndarray:
    """Deviations of the biases (W, 6) from the first, in standard deviations of prior and walk."""
    elapsed = np.maximum(run.start - run.start[0], 0.0)[:, None] + SUM_WINDOW
    variance = run.prior**2 + np.repeat(walk, 3) ** 2 * elapsed
    moved = np.abs(run.bias - run.first)
    return np.divide(moved, np.sqrt(variance), where=variance > 0, out=np.zeros_like(moved))


def _biases(run: RunSummary, deviations: np.ndarray) -> Iterator[Doubt]:
    limit = -ndtri(RUN_ALARM / (2 * 6))
    for name, unit, at in (("accelerometer", "m/s^2", 0), ("gyro", "rad/s", 3)):
        mine = deviations[:, at : at + 3]
        window, axis = np.unravel_index(np.argmax(mine), mine.shape)
        moved = run.bias[window, at + axis] - run.first[at + axis]
        reason = (
            f"the bias of the {name}'s {'xyz'[axis]} axis moved by {moved:.2g} {unit}, "
            f"{mine.max():.1f} of its standard deviations"
        )
        yield from _first(run, (mine > limit).any(axis=1), reason)
