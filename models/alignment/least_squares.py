"""Joint least-squares fit of a tracked body's clock offset, position and rotation.

The poses are compared with the integrals of the IMU (`sim.log.reference_vs_imu`). At each sample of
the reference, a quadratic is fitted to the neighbouring samples of two differences: that of the
poses' attitude and the integrated gyro, whose slope is an angular rate, and that of the poses'
position and the twice integrated specific force, whose second derivative is an acceleration. IMU
and reference pass through the same samples and the same fit, so smoothing and gaps cancel. If clock
offset, rotation, position and biases are correct, only noise remains.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit
from scipy.stats import wilcoxon

from surefoot.models.bootstrap import block_bootstrap_counts
from surefoot.sim.common.gravity import GRAVITY, GRAVITY_G
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.log.derived import local_quadratic
from surefoot.sim.log.reference import Poses
from surefoot.sim.log.reference_vs_imu import compare_with_imu

_TURN_WINDOW = 0.08
"""Window of the fits to attitudes [s]."""
_PATH_WINDOW = 0.1
"""Window of the fits to positions [s]; it smooths like a Gaussian of 20 ms."""
_FEWEST = 5
"""Least number of samples in a window; for a sparser reference the window is longer."""
_LONGEST_STEP = 0.25
"""Time without readings from which an IMU is not integrated [s]: legs swing forward in it."""
_PRIOR = np.repeat([0.0, 0.05**-2.0, 0.3**-2.0, 1.0**-2.0, 0.02**-2.0], [4, 3, 3, 3, 2])
"""Precisions (15,) of what is known beforehand, zero for clock offset and rotation. The standard
deviations [rad/s, m/s^2, m, rad] are of parameters that a log may not determine: biases of gyro and
accelerometer, uncalibrated MEMS sensors; a lever arm within a body's size; the tilt of a motion
capture whose floor was levelled by eye.
"""
_OUTLIER = 2.0
"""Standard deviations beyond which a row loses weight (Huber)."""
_TAILS = 4.0
"""Degrees of freedom of residuals: a few are impacts and lost samples."""
_STRIDE = 0.5
"""Length of the blocks in which fits are compared [s]: about a stride."""
_SAME_STAMP = 1e-5
"""Difference of stamps by rounding [s]."""
_FEWEST_BLOCKS = 6
"""Least number of blocks that can tell two fits apart."""
_BLOCK = 1.0
"""Length of the blocks of the bootstrap [s]: some strides, which are nearly independent."""
MOST_STEPS = 12
"""Maximum number of Gauss-Newton steps."""
FIRST_STEPS = 3
"""Number of steps after which fits from different guesses are compared."""
_CLOCK_TOLERANCE = 1e-6
"""Change of the clock offset at which the fit has converged [s]."""
_DIFFERENCE_STEPS = np.array([1e-3] + [1e-3] * 3 + [1e-3] * 3)
"""Steps of the finite differences for clock offset [s], rotation [rad] and gyro bias [rad/s], small
enough for the residual to be linear.
"""


@dataclass(frozen=True)
class Placement:
    """Parameters of the fit, for a tracked body M and the IMU I.

    Attributes:
        offset: to add to the reference's stamps [s].
        R_IM: rotation from M to I (3, 3).
        bias_gyro: (3,) [rad/s].
        bias_accel: (3,) [m/s^2].
        p_IM: M's origin in I (3,) [m].
        tilt: of the reference's vertical, along x and y (2,) [rad].
    """

    offset: float
    R_IM: np.ndarray
    bias_gyro: np.ndarray
    bias_accel: np.ndarray
    p_IM: np.ndarray
    tilt: np.ndarray

    def moved(self, step: np.ndarray) -> "Placement":
        """The parameters after a step (15,): clock offset, rotation about axes of M, biases of gyro
        and accelerometer, position, tilt.
        """
        return Placement(
            self.offset + float(step[0]),
            self.R_IM @ Rotation.from_rotvec(step[1:4]).as_matrix(),
            self.bias_gyro + step[4:7],
            self.bias_accel + step[7:10],
            self.p_IM + step[10:13],
            self.tilt + step[13:15],
        )


@dataclass(frozen=True)
class PlacementFit:
    """Result of the fit.

    Attributes:
        placement: the parameters.
        half_width: of their 95 % intervals (15,), in the order of `Placement.moved`.
        halves: steps from them that each half of the log alone would take (2, 15).
        t: times of the samples on the IMU's clock (K,) [s].
        rates: residual of the angular rate, in I (K, 3) [rad/s].
        accelerations: residual of the acceleration, in I (K, 3) [m/s^2].
    """

    placement: Placement
    half_width: np.ndarray
    halves: np.ndarray
    t: np.ndarray
    rates: np.ndarray
    accelerations: np.ndarray


@dataclass(frozen=True)
class Readings:
    """Readings of an IMU, t (N,) [s], gyro and accel (N, 3), and the poses of a tracked body on
    another clock.
    """

    t: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    poses: Poses

    def sections(self, offset: float) -> list["Readings"]:
        """The parts between gaps of the IMU, each with the poses that lie within its times after
        adding `offset` [s] to their stamps, with a margin for changes of the offset. Parts with too
        few poses for a fit are left out.
        """
        gaps = np.flatnonzero(np.diff(self.t) > _LONGEST_STEP) + 1
        found = []
        for first, last in pairwise([0, *gaps, len(self.t)]):
            t, at = self.t[first:last], self.poses.t + offset
            inside = (at > t[min(1, len(t) - 1)] + 0.05) & (at < t[-1] - 0.05)
            if inside.sum() > _FEWEST:
                rows = slice(first, last)
                poses = self.poses.rows(inside)
                found.append(Readings(t, self.gyro[rows], self.accel[rows], poses))
        return found


def placement_residual(
    readings: Readings, at: Placement
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual of the K samples for given parameters.

    Returns:
        Differences of angular rate [rad/s] and acceleration [m/s^2] between reference and IMU, in I
        (K, 6); their change per metre of p_IM (K, 3, 3); attitudes R_GI (K, 3, 3).
    """
    poses = readings.poses
    q_GI = quaternion_from_matrix(poses.R @ at.R_IM.T)
    mounted = Poses(poses.t + at.offset, poses.p, q_GI)
    gyro, accel = readings.gyro - at.bias_gyro, readings.accel - at.bias_accel
    beside = compare_with_imu(readings.t, gyro, accel, mounted)
    R_GI = beside.R_GI
    _, rate, _ = local_quadratic(mounted.t, beside.turn, _window(poses.t, _TURN_WINDOW))
    path = np.hstack([beside.path, R_GI.reshape(-1, 9)])
    _, _, bend = local_quadratic(mounted.t, path, _window(poses.t))
    lever = bend[:, 3:].reshape(-1, 3, 3)
    gravity = GRAVITY * np.append(at.tilt, 0.0)
    acceleration = bend[:, :3] - lever @ at.p_IM - gravity
    turned = np.swapaxes(R_GI, 1, 2)
    both = np.stack([rate, acceleration], axis=1) @ R_GI
    return both.reshape(-1, 6), -turned @ lever, R_GI


