"""Leg odometry in the observer: the robot's declared kinematics, corrected by a network.

A contact point at rest on the ground gives v_I = -(u + omega x s), with s its position and u its
velocity relative to the base, and omega the gyro's. With `feet` among its inputs, the network
receives s and u + omega x s of all legs and computes

    v = -gain * sum_l w_l (u_l + omega x s_l) + m head(features),    w = softmax(gates(features)),
    m = r^2 / (r^2 + STILL^2),    r^2 = mean_l |u_l + omega x s_l|^2.

It learns which legs stand, as well as slip, and the robot's deviation from its declared geometry.
Speeds beyond those of the training walks are extrapolated by the kinematics, not by the network.
A robot whose legs and body are still, in whatever posture, is taken to be at rest.

Velocities of an IMU mounted at another place of the same body are converted by `move_velocity`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import kernel
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import Legs, leg_forward

STILL = 0.05
"""Speed of the contact points relative to the ground [m/s] at which the network's correction counts
half. In walking it is 0.5 and more, as a leg swings; of a robot that stands, the noise is 0.01.
"""


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


LegGeometry = dict[str, np.ndarray]
"""The fields of surefoot.sim.robot.kinematics.Legs, and `radius` (L,) of the feet [m], as stored in
a checkpoint for a robot with L legs. Those of version 0.1.0, with three joints per leg, have no
`joints` and no `joint_count`.
"""


def leg_geometry(robot: Mounted, joints: tuple[str, ...]) -> LegGeometry:
    """Geometry that `contact_points` needs, from a robot's declared model.

    Raises SurefootError where it has no legs, or a log's joints are not its own.
    """
    if not isinstance(robot, Robot) or joints != robot.limbs.joints:
        raise SurefootError(
            f"inputs feet: the log's joints are not known as those of {robot.name}, its feet "
            "cannot be computed"
        )
    values = robot.legs._asdict() | {"radius": robot.foot_radius}
    return {name: np.array(value, dtype=float) for name, value in values.items()}


def complete_geometry(geometry: LegGeometry) -> LegGeometry:
    """Add missing `joints` and `joint_count`, for three consecutive joints per leg."""
    legs = len(geometry.get("radius", ()))
    in_turn = np.arange(3.0 * legs).reshape(legs, 3)
    return {"joints": in_turn, "joint_count": np.full(legs, 3.0)} | geometry


def complete_weights(weights: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Add the missing `speed` to the weights of leg odometry: in observers of 0.1.0 the correction
    never fades.
    """
    return {"odometry.speed": np.zeros(3, np.float32)} | dict(weights)


def check_leg_geometry(geometry: LegGeometry, joints: int) -> None:
    """Raise ValueError if it is not the geometry of a robot's legs with so many joints."""
    geometry = complete_geometry(geometry)
    legs = len(geometry.get("radius", ()))
    per = geometry["q_zero"].shape[-1] if "q_zero" in geometry else 3
    shapes = {
        "rotation": (legs, per, 3, 3),
        "foot": (legs, 3),
        "radius": (legs,),
        "joint_count": (legs,),
    }
    shapes |= dict.fromkeys(("offset", "axis", "anchor"), (legs, per, 3))
    shapes |= dict.fromkeys(("q_zero", "joints"), (legs, per))
    if set(geometry) != set(shapes) or not legs:
        raise ValueError("legs is not the geometry of legs")
    for name, shape in shapes.items():
        value = geometry[name]
        if value.shape != shape or value.dtype != float:
            raise ValueError(f"legs: {name} is not of shape {shape} and float64")
        if not np.isfinite(value).all():
            raise ValueError(f"legs: {name} is not finite")
    order, count = geometry["joints"], geometry["joint_count"]
    if not (((order >= 0) & (order < joints)).all() and ((count >= 1) & (count <= per)).all()):
        raise ValueError(f"legs: joints are not within the robot's {joints}")


