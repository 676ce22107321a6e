"""Checks of a reference: by itself (miscounted frames, jumps, held samples, gaps), and by the IMU
(noise of its samples, and samples that the IMU contradicts).

Relative to the IMU's integrals (`sim.log.reference_vs_imu`), the path of a tracked point varies
slowly: initial position and velocity, a force that drifts with tilt and bias, and a lever arm that
rotates with the body. The rest of a sample is the noise of its position, and its velocity times the
error of its stamp. The noise levels are found by maximum likelihood of a Kalman filter with the
states position, velocity, drift and lever arm (Bar-Shalom et al., Estimation with Applications to
Tracking and Navigation, 2001, ch. 5).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from surefoot.sim.common.kernels import kernel
from surefoot.sim.importing.clock import seconds, set_forward
from surefoot.sim.importing.reference import MAX_GAP
from surefoot.sim.log.derived import REFERENCE_WINDOW, derivative
from surefoot.sim.log.reference import Poses
from surefoot.sim.log.reference_vs_imu import ReferenceVsImu, compare_with_imu

_MISCOUNTED = {1: (2.0,), 2: (1 / 2, 3 / 2), 3: (2 / 3,)}
"""Number of frames of a step by its stamps -> its speeds relative to the surrounding ones if that
number is off by one. Other ratios, and steps of more frames, also occur in a jerky gait with
correct stamps.
"""
_RATIO_TOLERANCE = 0.12
"""Relative tolerance of such a ratio, less than half of the distance between two of them."""
_NEIGHBOURS = 3
"""Number of steps on either side whose median is the surrounding speed; a step of the gait lasts
much longer.
"""
_STEADY = 0.1
"""Relative spread (median deviation) of the surrounding speeds up to which a step can be judged."""
_SLOWEST = 0.1
"""Speed below which noise of millimetres changes a step's speed as much as a frame does [m/s]."""
_JUMP_ACCEL = 150.0
"""Acceleration from the surrounding speed that is a jump [m/s^2]: legs cause less than a third of
it; a jump of 15 mm between samples at 100 Hz has as much.
"""
_JUMP_TURN = 500.0
"""Angular acceleration that is a jump [rad/s^2]: 3 degrees between samples at 100 Hz."""
_LEAST_JUMP, _LEAST_TURN = 0.005, 0.02
"""Least size of a jump, m and rad, at any rate: a shin that hits a stair's edge changes a body's
velocity by 1 m/s, or 5 rad/s, within a millisecond.
"""
_LISTED = 8
"""Number of jumps whose times are listed."""
_LONGEST_JUMP = 0.5
"""Longest time after which a tracker that has jumped is back [s]."""
_FEW_DOUBTFUL = 0.03
"""Share of doubtful stamps up to which chance and gait explain them."""
_JUMP_RATIO = 8.0
"""Ratio of a jump to the usual change of speed; noise of a reference stays below it."""

FEWEST_SAMPLES = 100
"""Least number of samples for an estimate."""
_LONGEST = 4000
"""Number of samples used, from the middle of a longer reference."""
_LEVER = 0.3
"""Prior standard deviation of each coordinate of the lever arm [m]."""
_DRIFT = 0.3
"""Prior standard deviation of the drift of the force, from bias and tilt [m/s^2]."""
_WANDER = 0.05
"""Random walk of this drift [m/s^2/sqrt(s)]: errors of a walking body's tilt of a few tenths of a
degree.
"""
_START = (1e-3, 2e-3, 0.1)
"""Initial values of the search: position [m], stamp [s] and force [m/s^2/sqrt(Hz)]."""
_SMALLEST = np.array([1e-5, 1e-5, 1e-3])
"""Lower limits of these values."""
_WINDOW = 0.1
"""Interval over which rotation and velocity of a reference are compared with the IMU's integrals
[s]: a few samples of motion capture, short compared with a stride, and short enough that bias and
tilt change the velocity by centimetres per second only.
"""
_MOST_MISSED_ROTATION = 0.5
"""Share of the gyro's rotation that a reference may miss; beyond it, it belongs to another body
or clock. Noise of a walking robot's motion capture leaves a few hundredths.
"""

