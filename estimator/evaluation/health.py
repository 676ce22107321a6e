"""Whether an estimate is to be believed, from what the filter saw and claimed; no reference is
used.

A filter whose model holds has innovations of the covariance that it claims, white, and biases that
stay within their priors. Real ones are tuned by hand and miss this by some factor, which is told
(`Health.table`) and is no reason for alarm. What is: that a filter which claims deviations
TOLERATED times too small would still do this less than once in as many runs as RUN_ALARM says.
Each test says when it failed first.

- Innovations. Over a window the sum of white innovations r has the variance sum W, axis by axis, so
  that (sum r)^2 / sum W over three axes is chi-square with 3 degrees of freedom, whatever the
  correlations within a stride: windows are the independent samples. The sum is what moves the
  estimate; the mean of r^T W^-1 r (NIS) is told beside it, but filters whose noise stands for
  systematic errors keep it far below its expectation while they are wrong.
- Corrections. Sensors that keep no innovations are judged by their effect: how far updates move the
  velocity from where the IMU took it, against what the claimed errors of tilt and accelerometer do.
- Biases. b(t) - b(0) has at most the covariance of the prior and of the walk since.
- Feet or velocities that are rejected: a test that for a second rejects all feet, or rejects more
  than half of a sensor's measurements, has a wrong estimate or a wrong sensor (half is where any
  robust estimate breaks down).
- Speed, variances that are not positive, estimates that are not finite.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

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
)
from surefoot.estimator.evaluation.run_summary import RunSummary

RUN_ALARM = 1e-4
"""Chance that one of the tests fails on a run of a filter whose model holds."""
TOLERATED = 3.0
"""Factor by which claimed deviations may be too small: three of the filter's deviations are then
one of the truth's. A filter beyond it has the wrong noise or has lost its way."""
FASTEST = 13.0
"""m/s: no robot on legs has run faster (Boston Dynamics' Cheetah, 12.7 m/s in 2012)."""
BREAKDOWN = 0.5
"""Share of a sensor's measurements that may be rejected: half is where any robust estimate breaks
down."""


@dataclass(frozen=True)
class Doubt:
    """One reason not to believe an estimate, and the time [s] from which it holds."""

    reason: str
    since: float


@dataclass(frozen=True)
class SensorHealth:
    """Of one sensor's updates: how many were used, the share of measurements rejected; nis, the
    mean of r^T W^-1 r (3 where the claimed covariance W is right); whiteness, the variance of the
    sum of a window's innovations over the sum of their variances, each as measured (1 where they
    are white, more where they hang together); drift, the same over the claimed variances (1 where
    both hold).
    """

    name: str
    used: int
    rejected: float
    nis: float
    whiteness: float
    drift: float


@dataclass(frozen=True)
class Health:
    """What a run says of itself.

    sensors, in the order of a log's feet, then velocities; those without a measurement are left
    out. biases (6,), the largest deviation of b_a and b_g from the first estimate in deviations of
    prior and walk. speed [m/s], the highest. doubts, in the order in which they began.
    """

    sensors: tuple[SensorHealth, ...]
    biases: np.ndarray
    speed: float
    doubts: tuple[Doubt, ...]

    @property
    def lost(self) -> bool:
        """Whether the estimate is not to be believed."""
        return bool(self.doubts)

    @property
    def since(self) -> float:
        """When the first doubt began [s]; NaN without one."""
        return self.doubts[0].since if self.doubts else np.nan

    def sentence(self, name: str) -> str:
        """Why the estimate of the filter of this name is not to be believed; empty if it is."""
        if not self.doubts:
            return ""
        reasons = "; ".join(f"{d.reason} (from t = {d.since:.1f} s)" for d in self.doubts)
        return f"{name} is not to be trusted: {reasons}"

    def table(self) -> list[dict[str, float | str]]:
        """A row a sensor, for `surefoot.scenarios.reporting.tables`."""
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
    """The judgement of a run.

    Args:
        run: its summary.
        names: of the feet, in the log's order.
        walk: densities of the random walks of b_a [m/s^3/sqrt(Hz)] and b_g [rad/s^2/sqrt(Hz)] that
            the filter takes.
    """
    sensors = [f"foot {name}" for name in names] if run.sums.shape[1] > 1 else []
    sensors = [*sensors, "velocity"][: run.sums.shape[1]]
    deviations = _bias_deviations(run, walk)
    found = [*_ends(run), *_innovations(run, sensors), *_rejected(run, sensors)]
    found += [*_corrections(run), *_biases(run, deviations)]
    return Health(
        tuple(_sensor(run.sums[:, k].sum(axis=0), run.sums[:, k], n) for k, n in enumerate(sensors)
              if run.sums[:, k, :2].any()),
        deviations.max(axis=0),
        float(run.speed.max()),
        tuple(sorted(found, key=lambda doubt: doubt.since)),
    )  # fmt: skip


