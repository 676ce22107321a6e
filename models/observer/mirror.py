"""The mirror image of a walk, in which left is right, as further training data."""

import numpy as np


def mirrored(
    x: np.ndarray, v_I: np.ndarray, R_BI: np.ndarray, legs: int
) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and velocity as if seen in a mirror along the base's x and z axes.

    Vectors are reflected, the angular velocity, a pseudovector, also changes its sign, and each leg
    takes the readings of that on the other side.

    Args:
        x: gyro (3), contacts (L) if any, and of each leg place (3 L) and velocity (3 L), (M, C).
        v_I: velocity (M, 3) [m/s].
        R_BI: attitude of the IMU frame in the base (3, 3).
        legs: their number L.
    """
    M = R_BI.T @ np.diag([1.0, -1.0, 1.0]) @ R_BI
    gyro, contact, feet = np.split(x, [3, x.shape[1] - 6 * legs], axis=1)
    feet = feet.reshape(len(x), 2, legs, 3)
    places = feet[:, 0].mean(axis=0)
    opposite = np.linalg.norm((places @ M)[None] - places[:, None], axis=2).argmin(axis=1)
    legs_as = (feet @ M)[:, :, opposite].reshape(len(x), -1)
    contact = contact[:, opposite] if contact.shape[1] else contact
    return np.concatenate([-gyro @ M, contact, legs_as], axis=1), v_I @ M