class Kinematics(NamedTuple):
    """Leg geometry and the IMU's mounting, in the form that the kernels take."""

    legs: Legs
    radius: np.ndarray
    R_BI: np.ndarray
    p_BI: np.ndarray

    @classmethod
    def of(cls, geometry: LegGeometry, mounting: Mounted) -> Kinematics:
        whole = complete_geometry(geometry)
        values = {name: np.ascontiguousarray(value) for name, value in whole.items()}
        values |= {name: values[name].astype(np.int64) for name in ("joints", "joint_count")}
        R_BI, p_BI = (np.array(x, dtype=float) for x in (mounting.R_BI, mounting.p_BI))
        return cls(radius=values.pop("radius"), R_BI=R_BI, p_BI=p_BI, legs=Legs(**values))


def contact_points(
    known: Kinematics, q: np.ndarray, dq: np.ndarray, omega: np.ndarray
) -> np.ndarray:
    """Positions s and velocities u + omega x s (N, 6 L) of the contact points relative to the IMU.

    First the positions of all legs in I [m], then the velocities, as the axes of I do not turn
    [m/s]. The contact point is the point of the foot's link at the foot's radius below its centre,
    along the base's vertical; on a rolling foot this point is at rest, not the centre.

    Args:
        known: geometry of the legs.
        q: joint angles (N, J) [rad].
        dq: joint rates (N, J) [rad/s].
        omega: angular velocity (N, 3) in I [rad/s]; with zeros the velocities are those relative to
            the base.
    """
    return _contact_points(known, *map(np.ascontiguousarray, (q, dq, omega)))


@kernel
def _contact_points(known, q, dq, omega):
    legs, radius, R_BI, p_BI = known
    first = 3 * len(radius)
    found = np.empty((len(q), 2 * first))
    most = legs.q_zero.shape[1]
    foot, J, axes = np.empty(3), np.empty((3, most)), np.empty((3, most))
    velocity, spin = np.empty(3), np.empty(2)
    for k in range(len(q)):
        for leg in range(len(radius)):
            j = 3 * leg
            leg_forward(legs, leg, q[k], foot, J, axes)
            velocity[:], spin[:] = 0.0, 0.0
            for m in range(legs.joint_count[leg]):
                rate = dq[k, legs.joints[leg, m]]
                for i in range(3):
                    velocity[i] += J[i, m] * rate
                for i in range(2):
                    spin[i] += axes[i, m] * rate
            for i in range(3):
                foot[i] -= p_BI[i]
            # The link's angular velocity times the lever arm (0, 0, -radius).
            velocity[0] -= radius[leg] * spin[1]
            velocity[1] += radius[leg] * spin[0]
            foot[2] -= radius[leg]
            for i in range(3):
                found[k, j + i] = found[k, first + j + i] = 0.0
                for m in range(3):
                    found[k, j + i] += R_BI[m, i] * foot[m]
                    found[k, first + j + i] += R_BI[m, i] * velocity[m]
            for i in range(3):
                a, b = (i + 1) % 3, (i + 2) % 3
                turned = omega[k, a] * found[k, j + b] - omega[k, b] * found[k, j + a]
                found[k, first + j + i] += turned
    return found


@kernel(nogil=True)
def add_leg_velocity(outputs, w, gain, mean, scale, speed, x):
    """Fade the corrections outputs[:, :3] where nothing moves, and add the velocities by the legs,
    weighted by a softmax over them.

    All arrays are float32 and contiguous.

    Args:
        outputs: of the head (T, 3 or 9), changed.
        w: (T, L), outputs of the gates.
        gain: (3,), factor of each axis.
        mean: (3 L,), of the legs' velocities.
        scale: (3 L,), their standard deviation.
        speed: (3,), units of the output, in STILL; zeros in a network whose correction never fades.
        x: (T, C), normalised inputs; the last 3 L are the legs' velocities.
    """
    T, legs = w.shape
    first = x.shape[1] - len(mean)
    fades = speed.any()
    by_legs = np.empty(3, np.float32)
    for t in range(T):
        share = np.exp(w[t] - w[t].max())
        share /= share.sum()
        by_legs[:] = np.float32(0.0)
        square = np.float32(0.0)
        for leg in range(legs):
            for i in range(3):
                j = 3 * leg + i
                u = mean[j] + scale[j] * x[t, first + j]
                by_legs[i] -= gain[i] * share[leg] * u
                square += (speed[i] * u) ** 2
        square /= np.float32(legs)
        moves = square / (square + np.float32(1.0)) if fades else np.float32(1.0)
        for i in range(3):
            outputs[t, i] = moves * outputs[t, i] + by_legs[i]
