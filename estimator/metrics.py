"""Trajectory metrics.

All are RMSE over poses or pairs at 100 Hz. The estimate is aligned to the reference in position and
yaw, which proprioception cannot observe, at the first common sample; SE(3)-aligned metrics have
`se3` in their names.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from surefoot.estimator.core.lie import hat
from surefoot.estimator.evaluation.trajectory import Trajectory, TrajectoryError
from surefoot.sim.common.series import rows_every

METRICS_RATE = 100.0
"""Rate at which metrics are computed [Hz]."""
MATCH = 1e-3
"""Largest difference between two stamps of the same sample [s]."""
SEGMENT, SEGMENT_TOLERANCE = 1.0, 0.1
"""Length of the segments of the relative error, and tolerance of a pair [m]."""
PATH_STEP = 0.5
"""Time between the positions whose distances are the length of a path [s]."""
CONSISTENT = 3.0
"""NEES of three axes if a filter's covariance is that of its error."""
ONE_WALK = tuple(float(edge) for edge in chi2.ppf((0.025, 0.975), CONSISTENT))
"""95 % interval of the NEES of a consistent filter on one walk, whose persistent error is one
draw.
"""


@dataclass(frozen=True)
class Metrics:
    """Results of `evaluate`; NaN where undefined (no covariance, no updates, no segment).

    Attributes:
        ape_trans: absolute position error after aligning position and yaw at the first sample [m].
        ape_rot: absolute rotation error, likewise [deg].
        rpe_trans: relative position error over all 1 m segments of the reference path [m].
        rpe_rot: relative rotation error [deg/m].
        ape_trans_se3: absolute position error after least-squares SE(3) alignment [m].
        ape_rot_se3: absolute rotation error, likewise [deg].
        velocity: RMSE of the velocity in I, which needs no alignment [m/s].
        nees_position: mean normalised squared error, 3 for a consistent filter.
        nees_velocity: likewise.
        nees_attitude: likewise.
        pi_below_gamma: share of updates that were active [%].
        duration: of the common part [s].
        length: of the reference's path, sampled every 0.5 s [m].
        samples: of the common part.
        segments: pairs of the RPE.
    """

    ape_trans: float
    ape_rot: float
    rpe_trans: float
    rpe_rot: float
    ape_trans_se3: float
    ape_rot_se3: float
    velocity: float
    nees_position: float
    nees_velocity: float
    nees_attitude: float
    pi_below_gamma: float
    duration: float
    length: float
    samples: int
    segments: int


@dataclass(frozen=True)
class Nees:
    """Normalised estimation error squared (N,) of each sample; NaN at the first, aligned one."""

    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray


def evaluate(reference: Trajectory, estimate: Trajectory) -> Metrics:
    """Metrics of an estimate against a reference. Raises TrajectoryError without common samples."""
    reference, estimate = matched(reference, estimate)
    aligned = align_first(reference, estimate)
    rpe_trans, rpe_rot = relative_errors(reference, aligned)
    trans, rot = absolute_errors(reference, aligned)
    poses = replace(estimate, covariance=None)
    trans_se3, rot_se3 = absolute_errors(reference, align_se3(reference, poses))
    consistency = nees(reference, aligned)
    active = estimate.updates.active if estimate.updates is not None else np.zeros(0)
    coverage = estimate.updates is not None and estimate.updates.pi is not None
    return Metrics(
        ape_trans=_rms(trans),
        ape_rot=_rms(rot),
        rpe_trans=_rms(rpe_trans),
        rpe_rot=_rms(rpe_rot),
        ape_trans_se3=_rms(trans_se3),
        ape_rot_se3=_rms(rot_se3),
        velocity=_rms(np.linalg.norm(estimate.v_I - reference.v_I, axis=1)),
        nees_position=_mean(consistency.position),
        nees_velocity=_mean(consistency.velocity),
        nees_attitude=_mean(consistency.attitude),
        pi_below_gamma=100.0 * _mean(active) if coverage else np.nan,
        duration=float(reference.t[-1] - reference.t[0]),
        length=path_length(reference.t, reference.p_GI),
        samples=len(reference.t),
        segments=len(rpe_trans),
    )


