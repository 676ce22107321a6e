"""Compiled leg kinematics: serial hinges from the base to a foot, and the foot's motion.

Nothing is allocated per leg, as these run at every step.
"""

from typing import NamedTuple

import numpy as np

from surefoot.sim.common.kernels import kernel


class Legs(NamedTuple):
    """Constants of L legs with up to P joints, read from a model, in m and rad.

    `joints` are the indices of each leg's joints among the robot's J joints; only the first
    `joint_count` of a leg are valid. From the base B outwards, `offset` and `rotation` map the
    frame of the previous link to that of joint j's link at q = q_zero, `axis` and `anchor` describe
    the hinge in that link's own frame, and `foot` is the foot's centre, or the middle of a flat
    sole, in the last link's frame.
    """

    offset: np.ndarray  # (L, P, 3)
    rotation: np.ndarray  # (L, P, 3, 3)
    axis: np.ndarray  # (L, P, 3)
    anchor: np.ndarray  # (L, P, 3)
    q_zero: np.ndarray  # (L, P)
    foot: np.ndarray  # (L, 3)
    joints: np.ndarray  # (L, P), whole numbers
    joint_count: np.ndarray  # (L,), whole numbers


@kernel
def leg_forward(legs, leg, q, foot, jacobian, axes):
    """Forward kinematics of one leg, all in B.

    Args:
        legs: geometry of the legs.
        leg: its index.
        q: (J,) [rad], all joints of the robot.
        foot: (3,) [m], filled with the foot's centre.
        jacobian: (3, P) [m/rad], filled with its Jacobian by the leg's joints.
        axes: (3, P), filled with the joint axes as columns.
    """
    # Rotations are tuples of nine numbers, row by row, since arrays would be allocated at every
    # step.
    R = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    x, y, z = 0.0, 0.0, 0.0
    count = legs.joint_count[leg]
    for j in range(count):
        dx, dy, dz = _apply(R, legs.offset[leg, j])
        R = _times(R, _numbers(legs.rotation[leg, j]))
        ax, ay, az = _apply(R, legs.anchor[leg, j])
        # The hinge's position is stored in the Jacobian's column until the foot's is known.
        x, y, z = x + dx + ax, y + dy + ay, z + dz + az
        jacobian[0, j], jacobian[1, j], jacobian[2, j] = x, y, z
        axes[0, j], axes[1, j], axes[2, j] = _apply(R, legs.axis[leg, j])
        angle = q[legs.joints[leg, j]] - legs.q_zero[leg, j]
        R = _times(R, axis_rotation(legs.axis[leg, j], angle))
        ax, ay, az = _apply(R, legs.anchor[leg, j])
        x, y, z = x - ax, y - ay, z - az
    dx, dy, dz = _apply(R, legs.foot[leg])
    foot[0], foot[1], foot[2] = x + dx, y + dy, z + dz
    for j in range(count):
        ax, ay, az = axes[0, j], axes[1, j], axes[2, j]
        lx, ly, lz = foot[0] - jacobian[0, j], foot[1] - jacobian[1, j], foot[2] - jacobian[2, j]
        jacobian[0, j] = ay * lz - az * ly
        jacobian[1, j] = az * lx - ax * lz
        jacobian[2, j] = ax * ly - ay * lx
    for j in range(count, jacobian.shape[1]):
        for a in range(3):
            jacobian[a, j] = axes[a, j] = 0.0


class BaseMotion(NamedTuple):
    """Motion of a robot's base."""

    p: np.ndarray  # (3,) m, in G
    R: np.ndarray  # (3, 3) from B to G
    v: np.ndarray  # (3,) m/s, in G
    w: np.ndarray  # (3,) rad/s, in B


class FootMotion(NamedTuple):
    """Motion of one foot in G, filled by `foot_motion`."""

    place: np.ndarray  # (3,) m, of the foot's centre
    velocity: np.ndarray  # (3,) m/s
    jacobian: np.ndarray  # (3, 3) m, of the place by the leg's joints
    spin: np.ndarray  # (3,) rad/s, of the foot's link


@kernel(nogil=True)
def foot_motion(base, rates, foot, J, axes, out):
    """Motion of a leg's foot in the world.

    Args:
        base: a BaseMotion.
        rates: (3,) of the leg's joints [rad/s].
        foot, J, axes: (3,), (3, 3), (3, 3) from `leg_forward`.
        out: a FootMotion, filled.
    """
    p, R, v, w = base
    place, velocity, jacobian, spin = out
    wx, wy, wz = w[0], w[1], w[2]
    x, y, z = foot[0], foot[1], foot[2]
    a, b, c = rates[0], rates[1], rates[2]
    vx = wy * z - wz * y + J[0, 0] * a + J[0, 1] * b + J[0, 2] * c
    vy = wz * x - wx * z + J[1, 0] * a + J[1, 1] * b + J[1, 2] * c
    vz = wx * y - wy * x + J[2, 0] * a + J[2, 1] * b + J[2, 2] * c
    wx += axes[0, 0] * a + axes[0, 1] * b + axes[0, 2] * c
    wy += axes[1, 0] * a + axes[1, 1] * b + axes[1, 2] * c
    wz += axes[2, 0] * a + axes[2, 1] * b + axes[2, 2] * c
    for i in range(3):
        r, s, t = R[i, 0], R[i, 1], R[i, 2]
        place[i] = p[i] + r * x + s * y + t * z
        velocity[i] = v[i] + r * vx + s * vy + t * vz
        spin[i] = r * wx + s * wy + t * wz
        for j in range(3):
            jacobian[i, j] = r * J[0, j] + s * J[1, j] + t * J[2, j]


