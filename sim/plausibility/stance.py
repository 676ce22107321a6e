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
    """Feet of L legs, and motion of the body, at K times of a log.

    Attributes:
        which: indices into the view's times (K,).
        rows: rows of the log before, at and after each time (K, 3).
        span: time between the first and the last of these (K,) [s].
        contact: at all three rows (K, L), bool.
        foot: positions (K, L, 3) [m] in I.
        rate: velocities (K, L, 3) [m/s] in I.
        gyro: (K, 3) [rad/s], 0 without an IMU.
        v_I: velocity of the body (K, 3) [m/s] in I by the reference; NaN where it is not trusted.
        used: mask (K,) of the times at which the reference, if there is one, was measured.
    """

    which: np.ndarray
    rows: np.ndarray
    span: np.ndarray
    contact: np.ndarray
    foot: np.ndarray
    rate: np.ndarray
    gyro: np.ndarray
    v_I: np.ndarray
    used: np.ndarray

    @property
    def has_truth(self) -> bool:
        """Whether the body's velocity is known by a trusted reference."""
        return not np.isnan(self.v_I).any()

    @property
    def by_leg(self) -> np.ndarray:
        """Velocity (K, L, 3) [m/s] of the body in I by each leg if its foot stands."""
        return -(self.rate + np.cross(self.gyro[:, None], self.foot))

    def at(self, some: np.ndarray) -> "Stance":
        """Select some of the K times."""
        return Stance(**{name: x[some] for name, x in vars(self).items()})

    def with_feet(self, feet: Feet) -> "Stance":
        """The same times with other positions of the feet."""
        before, at, after = self.rows.T
        rate = (feet(after) - feet(before)) / self.span[:, None, None]
        return replace(self, foot=feet(at), rate=rate)

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


def stance_of(
    log: Log, feet: Feet, at: np.ndarray, gyro: np.ndarray, v_I: np.ndarray, used: np.ndarray
) -> Stance:
    """Feet and body about MOST_TIMES of the times `at` (M,) [s]; gyro (M, 3), v_I (M, 3) and used
    (M,) as of `Stance`.
    """
    which = np.unique(np.linspace(0, len(at) - 1, min(len(at), MOST_TIMES)).astype(int))
    t, window = log.t, _WINDOW * np.array([-0.5, 0.0, 0.5])
    rows = np.clip(np.searchsorted(t, at[which, None] + window), 0, len(t) - 1)
    which, rows = which[rows[:, 2] > rows[:, 0]], rows[rows[:, 2] > rows[:, 0]]
    span, contact, unknown = np.ptp(t[rows], axis=1), np.all(log.contact[rows], axis=1), t[:0]
    body = gyro[which], v_I[which], used[which]
    return Stance(which, rows, span, contact, unknown, unknown, *body).with_feet(feet)


def feet_at(log: Log, robot: Robot | None) -> Feet | None:
    """The feet of a log; None where they are unknown."""
    if log.has("foot"):
        return log.foot_I.__getitem__
    if robot is not None and log.has("q"):
        q = log.q
        return lambda rows: robot.feet_I(q[rows])
    return None
