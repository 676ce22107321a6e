"""Error of an estimate over time, with the filter's own standard deviations."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.metrics import align_first, matched, vector_jacobian

NAMED_AXES = (("x", "forward"), ("y", "left"), ("z", "up"))
QUANTITIES = (
    ("position", "position [m]", "xyz", 1.0),
    ("attitude", "attitude [deg]", ("roll", "pitch", "yaw"), np.degrees(1.0)),
    ("velocity", "velocity [m/s]", ("forward", "left", "up"), 1.0),
)
"""Field of an ErrorSeries, its title, its axes, and the factor to the unit of the title."""


@dataclass(frozen=True)
class ErrorSeries:
    """Error of one estimator over time, after aligning position and yaw at its first sample.

    `position` is p_bar - p in G. `attitude` is log(R_bar R^T) in the robot's heading frame: about
    forward (roll), left (pitch) and up (yaw). `velocity` is that of the IMU in I. The sigmas are
    the filter's own, None without covariance; the position's is that of J Sigma J^T with J =
    [-[p_bar]x 0 I] on (rotation, velocity, position), the velocity's that of R_bar^T Sigma_vv
    R_bar.
    """

    t: np.ndarray  # (M,) s
    p_GI: np.ndarray  # (M, 3) m, aligned
    R_GI: np.ndarray  # (M, 3, 3), aligned
    position: np.ndarray  # (M, 3) m
    attitude: np.ndarray  # (M, 3) rad
    velocity: np.ndarray  # (M, 3) m/s
    position_sigma: np.ndarray | None  # (M, 3) m
    attitude_sigma: np.ndarray | None  # (M, 3) rad
    velocity_sigma: np.ndarray | None  # (M, 3) m/s
    position_covariance: np.ndarray | None = None  # (M, 3, 3) m^2

    @property
    def distance(self) -> np.ndarray:
        """Norm of the position error (M,), m."""
        return np.linalg.norm(self.position, axis=1)

    @property
    def distance_sigma(self) -> np.ndarray | None:
        """Root of the position covariance's trace (M,) [m], the expected RMS of the norm."""
        if self.position_sigma is None:
            return None
        return np.linalg.norm(self.position_sigma, axis=1)


def error_series(
    reference: Trajectory, estimate: Trajectory, rate: float | None = None
) -> ErrorSeries:
    """Errors of an estimate at the stamps it shares with the reference (100 Hz at most).

    `rate` [Hz] keeps fewer samples. Raises TrajectoryError where they share no stamps.
    """
    reference, estimate = matched(reference, estimate)
    if rate:
        slots = np.floor((reference.t - reference.t[0]) * rate + 1e-3)
        kept = np.unique(slots, return_index=True)[1]
        reference, estimate = reference.rows(kept), estimate.rows(kept)
    aligned = align_first(reference, estimate)
    yaw = np.arctan2(reference.R_GI[:, 1, 0], reference.R_GI[:, 0, 0])
    to_heading = Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, -1.0]).as_matrix()
    turned = aligned.R_GI @ reference.R_GI.transpose(0, 2, 1)
    attitude = Rotation.from_matrix(turned).as_rotvec()
    position_sigma = attitude_sigma = velocity_sigma = covariance = None
    if aligned.covariance is not None:
        S = aligned.covariance[:, :9, :9]
        J = vector_jacobian(aligned.p_GI, 6)
        covariance = J @ S @ J.swapaxes(1, 2)
        position_sigma = _sigma(J, S)
        attitude_sigma = _sigma(to_heading, S[:, :3, :3])
        velocity_sigma = _sigma(aligned.R_GI.transpose(0, 2, 1), S[:, 3:6, 3:6])
    return ErrorSeries(
        t=aligned.t,
        p_GI=aligned.p_GI,
        R_GI=aligned.R_GI,
        position=aligned.p_GI - reference.p_GI,
        attitude=(to_heading @ attitude[..., None])[..., 0],
        velocity=aligned.v_I - reference.v_I,
        position_sigma=position_sigma,
        attitude_sigma=attitude_sigma,
        velocity_sigma=velocity_sigma,
        position_covariance=covariance,
    )


def _sigma(J: np.ndarray, S: np.ndarray) -> np.ndarray:
    """Square root of the diagonal (M, 3) of J S J^T."""
    return np.sqrt(((J @ S) * J).sum(axis=2).clip(0.0))
