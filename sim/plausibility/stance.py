"""Positions and velocities of the feet at some times of a log."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from surefoot.sim.log import Log
from surefoot.sim.robot.robot import Robot

Feet = Callable[[np.ndarray], np.ndarray]
"""Positions (K, L, 3) [m] of feet in I at some rows (K,) of a log."""
MOST_TIMES = 3000
"""Largest number of times at which legs are compared: a minute; longer logs are sampled less
densely.
"""
_WINDOW = 0.03
"""Time over which the velocity of a foot is computed [s]: a tenth of a stance."""


@dataclass(frozen=True)
class Stance:
    """Feet of L legs at K times of a log.

    Attributes:
        which: indices into the view's times (K,).
        rows: rows of the log before, at and after each time (3, K).
        span: time between the first and the last of these (K,) [s].
        contact: at all three rows (K, L), bool.
        foot: positions (K, L, 3) [m] in I.
        rate: velocities (K, L, 3) [m/s] in I.
    """

    which: np.ndarray
    rows: np.ndarray
    span: np.ndarray
    contact: np.ndarray
    foot: np.ndarray
    rate: np.ndarray

    def body_velocity(self, gyro: np.ndarray) -> np.ndarray:
        """Velocity (K, L, 3) [m/s] of the body in I by each leg if its foot stands, with gyro (K,
        3) [rad/s].
        """
        return -(self.rate + np.cross(gyro[:, None], self.foot))

    def at(self, some: np.ndarray) -> "Stance":
        """Select some of the K times."""
        return Stance(
            self.which[some], self.rows[:, some], self.span[some], self.contact[some],
            self.foot[some], self.rate[some],
        )  # fmt: skip

    def of_legs(self, some: slice) -> "Stance":
        """Select some of the L legs."""
        contact, foot, rate = (x[:, some] for x in (self.contact, self.foot, self.rate))
        return replace(self, contact=contact, foot=foot, rate=rate)

    def with_feet(self, feet: Feet) -> "Stance":
        """The same times with other positions of the feet."""
        rate = (feet(self.rows[2]) - feet(self.rows[0])) / self.span[:, None, None]
        return replace(self, foot=feet(self.rows[1]), rate=rate)

    def turning_fits(self, gyro: np.ndarray) -> float:
        """Correlation of the rotation of lines between standing feet with that of a gyro (K, 3)."""
        moved, by_gyro = [], []
        for i, j in combinations(range(self.foot.shape[1]), 2):
            on = self.contact[:, i] & self.contact[:, j]
            moved.append(self.rate[on, i] - self.rate[on, j])
            by_gyro.append(np.cross(self.foot[on, i] - self.foot[on, j], gyro[on]))
        a, b = np.concatenate(moved), np.concatenate(by_gyro)
        if len(a) < 50:
            return 0.0
        # Feet that slip or bounce would outweigh all others.
        size = np.sum(a**2, axis=1)
        keep = size < np.quantile(size, 0.8)
        a, b = a[keep], b[keep]
        return float(np.sum(a * b) / np.sqrt(max(np.sum(a**2) * np.sum(b**2), 1e-18)))


def stance_of(log: Log, robot: Robot | None, at: np.ndarray) -> Stance | None:
    """The feet of a log about the times `at` (M,) [s]; None where they are unknown."""
    feet = feet_at(log, robot)
    if feet is None:
        return None
    which = np.unique(np.linspace(0, len(at) - 1, min(len(at), MOST_TIMES)).astype(int))
    t, window = log.t, _WINDOW * np.array([[-0.5], [0.0], [0.5]])
    rows = np.clip(np.searchsorted(t, at[which] + window), 0, len(t) - 1)
    which, rows = which[rows[2] > rows[0]], rows[:, rows[2] > rows[0]]
    contact, unknown = np.all(log.contact[rows], axis=0), np.zeros(0)
    return Stance(which, rows, t[rows[2]] - t[rows[0]], contact, unknown, unknown).with_feet(feet)


def feet_at(log: Log, robot: Robot | None) -> Feet | None:
    """The feet of a log; None where they are unknown."""
    if log.has("foot"):
        return log.foot_I.__getitem__
    if robot is not None and log.has("q"):
        q = log.q
        return lambda rows: robot.feet_I(q[rows])
    return None