_LEAST_CHANGE = 0.25
"""Least contradiction [m/s], 25 mm in the window: beyond the noise of a legged robot's reference.
"""
_OUTLYING = 8.0
"""Ratio to the usual change beyond which a change is not noise."""
_SURELY = 3.0
"""Standard deviations of what samples of the accelerometer may miss between them."""
_MOST_CONTRADICTED = 0.05
"""Share of samples above which reference and IMU do not match at all: another clock, axes or
position, which `surefoot align` estimates.
"""
_SHORTEST_SECTION = 1.0
"""Shortest section between two contradictions, or at an end, that is not marked with them [s]."""


@dataclass(frozen=True)
class ReferenceCheck:
    """Result of the checks of a reference, in words.

    Attributes:
        samples: number, rate and gaps of its samples.
        faults: of its stamps and poses.
    """

    samples: str
    faults: tuple[str, ...] = ()


def check_reference(poses: Poses) -> ReferenceCheck:
    """Check the K samples of a reference by themselves."""
    t, step = poses.t, np.diff(poses.t)
    rate = 1.0 / np.median(step) if len(step) else 0.0
    longest, gaps = 1e3 * step.max(initial=0.0), np.sum(step > MAX_GAP)
    samples = f"reference: {len(t)} samples, {rate:.3g} Hz; longest gap {longest:.0f} ms, "
    samples += f"{gaps} over {1e3 * MAX_GAP:.0f} ms"
    if len(step) < 2 * _NEIGHBOURS + 1:
        return ReferenceCheck(samples)
    pose, said = np.column_stack([poses.p, poses.q]), list[str]()
    miscounted, judged = (int(one.sum()) for one in miscounts(poses))
    if judged and miscounted >= _FEW_DOUBTFUL * judged:
        said.append(
            f"{100 * miscounted / judged:.1f} % of stamps doubtful: so many of the {judged} steps"
            " at a steady speed have 1/2, 2/3, 3/2 or 2 times their neighbours' (frames miscounted)"
        )
    said += [
        f"stamps leap from {seconds(t[row - 1])} to {seconds(t[row])} s while it goes on: a clock"
        " that was set; import what is before and the rest separately"
        for row in set_forward(t, pose)
    ]
    if np.all(step == 1.0):
        said.append("stamps are whole numbers: of frames? Give [reference] rate, and no t")
    if (jumped := np.flatnonzero(jumps(poses))).size:
        when = ", ".join(f"{t:.2f}" for t in poses.t[jumped[:_LISTED]])
        more = ", ..." * (len(jumped) > _LISTED)
        said.append(f"{len(jumped)} jumps of position or attitude, at {when}{more} s")
    same = ~np.diff(pose, axis=0).any(axis=1)
    if held := np.sum(same & (_speeds(poses)[1] > _SLOWEST)):
        said.append(f"{held} samples repeat the one before while the body moves")
    return ReferenceCheck(samples, tuple(f"reference: {one}" for one in said))