@kernel(nogil=True)
def sole_motion(velocity, spin, radius, normal, sole_v):
    """Velocity of a foot's contact point, all in one frame.

    Args:
        velocity: (3,) [m/s], of the foot's centre.
        spin: (3,) [rad/s], angular velocity of the foot.
        radius: of the foot [m].
        normal: (3,), the ground's normal.
        sole_v: (3,) [m/s], filled.
    """
    x, y, z = radius * normal[0], radius * normal[1], radius * normal[2]
    sole_v[0] = velocity[0] - (spin[1] * z - spin[2] * y)
    sole_v[1] = velocity[1] - (spin[2] * x - spin[0] * z)
    sole_v[2] = velocity[2] - (spin[0] * y - spin[1] * x)


@kernel
def axis_rotation(axis, angle):
    """Rodrigues' formula: rotation by `angle` about the unit vector `axis`, as nine numbers."""
    s, c = np.sin(angle), np.cos(angle)
    x, y, z = axis[0], axis[1], axis[2]
    u = 1.0 - c
    first = c + x * x * u, x * y * u - z * s, x * z * u + y * s
    second = y * x * u + z * s, c + y * y * u, y * z * u - x * s
    third = z * x * u - y * s, z * y * u + x * s, c + z * z * u
    return first + second + third


@kernel
def _times(A, B):
    return (
        A[0] * B[0] + A[1] * B[3] + A[2] * B[6],
        A[0] * B[1] + A[1] * B[4] + A[2] * B[7],
        A[0] * B[2] + A[1] * B[5] + A[2] * B[8],
        A[3] * B[0] + A[4] * B[3] + A[5] * B[6],
        A[3] * B[1] + A[4] * B[4] + A[5] * B[7],
        A[3] * B[2] + A[4] * B[5] + A[5] * B[8],
        A[6] * B[0] + A[7] * B[3] + A[8] * B[6],
        A[6] * B[1] + A[7] * B[4] + A[8] * B[7],
        A[6] * B[2] + A[7] * B[5] + A[8] * B[8],
    )


@kernel
def _apply(R, v):
    return (
        R[0] * v[0] + R[1] * v[1] + R[2] * v[2],
        R[3] * v[0] + R[4] * v[1] + R[5] * v[2],
        R[6] * v[0] + R[7] * v[1] + R[8] * v[2],
    )


@kernel
def _numbers(M):
    return M[0, 0], M[0, 1], M[0, 2], M[1, 0], M[1, 1], M[1, 2], M[2, 0], M[2, 1], M[2, 2]


@kernel
def feet(legs, q, R_BI, p_BI):
    """Foot centres (N, L, 3), Jacobians and joint axes (both (N, L, 3, P)) in I, for q (N, J)."""
    n, (count, per) = q.shape[0], legs.q_zero.shape
    position = np.empty((n, count, 3))
    jacobian = np.empty((n, count, 3, per))
    axes = np.empty((n, count, 3, per))
    R_IB = _numbers(R_BI.T)
    foot, J, Z = np.empty(3), np.empty((3, per)), np.empty((3, per))
    for k in range(n):
        for leg in range(count):
            leg_forward(legs, leg, q[k], foot, J, Z)
            for a in range(3):
                foot[a] -= p_BI[a]
            place = _apply(R_IB, foot)
            for a in range(3):
                position[k, leg, a] = place[a]
            for j in range(per):
                column = _apply(R_IB, (J[0, j], J[1, j], J[2, j]))
                axis = _apply(R_IB, (Z[0, j], Z[1, j], Z[2, j]))
                for a in range(3):
                    jacobian[k, leg, a, j] = column[a]
                    axes[k, leg, a, j] = axis[a]
    return position, jacobian, axes


@kernel
def last_links(legs, q):
    """Rotations (N, L, 3, 3) of the links that carry the feet, in B, for q (N, J)."""
    out = np.empty((len(q), len(legs.joint_count), 3, 3))
    for k in range(len(q)):
        for leg in range(out.shape[1]):
            R = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
            for j in range(legs.joint_count[leg]):
                angle = q[k, legs.joints[leg, j]] - legs.q_zero[leg, j]
                R = _times(R, _numbers(legs.rotation[leg, j]))
                R = _times(R, axis_rotation(legs.axis[leg, j], angle))
            for i in range(9):
                out[k, leg, i // 3, i % 3] = R[i]
    return out
