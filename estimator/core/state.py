"""The navigation state, its packed form in the kernels, and the noise of the IMU.

The kernels store a state as one array `mean` (7+E, 3) with the rows

    0..2 R_GI | 3 v_GI | 4 p_GI | 5 b_a | 6 b_g | 7.. extra vectors

and its covariance (15+3E, 15+3E) in the right-invariant error order of the paper, (rotation,
velocity, position, b_a, b_g, extras): error 3k..3k+2 of k >= 1 belongs to row 2+k. Extras are
contact points (columns of the group, like v and p) or plain vectors (like biases).
"""

from dataclasses import dataclass, field

import numpy as np

from surefoot.estimator.core.checks import amounts, numbers
from surefoot.estimator.core.lie import entire
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import kernel

V, P, B_A, B_G, EXTRA = 3, 4, 5, 6, 7
"""Rows of the packed mean."""


@dataclass(frozen=True)
class NavState:
    """Navigation state X = (R_GI, v_GI, p_GI) with IMU biases (paper, Sec. II).

    R_GI (3, 3) maps I to G; v_GI (3,) [m/s] and p_GI (3,) [m] are expressed in G; b_a (3,) [m/s^2]
    and b_g (3,) [rad/s] in I.
    """

    R_GI: np.ndarray = field(default_factory=lambda: np.eye(3))
    v_GI: np.ndarray = field(default_factory=lambda: np.zeros(3))
    p_GI: np.ndarray = field(default_factory=lambda: np.zeros(3))
    b_a: np.ndarray = field(default_factory=lambda: np.zeros(3))
    b_g: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self):
        R = numbers("R_GI", self.R_GI, (3, 3))
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0:
            raise SurefootError("state: R_GI is not a rotation matrix")
        object.__setattr__(self, "R_GI", R)
        for name in ("v_GI", "p_GI", "b_a", "b_g"):
            object.__setattr__(self, name, numbers(name, getattr(self, name), (3,)))

    @property
    def v_I(self) -> np.ndarray:
        """Velocity (3,) [m/s] of the IMU expressed in I."""
        return self.R_GI.T @ self.v_GI

    def pack(self, extras: int = 0) -> np.ndarray:
        """The packed mean (7+extras, 3), extras at zero."""
        mean = np.zeros((EXTRA + extras, 3))
        mean[:3] = self.R_GI
        mean[V], mean[P], mean[B_A], mean[B_G] = self.v_GI, self.p_GI, self.b_a, self.b_g
        return mean

    @staticmethod
    def unpack(mean: np.ndarray) -> "NavState":
        """The navigation state in the packed mean (7+E, 3); copies."""
        mean = mean.copy()
        return NavState(mean[:3], mean[V], mean[P], mean[B_A], mean[B_G])


@dataclass(frozen=True)
class FilterNoise:
    """Continuous-time noise densities of the IMU, one number or three (one for each axis of I).

    The white-noise defaults are twice the data-sheet figures of the Bosch BMI088 (0.014
    deg/s/sqrt(Hz) and 175 ug/sqrt(Hz)), a MEMS IMU common on quadrupeds, since impacts of the feet
    and misalignment add to the noise on a bench. The walks let a bias change by about 1e-3 rad/s
    and 1e-2 m/s^2 in 100 s.

    Attributes:
        gyro: white noise [rad/s/sqrt(Hz)].
        accel: white noise [m/s^2/sqrt(Hz)].
        gyro_walk: random walk of the bias [rad/s^2/sqrt(Hz)].
        accel_walk: random walk of the bias [m/s^3/sqrt(Hz)].
    """

    gyro: float | np.ndarray = 5e-4
    accel: float | np.ndarray = 3.5e-3
    gyro_walk: float | np.ndarray = 1e-4
    accel_walk: float | np.ndarray = 1e-3

    def packed(self) -> np.ndarray:
        """Squared densities (4, 3) with the rows accel, gyro, accel_walk, gyro_walk."""
        names = ("accel", "gyro", "accel_walk", "gyro_walk")
        return np.array([amounts(f"noise: {name}", getattr(self, name), 3) ** 2 for name in names])


@kernel
def retract(mean, delta, contacts: int):
    """X = exp(-xi^) X_bar, b = b_bar - delta b (eq. composition_operator), in place.

    mean (7+E, 3); delta (15+3E,); the first `contacts` extras are columns of the group.
    """
    x, y, z = -delta[0], -delta[1], -delta[2]
    _, e1, e2, e3, _, _, _ = entire(x * x + y * y + z * z)
    for c in range(3):
        _rotate(mean[0, c], mean[1, c], mean[2, c], x, y, z, e1, e2, mean[:3, c])
    for row in range(V, mean.shape[0]):
        at = 3 * (row - 2)
        if B_A <= row < EXTRA or row >= EXTRA + contacts:  # a plain vector
            for c in range(3):
                mean[row, c] -= delta[at + c]
            continue
        _rotate(mean[row, 0], mean[row, 1], mean[row, 2], x, y, z, e1, e2, mean[row])
        dx, dy, dz = -delta[at], -delta[at + 1], -delta[at + 2]
        ox, oy, oz = mean[row, 0], mean[row, 1], mean[row, 2]
        _rotate(dx, dy, dz, x, y, z, e2, e3, mean[row])
        mean[row, 0] += ox
        mean[row, 1] += oy
        mean[row, 2] += oz


@kernel
def _rotate(a: float, b: float, c: float, x, y, z, linear, square, out):
    """out = (I + linear [phi]x + square [phi]x^2) (a, b, c) for phi = (x, y, z)."""
    ux, uy, uz = y * c - z * b, z * a - x * c, x * b - y * a
    out[0] = a + linear * ux + square * (y * uz - z * uy)
    out[1] = b + linear * uy + square * (z * ux - x * uz)
    out[2] = c + linear * uz + square * (x * uy - y * ux)