def miscounts(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Masks (K - 1,) of the steps between samples that are off by a frame, and of those that can be
    judged.
    """
    speed, around = _speeds(poses)
    spread = _median_around(np.abs(speed - around))
    step = np.diff(poses.t)
    frame = np.median(step[step < 1.5 * np.percentile(step, 5.0)])  # the shortest usual step
    frames = np.maximum(np.rint(step / frame), 1.0)
    judged = (around > _SLOWEST) & (spread < _STEADY * around) & (frames <= max(_MISCOUNTED))
    ratio = speed / np.maximum(around, _SLOWEST)
    off = np.zeros(len(ratio), dtype=bool)
    for count, ratios in _MISCOUNTED.items():
        near = np.any([np.abs(ratio / one - 1.0) < _RATIO_TOLERANCE for one in ratios], axis=0)
        off |= near & (frames == count)
    return off & judged, judged


def jumps(poses: Poses) -> np.ndarray:
    """Mask (K - 1,) of the steps between samples over which position or attitude jumps."""
    step = np.diff(poses.t)
    if len(step) < 2:  # none has a neighbour
        return np.zeros(len(step), dtype=bool)
    R = Rotation.from_quat(poses.q, scalar_first=True)
    turning = (R[:-1].inv() * R[1:]).magnitude() / step
    found = np.zeros(len(step), dtype=bool)
    for rate, limit, least in (
        (_speeds(poses)[0], _JUMP_ACCEL, _LEAST_JUMP),
        (turning, _JUMP_TURN, _LEAST_TURN),
    ):
        change = rate - _median_around(rate)
        usual = 1.4826 * np.median(np.abs(change))
        far = (change / step > limit) & (change * step > least)
        found |= far & (change > _JUMP_RATIO * usual)
    return found


def without_jumps(poses: Poses) -> Poses:
    """Remove the poses between a jump and one back, at most _LONGEST_JUMP later.

    In these frames the tracker confused the body with another, or flipped its attitude.
    """
    while True:
        keep, back = np.ones(len(poses.t), dtype=bool), -1
        for first, last in pairwise(np.flatnonzero(jumps(poses))):
            # What follows a jump back is good, unless it still jumps once the poses before it are
            # removed.
            if first != back and poses.t[last] - poses.t[first] < _LONGEST_JUMP:
                keep[first + 1 : last + 1], back = False, last
        if keep.all():
            return poses
        poses = poses.rows(keep)


def _speeds(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Speed (K - 1,) [m/s] of each step, and the median speed of the surrounding steps."""
    speed = np.linalg.norm(np.diff(poses.p, axis=0), axis=1) / np.diff(poses.t)
    return speed, _median_around(speed)


def _median_around(x: np.ndarray) -> np.ndarray:
    """Median (M,) of the _NEIGHBOURS values on either side of each of x (M,), without itself."""
    padded = np.pad(x, _NEIGHBOURS, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1)
    return np.nanmedian(np.delete(windows, _NEIGHBOURS, axis=1), axis=1)


@dataclass(frozen=True)
class ReferenceNoise:
    """Noise of a reference.

    Attributes:
        position: standard deviation of a sample's position [m].
        stamp: standard deviation of a sample's stamp [s].
        angle: standard deviation of a sample's attitude [rad].
    """

    position: float
    stamp: float
    angle: float

    @property
    def line(self) -> str:
        """The result in words."""
        return (
            f"reference compared with the IMU: noise of {1e3 * self.position:.2g} mm, "
            f"{np.degrees(self.angle):.2g} deg and {1e3 * self.stamp:.2g} ms"
        )


def reference_noise(
    t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, poses: Poses
) -> ReferenceNoise | None:
    """Estimate the noise of a reference's samples.

    None where there are too few, or where it does not rotate like the IMU.

    Args:
        t: (N,) of the IMU's rows [s].
        gyro: (N, 3) [rad/s], mean over the step before each row.
        accel: (N, 3) [m/s^2], likewise.
        poses: with the attitude of the IMU frame; the tracked point may be elsewhere on the body.
    """
    poses = poses.rows((poses.t > t[1]) & (poses.t < t[-1]))
    extra = max(len(poses.t) - _LONGEST, 0) // 2
    poses = poses.rows(slice(extra, extra + _LONGEST))
    beside = _matching_imu(t, gyro, accel, poses)
    if beside is None:
        return None
    velocity = derivative(poses.t, poses.p, REFERENCE_WINDOW, causal=False)
    tables = (np.diff(poses.t, prepend=poses.t[0]), beside.path - beside.path[0])
    tables += (np.ascontiguousarray(beside.R_GI), velocity)

    def unlikely_at(log_sizes: np.ndarray) -> float:
        # Without noise the likelihood has no maximum; constant below the limits, it lets the
        # search end.
        return _unlikely(*tables, *np.maximum(np.exp(log_sizes), _SMALLEST))

    enough = {"xatol": 0.03, "fatol": 0.1}
    best = minimize(unlikely_at, np.log(_START), method="Nelder-Mead", options=enough)
    position, stamp, _ = np.maximum(np.exp(best.x), _SMALLEST).tolist()
    return ReferenceNoise(position, stamp, _angle(beside, stamp))


def _matching_imu(
    t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, poses: Poses
) -> ReferenceVsImu | None:
    """Poses of the IMU frame, within the times of the IMU's rows, relative to the IMU's integrals;
    None where they are too few, or do not rotate like the IMU.

    Args:
        t: (N,) of the IMU's rows [s].
        gyro: (N, 3) [rad/s], mean over the step before each row.
        accel: (N, 3) [m/s^2], likewise.
        poses: of the IMU frame.
    """
    if len(poses.t) < FEWEST_SAMPLES:
        return None
    beside = compare_with_imu(t, gyro, accel, poses)
    return beside if _missed_rotation(beside) <= _MOST_MISSED_ROTATION else None


def _missed_rotation(beside: ReferenceVsImu, at: np.ndarray | slice = slice(None)) -> float:
    """Share of the gyro's rotation that the reference does not have at samples of a mask (K,), by
    default all; over 1 for another body's.

    The median of the three axes: a robot that turns on a wrong clock, or by other axes, still has
    most of its rotation about the vertical.
    """
    other = derivative(beside.t, beside.turn, _WINDOW, causal=False)
    other = np.einsum("kji,kj->ki", beside.R_GI, other)
    turning = np.maximum(np.var(beside.omega[at], axis=0), 1e-12)
    return float(np.median(np.var(other[at], axis=0) / turning))


def _angle(beside: ReferenceVsImu, stamp: float) -> float:
    """Standard deviation of a sample's attitude [rad], about each axis.

    From the changes, between samples, of its rotation relative to the gyro's integral, less the
    contribution of the stamp's error [s].
    """
    square = np.sort(np.sum(np.diff(beside.turn, axis=0) ** 2, axis=1)) / 6.0
    by_stamps = stamp**2 * np.mean(np.sum(beside.omega**2, axis=1)) / 3.0
    # Up to 1 % of the samples may belong to another body.
    most = square[: int(np.ceil(0.99 * len(square)))].mean()
    return float(np.sqrt(max(most - by_stamps, 0.0)))


@kernel
def _transition(dt, force):
    """Transition and process noise (12, 12) over dt [s]; `force` is the density of its white
    part.
    """
    F, Q = np.eye(12), np.zeros((12, 12))
    for i in range(3):
        F[i, 3 + i], F[i, 6 + i], F[3 + i, 6 + i] = dt, 0.5 * dt * dt, dt
        Q[i, i], Q[3 + i, 3 + i] = force**2 * dt**3 / 3.0, force**2 * dt
        Q[i, 3 + i] = Q[3 + i, i] = force**2 * dt**2 / 2.0
        Q[6 + i, 6 + i] = _WANDER**2 * dt
    return F, Q


@kernel
def _unlikely(dt, path, R_GI, velocity, position, stamp, force):
    """Negative log-likelihood by a Kalman filter.

    Args:
        dt: (K,) since the sample before [s].
        path: (K, 3) of the samples relative to the IMU's [m].
        R_GI: (K, 3, 3).
        velocity: (K, 3) of the tracked point in G [m/s].
        position: standard deviation of a sample [m].
        stamp: standard deviation of its time [s].
        force: density of other accelerations of the path [m/s^2/sqrt(Hz)].
    """
    x, P = np.zeros(12), np.zeros((12, 12))
    for i in range(3):
        P[i, i], P[3 + i, 3 + i] = _LEVER**2, 1.0
        P[6 + i, 6 + i], P[9 + i, 9 + i] = _DRIFT**2, _LEVER**2
    H, unlikely = np.zeros((3, 12)), 0.0
    H[:, :3] = np.eye(3)
    for k in range(len(dt)):
        F, Q = _transition(dt[k], force)
        x = F @ x
        P = F @ P @ F.T + Q
        H[:, 9:] = R_GI[k]
        v = velocity[k]
        N = position**2 * np.eye(3) + stamp**2 * np.outer(v, v)
        S = H @ P @ H.T + N
        e = path[k] - H @ x
        gain = np.ascontiguousarray(np.linalg.solve(S, H @ P).T)
        x = x + gain @ e
        # Joseph's form, which stays positive definite under rounding.
        keep = np.eye(12) - gain @ H
        P = keep @ P @ keep.T + gain @ N @ gain.T
        unlikely += 0.5 * (np.log(np.linalg.det(S)) + e @ np.linalg.solve(S, e))
    return unlikely


def contradicted(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, poses: Poses) -> np.ndarray:
    """Mask (K,) of the samples around which the reference's velocity changes and the IMU's does
    not.

    All False where the reference as a whole does not match the IMU, or has too few samples.

    Args:
        t: (N,) of the IMU's rows [s].
        gyro: (N, 3) [rad/s], mean over the step before each row.
        accel: (N, 3) [m/s^2], likewise.
        poses: K, of the IMU frame.
    """
    found = np.zeros(len(poses.t), dtype=bool)
    known = np.flatnonzero((poses.t > t[1]) & (poses.t < t[-1]))
    beside = _matching_imu(t, gyro, accel, poses.rows(known))
    if beside is None:
        return found
    dt = float(np.median(np.diff(t)))
    half = max(0.5 * _WINDOW, 2.0 * float(np.median(np.diff(beside.t))))
    v = derivative(beside.t, beside.path, 0.5 * _WINDOW, causal=False)
    before = np.searchsorted(beside.t, beside.t - half)
    after = np.searchsorted(beside.t, beside.t + half, side="right") - 1
    change = np.linalg.norm(v[after] - v[before], axis=1)
    # Samples of what shakes a body between the rows, in place of averages, change as much.
    bend = np.sum((accel[1:-1] - 0.5 * (accel[2:] + accel[:-2])) ** 2, axis=1) / 1.5
    summed = np.interp(beside.t[:, None] + [-half, half], t[1:-1], np.cumsum(bend * dt**2))
    sampled = _SURELY * np.sqrt(np.diff(summed, axis=1)[:, 0])
    bad = change > np.maximum(max(_LEAST_CHANGE, _OUTLYING * float(np.median(change))), sampled)
    if np.median(change) > _LEAST_CHANGE or not bad.any() or bad.mean() > _MOST_CONTRADICTED:
        return found
    out = _closed(beside.t, bad)
    if (
        out.mean() > 2.0 * _MOST_CONTRADICTED
        or _missed_rotation(beside, ~out) > _MOST_MISSED_ROTATION
    ):
        return found
    found[known] = out
    found[: known[0]] = found[known[0]]
    found[known[-1] + 1 :] = found[known[-1]]
    return found


def _closed(t: np.ndarray, bad: np.ndarray) -> np.ndarray:
    """The mask (K,), extended by good sections that are too short."""
    out = bad.copy()
    edges = np.flatnonzero(np.diff(bad.astype(int), prepend=1, append=1))
    for first, end in edges.reshape(-1, 2):
        if t[min(end, len(t) - 1)] - t[max(first - 1, 0)] < _SHORTEST_SECTION:
            out[first:end] = True
    return out
