"""Summary of a run in windows of a second, from which its trustworthiness is tested afterwards."""

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np

from surefoot.estimator.evaluation.innovation_sums import SUM_WINDOW, windows_of
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.sim.common.gravity import GRAVITY, GRAVITY_G
from surefoot.sim.log import Log

ACCEL_NOISE = 0.03
"""Largest accelerometer noise density of the bundled filters [m/s^2/sqrt(Hz)]."""


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
            none, sums, bias, none, none, none, flags, first, first, estimate.diverged
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
    joint = {f.name: getattr(parts[0], f.name) for f in fields(RunSummary)}
    for part in parts[1:]:
        joint["diverged"] = part.diverged
        if not len(part.start):
            continue
        same = joint["start"][-1] == part.start[0]
        for name, merge in _MERGE.items():
            before, after = joint[name], getattr(part, name)
            if same:
                before = np.concatenate([before[:-1], merge(before[-1:], after[:1])])
            joint[name] = np.concatenate([before, after[int(same) :]])
    return RunSummary(**joint)


_MERGE = {
    "start": lambda a, b: a,
    "sums": np.add,
    "bias": lambda a, b: b,
    "speed": np.maximum,
    "pushed": np.add,
    "push_claimed": np.maximum,
    "definite": np.logical_and,
}
"""How the two parts of a window are combined."""
