"""Leg kinematics, compiled: three hinges in series from the base to a foot."""

from typing import NamedTuple

import numpy as np
from numba import njit


class Legs(NamedTuple):
    """Constants of four three-joint legs, read from a model; everything in m and rad.

    A leg is walked from the base B outwards: `offset` and `rotation` take the frame of the
    previous link to that of joint j's link at q = q_zero, `axis` and `anchor` are the
    hinge in that link's own frame, and `foot` is the foot's centre in the last link's frame.
    """

    offset: np.ndarray  # (4, 3, 3)
    rotation: np.ndarray  # (4, 3, 3, 3)
    axis: np.ndarray  # (4, 3, 3)
    anchor: np.ndarray  # (4, 3, 3)
    q_zero: np.ndarray  # (4, 3)
    foot: np.ndarray  # (4, 3)


@njit(cache=True)
def axis_rotation(axis, angle):
    """Rodrigues' formula: the rotation (3, 3) by `angle` about the unit vector `axis`."""
    s, c = np.sin(angle), np.cos(angle)
    x, y, z = axis
    u = 1.0 - c
    return np.array(
        [
            [c + x * x * u, x * y * u - z * s, x * z * u + y * s],
            [y * x * u + z * s, c + y * y * u, y * z * u - x * s],
            [z * x * u - y * s, z * y * u + x * s, c + z * z * u],
        ]
    )


@njit(cache=True)
def leg_forward(legs, leg, q, foot, jacobian, axes):
    """Foot centre (3,), its Jacobian (3, 3) and the joint axes (3, 3, as columns), all in B."""
    R = np.eye(3)
    p = np.zeros(3)
    anchors = np.empty((3, 3))
    for j in range(3):
        p = p + R @ legs.offset[leg, j]
        R = R @ legs.rotation[leg, j]
        anchors[j] = p + R @ legs.anchor[leg, j]
        axes[:, j] = R @ legs.axis[leg, j]
        R = R @ axis_rotation(legs.axis[leg, j], q[j] - legs.q_zero[leg, j])
        p = anchors[j] - R @ legs.anchor[leg, j]
    foot[:] = p + R @ legs.foot[leg]
    for j in range(3):
        jacobian[:, j] = np.cross(axes[:, j], foot - anchors[j])


@njit(cache=True)
def feet(legs, q, R_BI, p_BI):
    """Of q (N, 12): foot centres (N, 4, 3), Jacobians (N, 4, 3, 3), joint axes (N, 4, 3, 3), in I."""
    n = q.shape[0]
    position = np.empty((n, 4, 3))
    jacobian = np.empty((n, 4, 3, 3))
    axes = np.empty((n, 4, 3, 3))
    R_IB = np.ascontiguousarray(R_BI.T)
    foot, J, Z = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for k in range(n):
        for leg in range(4):
            leg_forward(legs, leg, q[k, 3 * leg : 3 * leg + 3], foot, J, Z)
            position[k, leg] = R_IB @ (foot - p_BI)
            jacobian[k, leg] = R_IB @ J
            axes[k, leg] = R_IB @ Z
    return position, jacobian, axes