def matched(reference: Trajectory, estimate: Trajectory) -> tuple[Trajectory, Trajectory]:
    """Both trajectories at their common stamps (within 1 ms), thinned to 100 Hz, without
    interpolation.
    """
    if len(reference.t) == 0 or len(estimate.t) == 0:
        raise TrajectoryError("metrics: a trajectory is empty")
    last = len(reference.t) - 1
    after = np.clip(np.searchsorted(reference.t, estimate.t), min(1, last), last)
    before = np.maximum(after - 1, 0)
    closer = estimate.t - reference.t[before] <= reference.t[after] - estimate.t
    nearest = np.where(closer, before, after)
    rows = np.flatnonzero(np.abs(reference.t[nearest] - estimate.t) <= MATCH)
    if len(rows) < 2:
        raise TrajectoryError("metrics: reference and estimate have no two stamps in common")
    slots = np.floor((estimate.t[rows] - estimate.t[rows[0]]) * METRICS_RATE + 1e-3)
    rows = rows[np.unique(slots, return_index=True)[1]]
    return reference.rows(nearest[rows]), estimate.rows(rows)


def align_first(reference: Trajectory, estimate: Trajectory) -> Trajectory:
    """Move the estimate so that its first position is the reference's and its first yaw is nearest.

    The yaw is that which leaves the smallest rotation to the reference's first attitude.
    """
    D = reference.R_GI[0] @ estimate.R_GI[0].T
    yaw = np.arctan2(D[1, 0] - D[0, 1], D[0, 0] + D[1, 1])
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return transformed(estimate, R, reference.p_GI[0] - R @ estimate.p_GI[0])


def align_se3(reference: Trajectory, estimate: Trajectory) -> Trajectory:
    """Align the estimate by the least-squares rotation and translation (Umeyama 1991, no scale)."""
    to, at = reference.p_GI.mean(axis=0), estimate.p_GI.mean(axis=0)
    U, _, Vt = np.linalg.svd((reference.p_GI - to).T @ (estimate.p_GI - at))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))]) @ Vt
    return transformed(estimate, R, to - R @ at)


