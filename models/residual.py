"""What a walk's readings say beyond the model: residual channels against the log's reference.

    imu_gyro, imu_accel   reading minus what the reference motion implies for the same sample
    leg_velocity          body velocity by each standing foot's kinematics, less the reference's

Residuals are means over bins of 20 ms, short against a step and long against a sample.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from sim.kinematics import leg_forward
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
    reference; moved (N,): rows whose step has one; standing (N, 4): feet well inside a stance;
    first (M,): first row of each bin, t (M,) its mean time, s.
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
    standing = np.zeros((len(t), 4), dtype=bool)
    if log.has("contact"):
        standing = inside_stance(t, log.contact)
    return Frame(
        gyro=gyro,
        accel=accel,
        v_I=np.einsum("nji,nj->ni", R_GI, v_GI),
        up_I=R_GI[:, 2],
        ok=ok,
        moved=ok & np.concatenate([[False], ok[:-1]]) & whole,
        standing=standing & ok[:, None],
        first=first,
        t=np.add.reduceat(t, first) / count,
    )


def inside_stance(t: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Rows and feet (N, 4) that stand, farther than EDGE from either end of their stance."""
    inside = contact.copy()
    for leg in range(contact.shape[1]):
        change = np.flatnonzero(np.diff(contact[:, leg].astype(int)))
        for row in change:
            inside[np.abs(t - 0.5 * (t[row] + t[row + 1])) <= EDGE, leg] = False
    return inside


def residual(log: Log, robot: Robot, frame: Frame) -> Residual:
    """Residuals of the log's readings under the declared model `robot`.

    With v_foot = 0 at the contact point of a foot that rolls on its sphere of radius r,
    v_I = -J dq - omega x f + (omega + omega_foot) x r n, all in I.
    """
    none = np.full((len(frame.ok), 3), np.nan)
    imu_gyro, imu_accel, leg = none, none, np.full((len(frame.ok), 4, 3), np.nan)
    omega = frame.gyro
    if log.has("imu"):
        omega = log.gyro
        imu_gyro = np.where(frame.moved[:, None], omega - frame.gyro, np.nan)
        imu_accel = np.where(frame.moved[:, None], log.accel - frame.accel, np.nan)
    if log.has("q") and frame.standing.any():
        # Rows hold the mean rate of the step before; the rate at the row itself is between two.
        omega = 0.5 * (omega + np.concatenate([omega[1:], omega[-1:]]))
        leg = leg_velocity(
            robot.legs, robot.foot_radius, robot.R_BI, robot.p_BI, log.q, joint_velocity(log),
            omega, frame.up_I, frame.standing,
        )  # fmt: skip
        leg -= frame.v_I[:, None]
    return Residual(
        frame.t, _binned(imu_gyro, frame), _binned(imu_accel, frame), _binned(leg, frame)
    )


@njit(cache=True)
def leg_velocity(legs, radius, R_BI, p_BI, q, dq, omega, up, standing):
    """Velocity of the IMU in I (N, 4, 3) [m/s] by each standing foot; NaN for the others.

    legs, radius (4,), R_BI, p_BI: the robot's; q, dq (N, 12) [rad, rad/s]; omega (N, 3) [rad/s] and
    up (N, 3), the ground's unit normal, in I; standing (N, 4).
    """
    out = np.full((len(q), 4, 3), np.nan)
    foot, J, axes = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    sole, spin, step = np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(q)):
        # In B from here on, where the legs are; the result is turned back into I.
        for a in range(3):
            sole[a] = R_BI[a, 0] * up[k, 0] + R_BI[a, 1] * up[k, 1] + R_BI[a, 2] * up[k, 2]
            spin[a] = R_BI[a, 0] * omega[k, 0] + R_BI[a, 1] * omega[k, 1] + R_BI[a, 2] * omega[k, 2]
        for leg in range(4):
            if not standing[k, leg]:
                continue
            leg_forward(legs, leg, q[k, 3 * leg : 3 * leg + 3], foot, J, axes)
            rate = dq[k, 3 * leg : 3 * leg + 3]
            r = radius[leg]
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                v = 0.0
                # omega x (r n - (foot - p_BI)), then omega_foot x r n and J dq, joint by joint
                v += spin[b] * (r * sole[c] - foot[c] + p_BI[c])
                v -= spin[c] * (r * sole[b] - foot[b] + p_BI[b])
                for j in range(3):
                    roll = r * (axes[b, j] * sole[c] - axes[c, j] * sole[b])
                    v += rate[j] * (roll - J[a, j])
                step[a] = v
            for a in range(3):
                out[k, leg, a] = R_BI[0, a] * step[0] + R_BI[1, a] * step[1] + R_BI[2, a] * step[2]
    return out


def _binned(values: np.ndarray, frame: Frame) -> np.ndarray:
    """Mean of the rows (N, ...) of each bin; NaN where fewer than half of them have a value."""
    there = np.isfinite(values)
    total = np.add.reduceat(np.where(there, values, 0.0), frame.first, axis=0)
    count = np.add.reduceat(there.astype(float), frame.first, axis=0)
    size = np.diff(np.append(frame.first, len(values))).reshape(-1, *[1] * (values.ndim - 1))
    enough = (count >= 0.5 * size) & (count > 0)
    return np.where(enough, total / np.maximum(count, 1), np.nan)