def _drifts(sums: np.ndarray) -> np.ndarray:
    """(sum r)^2 / sum W of windows (..., 10), summed over the axes; 0 where there was no update."""
    variance = sums[..., VARIANCE : VARIANCE + 3]
    square = sums[..., SUM : SUM + 3] ** 2
    return np.divide(square, variance, out=np.zeros_like(square), where=variance > 0).sum(axis=-1)


def _sensor(total: np.ndarray, windows: np.ndarray, name: str) -> SensorHealth:
    used = total[COUNT]
    nis = total[SQUARED] / used if used else np.nan
    drift = float(_drifts(windows)[windows[:, COUNT] > 0].mean() / 3.0) if used else np.nan
    rejected = total[LEFT_OUT] / (used + total[LEFT_OUT])
    whiteness = 3.0 * drift / nis if nis > 0 else np.nan
    return SensorHealth(name, int(used), float(rejected), float(nis), float(whiteness), drift)


def _ends(run: RunSummary) -> Iterator[Doubt]:
    if run.diverged:
        yield Doubt("its estimates are no longer finite", float(run.start[-1]))
    bad = np.flatnonzero(~run.definite)
    if len(bad):
        yield Doubt("it claims variances that are not positive", float(run.start[bad[0]]))
    fast = np.flatnonzero(run.speed > FASTEST)
    if len(fast):
        yield Doubt(f"it runs at {run.speed.max():.0f} m/s", float(run.start[fast[0]]))


def _innovations(run: RunSummary, names: Sequence[str]) -> Iterator[Doubt]:
    drifts = _drifts(run.sums)
    if not drifts.size:
        return
    limit = TOLERATED**2 * chdtri(3, RUN_ALARM / drifts.size)
    for k in np.flatnonzero((drifts > limit).any(axis=0)).tolist():
        factor = np.sqrt(drifts[:, k].max() / 3.0)
        since = float(run.start[np.argmax(drifts[:, k] > limit)])
        text = f"innovations of {names[k]} drift by up to {factor:.0f} of their claimed deviations"
        yield Doubt(text, since)


def _rejected(run: RunSummary, names: Sequence[str]) -> Iterator[Doubt]:
    again = run.sums[:, :, RESTARTED].max(axis=1, initial=0.0)
    if again.any():
        times = f"{again.sum():.0f} times" if again.sum() > 1 else "once"
        text = f"no foot passed the test of slipping for long, {times}"
        yield Doubt(text, float(run.start[np.argmax(again > 0)]))
    for k, name in enumerate(names):
        used, rejected = run.sums[:, k, COUNT], run.sums[:, k, LEFT_OUT]
        share = rejected.sum() / max(used.sum() + rejected.sum(), 1.0)
        if share > BREAKDOWN:
            first = float(run.start[np.argmax(rejected > used)])
            yield Doubt(f"{100 * share:.0f} % of {name}'s updates were rejected", first)


def _corrections(run: RunSummary) -> Iterator[Doubt]:
    limit = TOLERATED * np.sqrt(chdtri(3, RUN_ALARM / len(run.pushed)))
    ratio = np.divide(run.pushed, run.push_claimed, where=run.push_claimed > 0, out=0 * run.pushed)
    wrong = np.flatnonzero(ratio > limit)
    if len(wrong):
        most = run.pushed[wrong].max()
        text = f"its updates contradict the IMU by {most:.1f} m/s in a second"
        yield Doubt(text, float(run.start[wrong[0]]))


def _bias_deviations(run: RunSummary, walk: tuple[float, float]) -> np.ndarray:
    """Of the biases (W, 6) from the first, in deviations of prior and walk."""
    elapsed = np.maximum(run.start - run.start[0], 0.0)[:, None] + SUM_WINDOW
    variance = run.prior**2 + np.repeat(walk, 3) ** 2 * elapsed
    moved = np.abs(run.bias - run.first)
    return np.divide(moved, np.sqrt(variance), where=variance > 0, out=np.zeros_like(moved))


def _biases(run: RunSummary, deviations: np.ndarray) -> Iterator[Doubt]:
    limit = -ndtri(RUN_ALARM / (2 * 6))
    for name, unit, at in (("accelerometer", "m/s^2", 0), ("gyro", "rad/s", 3)):
        mine = deviations[:, at : at + 3]
        if mine.max() > limit:
            window, axis = np.unravel_index(np.argmax(mine), mine.shape)
            moved = run.bias[window, at + axis] - run.first[at + axis]
            since = run.start[np.argmax((mine > limit).any(axis=1))]
            yield Doubt(
                f"the bias of the {name} about {'xyz'[axis]} moved by {moved:.2g} {unit}, "
                f"{mine.max():.1f} of its deviations",
                since,
            )