def specific_forces(readings: Readings, at: Placement) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Specific forces in I, all smoothed in the same way.

    Returns:
        Those of the accelerometer (K, 3) [m/s^2]; those that follow from the motion of the tracked
        point (K, 3) [m/s^2]; the change of the latter per metre of p_IM (K, 3, 3).
    """
    found = []
    for part in readings.sections(at.offset):
        rows, lever, R_GI = placement_residual(part, at)
        t = part.poses.t
        bend = local_quadratic(t, part.poses.p, _window(t))[2] - GRAVITY_G
        moved = np.einsum("kji,kj->ki", R_GI, bend)
        around = (t > t[0] + _PATH_WINDOW) & (t < t[-1] - _PATH_WINDOW)
        found.append(((moved - rows[:, 3:])[around], moved[around], lever[around]))
    if not found:
        return np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3, 3))
    felt, moved, lever = (np.concatenate(one) for one in zip(*found, strict=True))
    return felt, moved, lever


def fit_placement(
    readings: Readings, start: Placement, rng: np.random.Generator, steps: int = MOST_STEPS
) -> PlacementFit | None:
    """Maximum a-posteriori parameters, from a start that is accurate to a fraction of a stride;
    None if they lead to where IMU and reference have nothing in common.

    steps: largest number of Gauss-Newton steps.
    """
    now, rounds = start, 0
    while True:
        parts = [_linearised(part, now) for part in readings.sections(now.offset)]
        if not parts:
            return None
        rows, columns, t = (np.concatenate(one) for one in zip(*parts, strict=True))
        sums, against = _normal_equations(rows, columns)
        known = np.concatenate([np.zeros(4), now.bias_gyro, now.bias_accel, now.p_IM, now.tilt])
        pull = _PRIOR * known
        step = np.linalg.solve(sums.sum(axis=0) + np.diag(_PRIOR), against.sum(axis=0) - pull)
        if abs(step[0]) < _CLOCK_TOLERANCE:
            break
        now, rounds = now.moved(step), rounds + 1
        if rounds == steps:
            break
    # Blocks without samples, in a gap, do not count.
    block = np.unique(np.floor((t - t[0]) / _BLOCK), return_inverse=True)[1]
    count = int(block[-1]) + 1
    of_blocks = np.zeros((count, 15, 16))
    np.add.at(of_blocks, block, np.concatenate([sums, against[:, :, None]], axis=2))

    def solved(total: np.ndarray) -> np.ndarray:
        return np.linalg.solve(total[:, :15] + np.diag(_PRIOR), total[:, 15] - pull)

    draws = np.tensordot(block_bootstrap_counts(count, rng, 400), of_blocks, axes=1)
    spread = np.std([solved(one) for one in draws], axis=0)
    first = np.arange(count) < count / 2
    halves = np.array([solved(of_blocks[half].sum(axis=0)) for half in (first, ~first)])
    width = stdtrit(max(count - 1, 1), 0.975) * spread
    return PlacementFit(now, width, halves, t, rows[:, :3], rows[:, 3:])


def most_likely(fits: Sequence[PlacementFit]) -> list[int]:
    """Number of the fit that leaves least, then of those that do not leave significantly more.

    Fits of different clock offsets are compared by what they leave of the same samples of the
    reference: by the mean log-likelihood in each block, for residuals with the tails of Student's
    t, with a confidence of 97.5 % by Wilcoxon's signed ranks.
    """
    size = [[_spread(part) for part in (one.rates, one.accelerations)] for one in fits]
    rates, accelerations = np.min(size, axis=0)
    left = [
        np.log1p(
            np.sum((one.rates / rates) ** 2 + (one.accelerations / accelerations) ** 2, axis=1)
            / _TAILS
        )
        for one in fits
    ]
    stamps = [one.t - one.placement.offset for one in fits]

    def more(k: int, other: int) -> np.ndarray:
        """What fit k leaves more of each block than another (K,)."""
        there = np.searchsorted(stamps[other], stamps[k] - _SAME_STAMP)
        same = np.append(stamps[other], np.inf)[there] < stamps[k] + _SAME_STAMP
        here, there = np.flatnonzero(same), there[same]
        block = np.unique(np.floor(stamps[k][here] / _STRIDE), return_inverse=True)[1]
        return np.bincount(block, left[k][here] - left[other][there]) / np.bincount(block)

    def is_as_good(k: int) -> bool:
        worse = more(k, best)
        if len(worse) < _FEWEST_BLOCKS:  # too few to tell
            return len(stamps[k]) >= len(stamps[best])
        return bool(wilcoxon(worse, alternative="greater").pvalue > 0.025)

    best = 0
    for k in range(1, len(fits)):
        worse = more(k, best)
        best = k if len(worse) and worse.mean() < 0.0 else best
    return [best, *(k for k in range(len(fits)) if k != best and is_as_good(k))]


def _window(t: np.ndarray, least: float = _PATH_WINDOW) -> float:
    """Window of the fits to samples at t (K,) [s], longer than the least for a sparse reference."""
    return max(least, _FEWEST * float(np.median(np.diff(t))))


def _spread(residual: np.ndarray) -> float:
    """Robust standard deviation of residuals."""
    return float(1.4826 * np.median(np.abs(residual)) + 1e-12)


def _linearised(readings: Readings, at: Placement) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residuals (K, 6), their derivatives (K, 6, 15) and times (K,) [s], of the samples with enough
    neighbours.
    """
    rows, lever, R_GI = placement_residual(readings, at)
    columns = np.zeros((len(rows), 6, 15))
    for k, size in enumerate(_DIFFERENCE_STEPS):
        step = np.zeros(15)
        step[k] = size
        columns[:, :, k] = (placement_residual(readings, at.moved(step))[0] - rows) / size
    columns[:, 3:, 7:10] = np.eye(3)
    columns[:, 3:, 10:13] = lever
    columns[:, 3:, 13:15] = -GRAVITY * np.swapaxes(R_GI, 1, 2)[:, :, :2]
    t = readings.poses.t
    window = _window(t)
    around = [np.searchsorted(t, t + sign * window / 2) for sign in (-1, 1)]
    enough = around[1] - around[0] >= _FEWEST - 1
    enough &= (t > t[0] + window) & (t < t[-1] - window)
    return rows[enough], columns[enough], t[enough] + at.offset


def _normal_equations(rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """J'WJ (K, 15, 15) and -J'We (K, 15) of each sample, rates and accelerations each weighted by
    their own spread.
    """
    weight = np.empty_like(rows)
    for part in (slice(0, 3), slice(3, 6)):
        spread = _spread(rows[:, part])
        size = np.linalg.norm(rows[:, part], axis=1) / (np.sqrt(3.0) * spread)
        weight[:, part] = (np.minimum(1.0, _OUTLIER / np.maximum(size, 1e-12)) / spread**2)[:, None]
    weighted = np.swapaxes(columns, 1, 2) * weight[:, None]
    return weighted @ columns, -np.einsum("kij,kj->ki", weighted, rows)
