"""Conversion of velocities between two IMU mountings on one body."""

from typing import Protocol

import numpy as np


class Mounted(Protocol):
    """The properties of a robot that an observer needs: its name, and the mounting of its IMU frame
    I in the base frame B.
    """

    @property
    def name(self) -> str: ...
    @property
    def p_BI(self) -> np.ndarray: ...
    @property
    def R_BI(self) -> np.ndarray: ...


def same_mounting(a: Mounted, b: Mounted) -> bool:
    """Whether two mountings agree to a tenth of a millimetre and a ten-thousandth of a radian."""
    return bool(np.allclose(a.p_BI, b.p_BI, atol=1e-4) and np.allclose(a.R_BI, b.R_BI, atol=1e-4))


def move_velocity(
    v_I: np.ndarray, covariance: np.ndarray | None, gyro: np.ndarray, old: Mounted, new: Mounted
) -> tuple[np.ndarray, np.ndarray | None]:
    """Velocity (M, 3) [m/s] of the new IMU's origin, in its own frame, and its covariances.

    With v_I = R_BI^T (v_B + omega x p_BI) at both,

        v_new = R_new^T (R_old v_old + omega x (p_new - p_old)).

    Args:
        v_I: velocity (M, 3) [m/s] of the old IMU.
        covariance: of v_I (M, 3, 3), which turns with the frame; None stays None.
        gyro: measured in the new frame (M, 3) [rad/s].
        old: mounting of v_I.
        new: mounting of the result.
    """
    omega_B = gyro @ new.R_BI.T
    v_B = v_I @ old.R_BI.T + np.cross(omega_B, new.p_BI - old.p_BI)
    R = new.R_BI.T @ old.R_BI
    return v_B @ new.R_BI, None if covariance is None else R @ covariance @ R.T