def transformed(trajectory: Trajectory, R: np.ndarray, p: np.ndarray) -> Trajectory:
    """Change the world frame of a trajectory: X -> T X for T = (R (3, 3), p (3,)).

    A right-invariant error changes as xi -> Ad_T xi, and its covariance with it.
    """
    covariance = trajectory.covariance
    if covariance is not None:
        A = np.eye(15)
        for k in range(3):
            A[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = R
        A[6:9, :3] = hat(p) @ R
        covariance = A @ covariance @ A.T
    return replace(
        trajectory,
        R_GI=R @ trajectory.R_GI,
        v_GI=trajectory.v_GI @ R.T,
        p_GI=trajectory.p_GI @ R.T + p,
        covariance=covariance,
    )


def absolute_errors(reference: Trajectory, estimate: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Distance (N,) [m] and rotation angle (N,) [deg] between the poses, without alignment."""
    distance = np.linalg.norm(estimate.p_GI - reference.p_GI, axis=1)
    return distance, _angle(np.swapaxes(reference.R_GI, 1, 2) @ estimate.R_GI)


def relative_errors(reference: Trajectory, estimate: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the relative pose over each 1 m segment: (P,) [m], and rotation (P,) [deg/m]."""
    i, j = segments(reference.p_GI)
    R_ref, p_ref = _relative(reference, i, j)
    R_est, p_est = _relative(estimate, i, j)
    # The error pose (T_ref^-1 T_est): its translation has the length of p_est - p_ref.
    distance = np.linalg.norm(p_est - p_ref, axis=1)
    return distance, _angle(np.swapaxes(R_ref, 1, 2) @ R_est) / SEGMENT


def segments(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index pairs i < j whose path along p (N, 3) is nearest to 1 m, within 10 %: one for each
    start i.
    """
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    i = np.arange(len(path) - 1)
    above = np.clip(np.searchsorted(path, path[i] + SEGMENT), i + 1, len(path) - 1)
    # Of equal distances take the first, since the robot may have stood still there.
    below = np.maximum(np.searchsorted(path, path[above - 1]), i + 1)
    miss_above = np.abs(path[above] - path[i] - SEGMENT)
    miss_below = np.abs(path[below] - path[i] - SEGMENT)
    j = np.where(miss_below <= miss_above, below, above)
    good = np.abs(path[j] - path[i] - SEGMENT) <= SEGMENT * SEGMENT_TOLERANCE
    return i[good], j[good]


def nees(reference: Trajectory, estimate: Trajectory) -> Nees:
    """NEES of position, velocity and attitude in G, for an estimate aligned to the reference.

    Position: p_bar - p with covariance J Sigma J^T, J = [-[p_bar]x 0 I] on (rotation, velocity,
    position); velocity likewise with [-[v_bar]x I 0]; attitude: log(R_bar R^T) with [I 0 0].
    """
    if estimate.covariance is None:
        nothing = np.full(len(estimate.t), np.nan)
        return Nees(nothing, nothing, nothing)
    S = estimate.covariance[:, :9, :9]
    position = _normalised(estimate.p_GI - reference.p_GI, vector_jacobian(estimate.p_GI, 6), S)
    velocity = _normalised(estimate.v_GI - reference.v_GI, vector_jacobian(estimate.v_GI, 3), S)
    rotation = Rotation.from_matrix(estimate.R_GI @ np.swapaxes(reference.R_GI, 1, 2)).as_rotvec()
    attitude = _normalised(rotation, np.eye(3, 9)[None], S)
    return Nees(position, velocity, attitude)


def vector_jacobian(x: np.ndarray, at: int) -> np.ndarray:
    """Jacobian (N, 3, 9) of x_bar - x with respect to (rotation, velocity, position).

    x (N, 3) is the velocity, whose error begins at column 3, or the position, at column 6.
    """
    J = np.zeros((len(x), 3, 9))
    J[:, :, :3], J[:, :, at : at + 3] = -hat(x), np.eye(3)
    return J


def path_length(t: np.ndarray, p: np.ndarray) -> float:
    """Length [m] of a path p (N, 3) at t (N,), sampled every PATH_STEP: a gait's bobbing does
    not count.
    """
    rows = np.append(rows_every(t, PATH_STEP), len(t) - 1)
    return float(np.linalg.norm(np.diff(p[rows], axis=0), axis=1).sum())


def _normalised(error: np.ndarray, J: np.ndarray, S: np.ndarray) -> np.ndarray:
    covariance = J @ S @ np.swapaxes(J, 1, 2)
    out = np.full(len(error), np.nan)
    scale = np.trace(covariance, axis1=1, axis2=2)
    definite = np.linalg.eigvalsh(covariance)[:, 0] > 1e-14 * scale
    definite[0] = False
    solved = np.linalg.solve(covariance[definite], error[definite][..., None])[..., 0]
    out[definite] = np.einsum("ni,ni->n", error[definite], solved)
    return out


def _relative(trajectory: Trajectory, i: np.ndarray, j: np.ndarray):
    Rt = np.swapaxes(trajectory.R_GI[i], 1, 2)
    step = (trajectory.p_GI[j] - trajectory.p_GI[i])[..., None]
    return Rt @ trajectory.R_GI[j], (Rt @ step)[..., 0]


def _angle(R: np.ndarray) -> np.ndarray:
    """Geodesic angle (N,) [deg] of the rotations (N, 3, 3)."""
    return np.degrees(Rotation.from_matrix(R).magnitude())


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x)))) if len(x) else np.nan


def _mean(x: np.ndarray) -> float:
    x = x[np.isfinite(x)]
    return float(np.mean(x)) if len(x) else np.nan
