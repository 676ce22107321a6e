"""Analytic walks with a perfect IMU: the truth that the filters must recover."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from surefoot.estimator.core.state import FilterNoise, NavState, retract
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.initial import InitialStd, start_covariance
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.log import Log, Meta


@dataclass(frozen=True)
class Motion:
    """Truth at t (N,) and an IMU whose row k is the mean over (t[k-1], t[k]]."""

    t: np.ndarray
    R: np.ndarray
    v: np.ndarray
    p: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray

    def reference(self) -> Trajectory:
        zeros = np.zeros_like(self.p)
        return Trajectory(self.t, self.R, self.v, self.p, zeros, zeros)

    @property
    def v_I(self) -> np.ndarray:
        return np.einsum("nij,ni->nj", self.R, self.v)

    def start(self, **std: float) -> tuple[NavState, np.ndarray]:
        state = NavState(self.R[0], self.v[0], self.p[0])
        return state, start_covariance(state, InitialStd(**std))

    def drawn_start(self, rng, **std: float) -> tuple[NavState, np.ndarray]:
        """A start that is off by an error drawn from its covariance."""
        state, P = self.start(**std)
        mean = state.pack()
        retract(mean, -rng.multivariate_normal(np.zeros(15), P), 0)
        return NavState.unpack(mean), P

    def sensed(self, rng, noise: FilterNoise) -> tuple[np.ndarray, np.ndarray]:
        """Gyro and accelerometer with the white noise that a filter is told."""
        scale = 1.0 / np.sqrt(self.t[1] - self.t[0])
        gyro = self.gyro + rng.normal(size=self.gyro.shape) * noise.gyro * scale
        return gyro, self.accel + rng.normal(size=self.accel.shape) * noise.accel * scale

    def log(self, gyro: np.ndarray | None = None, accel: np.ndarray | None = None) -> Log:
        """A log of these readings, by default the true ones, with the motion as its reference."""
        gyro, accel = self.gyro if gyro is None else gyro, self.accel if accel is None else accel
        groups = {"gyro": gyro, "accel": accel, "ref_p": self.p, "ref_v": self.v}
        columns = {"t": self.t}
        for name, values in groups.items():
            columns |= {f"{name}_{axis}": values[:, i] for i, axis in enumerate("xyz")}
        q = quaternion_from_matrix(self.R)
        columns |= {f"ref_q_{axis}": q[:, i] for i, axis in enumerate("wxyz")}
        return Log(pd.DataFrame(columns), Meta(rate=round(1.0 / (self.t[1] - self.t[0]))))

    def part(self, n: int) -> "Motion":
        """The first n rows."""
        return Motion(**{name: values[:n] for name, values in vars(self).items()})


def attitude(t: np.ndarray) -> Rotation:
    """A trot's roll and pitch on a winding path, vectorised."""
    yaw = 0.25 * t + 0.1 * np.sin(1.3 * t)
    pitch = 0.05 * np.sin(4.0 * np.pi * t + 0.3)
    roll = 0.04 * np.sin(2.0 * np.pi * t)
    return Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))


def position(t: np.ndarray, order: int = 0) -> np.ndarray:
    """Position and its first two derivatives (order), analytic."""

    def wave(amplitude, rate, phase):
        return amplitude * rate**order * np.sin(rate * t + phase + order * np.pi / 2)

    forward = 0.5 * (t if order == 0 else np.full_like(t, 1.0 if order == 1 else 0.0))
    return np.column_stack(
        [
            forward + wave(0.01, 4 * np.pi, 0.2),
            wave(2.0, 0.3, 0.0) + wave(0.01, 2 * np.pi, 0.0),
            (0.5 if order == 0 else 0.0) + wave(0.015, 4 * np.pi, 1.0),
        ]
    )


def body_rate(t: np.ndarray) -> np.ndarray:
    h = 1e-4
    return (attitude(t - h).inv() * attitude(t + h)).as_rotvec() / (2 * h)


def specific_force(t: np.ndarray) -> np.ndarray:
    return attitude(t).inv().apply(position(t, 2) + np.array([0.0, 0.0, GRAVITY]))


def motion(duration: float = 20.0, rate: float = 500.0) -> Motion:
    t = np.arange(round(duration * rate) + 1) / rate
    nodes, weights = np.polynomial.legendre.leggauss(4)
    gyro, accel = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    for node, weight in zip(nodes, weights, strict=True):
        inside = t - 0.5 / rate + 0.5 / rate * node
        gyro += 0.5 * weight * body_rate(inside)
        accel += 0.5 * weight * specific_force(inside)
    return Motion(t, attitude(t).as_matrix(), position(t, 1), position(t), gyro, accel)


@dataclass(frozen=True)
class Feet:
    """Leg kinematics without an error: what a perfect robot's encoders say."""

    feet_I: np.ndarray
    contact: np.ndarray
    rates_I: np.ndarray

    def sensed(self, walk: Motion, rng, creep: float, std: float) -> np.ndarray:
        """Feet of the first rows that creep [m/s/sqrt(Hz)] over the ground, measured with noise."""
        n, size = len(walk.t), (len(walk.t), 4, 3)
        root = np.sqrt(walk.t[1] - walk.t[0])
        crept = np.cumsum(rng.normal(size=size) * creep * root, axis=0)
        moved = np.einsum("nji,nkj->nki", walk.R, crept)
        return self.feet_I[:n] + moved + rng.normal(size=size) * std


def feet(walk: Motion, radius: float = 0.0, slip: float = 0.0) -> Feet:
    """A trot of four spherical feet that roll; `slip` [m/s] slides FL in every third stance."""
    n = len(walk.t)
    dt = np.diff(walk.t, prepend=walk.t[0])
    feet_I, contact = np.zeros((n, 4, 3)), np.zeros((n, 4), dtype=bool)
    rates = np.zeros((n, 4, 3))
    hips = np.array(
        [[0.3, 0.15, -0.5], [0.3, -0.15, -0.5], [-0.3, 0.15, -0.5], [-0.3, -0.15, -0.5]]
    )
    omega = body_rate(walk.t)
    for leg in range(4):
        cycle = walk.t / 0.5 + (0.0 if leg in (0, 3) else 0.5)
        contact[:, leg] = cycle % 1.0 < 0.6
        rates[:, leg, 1] = 1.5 + np.sin(9.0 * walk.t + leg)
        rates[:, leg, 0] = 0.3 * np.cos(7.0 * walk.t)
        spin = np.einsum("nij,nj->ni", walk.R, omega + rates[:, leg])
        speed = radius * np.column_stack([spin[:, 1], -spin[:, 0], np.zeros(n)])
        if leg == 0 and slip:
            speed[cycle % 3.0 < 1.0, 0] += slip
        travel = np.cumsum(0.5 * (speed + np.roll(speed, 1, axis=0)) * dt[:, None], axis=0)
        d = np.zeros(3)
        for k in range(n):
            if contact[k, leg]:
                if k == 0 or not contact[k - 1, leg]:
                    d = walk.p[k] + walk.R[k] @ hips[leg] - travel[k]
                feet_I[k, leg] = walk.R[k].T @ (d + travel[k] - walk.p[k])
    return Feet(feet_I, contact, rates)
