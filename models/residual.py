"""What a walk's readings say beyond the model: residual channels against the log's reference.

    imu_gyro, imu_accel   reading minus what the reference motion implies for the same sample
    leg_velocity          body velocity from the kinematics of each standing foot, minus the reference's

Residuals are means over bins of 20 ms, short against a step and long against a sample.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim.kinematics import feet
from sim.log import Log, joint_velocity, reference_velocity
from sim.robot import Robot
from sim.sensors import GRAVITY_G, mean_rotation

BIN = 0.02
"""s, the length of a bin."""
EDGE = 0.03
"""s at either end of a stance that are left out: there the foot lands, rocks or already lifts."""
CHANNELS = {"imu_gyro": "rad/s", "imu_accel": "m/s^2", "leg_velocity": "m/s"}


@dataclass(frozen=True)
class Residual:
    """Residuals of M bins, NaN where a bin has none: t (M,) s; gyro and accel (M, 3) in I;
    leg (M, 4, 3) m/s in I, a standing foot each."""

    t: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    leg: np.ndarray

    @property
    def table(self) -> np.ndarray:
        """(M, 18): gyro, accel, then x, y, z of each leg."""
        return np.column_stack([self.gyro, self.accel, self.leg.reshape(len(self.t), 12)])


COLUMNS = {"imu_gyro": slice(0, 3), "imu_accel": slice(3, 6), "leg_velocity": slice(6, 18)}
"""Where the channels are in `Residual.table`."""


@dataclass(frozen=True)
class Frame:
    """What the residual of a log is measured against; it stays as it is while effects are tried.

    gyro, accel (N, 3): what the reference implies, by the exact inverse of `sim.sensors`; v_I and
    up_I (N, 3): the reference's velocity and the ground's normal in I; ok (N,): rows that have a
    reference; moved (N,): rows whose step has one; standing (N, 4); bin (N,) and t (M,): bins.
    """

    gyro: np.ndarray
    accel: np.ndarray
    v_I: np.ndarray
    up_I: np.ndarray
    ok: np.ndarray
    moved: np.ndarray
    standing: np.ndarray
    first: np.ndarray
    t: np.ndarray


def measured_against(log: Log) -> Frame:
    """The reference, stances and bins of a log. Raises LogError where it has no reference."""
    log.require("reference")
    t, R_GI, v_GI, ok = log.t, log.ref_R_GI, reference_velocity(log), log.ref_ok
    dt = np.diff(t)
    turn = Rotation.from_matrix(np.swapaxes(R_GI[:-1], 1, 2) @ R_GI[1:]).as_rotvec()
    felt = np.einsum("nji,nj->ni", R_GI[:-1], np.diff(v_GI, axis=0) / dt[:, None] - GRAVITY_G)
    gyro, accel = np.zeros_like(v_GI), np.zeros_like(v_GI)
    gyro[1:] = turn / dt[:, None]
    accel[1:] = np.linalg.solve(mean_rotation(turn), felt[:, :, None])[:, :, 0]
    whole = np.concatenate([[False], dt < 1.5 * np.median(dt)])
    number = np.floor((t - t[0]) / BIN + 1e-6).astype(int)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    count = np.diff(np.append(first, len(t)))
    return Frame(
        gyro=gyro,
        accel=accel,
        v_I=np.einsum("nji,nj->ni", R_GI, v_GI),
        up_I=R_GI[:, 2],
        ok=ok,
        moved=ok & np.concatenate([[False], ok[:-1]]) & whole,
        standing=inside_stance(t, log.contact) if log.has("contact") else np.zeros((len(t), 4), bool),
        first=first,
        t=np.add.reduceat(t, first) / count,
    )


def inside_stance(t: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Rows and feet (N, 4) that stand, farther than EDGE from either end of their stance."""
    inside = contact.copy()
    for leg in range(contact.shape[1]):
        change = np.flatnonzero(np.diff(contact[:, leg].astype(int)))
        for row in change:
            inside[np.abs(t - t[row]) <= EDGE, leg] = False
    return inside


def residual(log: Log, robot: Robot, frame: Frame) -> Residual:
    """Residuals of the log's readings under the declared model `robot`.

    With v_foot = 0 at the contact point of a foot that rolls on its sphere of radius r,
    v_I = -J dq - omega x f + (omega + omega_foot) x r n, all in I.
    """
    rows = len(frame.ok)
    none = np.full((rows, 3), np.nan)
    gyro = log.gyro if log.has("imu") else None
    imu_gyro = np.where(frame.moved[:, None], gyro - frame.gyro, np.nan) if gyro is not None else none
    imu_accel = (
        np.where(frame.moved[:, None], log.accel - frame.accel, np.nan) if log.has("imu") else none
    )
    leg = np.full((rows, 4, 3), np.nan)
    if log.has("q"):
        # Rows hold the mean rate of the step before; the rate at the row itself is between two.
        omega = frame.gyro if gyro is None else gyro
        omega = 0.5 * (omega + np.concatenate([omega[1:], omega[-1:]]))
        at = np.flatnonzero(frame.standing.any(axis=1) & frame.ok)
        leg[at] = leg_velocity(robot, log.q[at], joint_velocity(log)[at], omega[at], frame.up_I[at])
        leg[at] -= frame.v_I[at, None]
        leg[~(frame.standing & frame.ok[:, None])] = np.nan
    return Residual(
        frame.t, _binned(imu_gyro, frame), _binned(imu_accel, frame), _binned(leg, frame)
    )


def leg_velocity(
    robot: Robot, q: np.ndarray, dq: np.ndarray, omega_I: np.ndarray, up_I: np.ndarray
) -> np.ndarray:
    """Velocity of the IMU in I (N, 4, 3) [m/s], were each foot the one that stands.

    q, dq (N, 12) [rad, rad/s]; omega_I (N, 3) [rad/s]; up_I (N, 3) the ground's unit normal in I.
    """
    foot, jacobian, axes = feet(robot.legs, np.ascontiguousarray(q), robot.R_BI, robot.p_BI)
    rates = dq.reshape(-1, 4, 3)
    arm = robot.foot_radius[:, None] * up_I[:, None]
    spin = np.einsum("nlij,nlj->nli", axes, rates)
    return (
        np.cross(omega_I[:, None], arm - foot)
        + np.cross(spin, arm)
        - np.einsum("nlij,nlj->nli", jacobian, rates)
    )


def _binned(values: np.ndarray, frame: Frame) -> np.ndarray:
    """Mean of the rows (N, ...) of each bin; NaN where fewer than half of them have a value."""
    there = np.isfinite(values)
    total = np.add.reduceat(np.where(there, values, 0.0), frame.first, axis=0)
    count = np.add.reduceat(there.astype(float), frame.first, axis=0)
    size = np.diff(np.append(frame.first, len(values))).reshape(-1, *[1] * (values.ndim - 1))
    enough = (count >= 0.5 * size) & (count > 0)
    return np.where(enough, total / np.maximum(count, 1), np.nan)
