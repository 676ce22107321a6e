"""How far a body goes by its standing feet, and how far these turn over the ground."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from surefoot.sim.log import Log


@dataclass(frozen=True)
class Way:
    """Horizontal way of a body by its standing feet, of N rows in S stances.

    A stance lasts while the same feet stand.

    Attributes:
        stance: index of each row's stance (N,).
        step_I: displacement of the body in I since the row before (N, 3) [m], the mean by the feet
            that stand in both rows; zero where none does.
        shown: rows in which some foot does (N,).
        length: displacement within each stance (S,) [m].
        turned: angle by which the standing feet turn over the ground in each (S,) [rad], to either
            side; zero where a single foot stands, which does not show it.
    """

    stance: np.ndarray
    step_I: np.ndarray
    shown: np.ndarray
    length: np.ndarray
    turned: np.ndarray


def way_by_feet(log: Log) -> Way:
    """The way of a log with feet, contacts and an IMU; its mean specific force is taken for
    vertical.
    """
    t, contact, feet_I = log.t, log.contact, log.foot_I
    up = log.accel.mean(axis=0) / np.linalg.norm(log.accel.mean(axis=0))
    flat = np.eye(3) - np.outer(up, up)
    both = contact[1:] & contact[:-1]
    # A foot that stands does not move in the world: 0 = v_I + d foot_I / dt + omega x foot_I.
    omega, place = (0.5 * (x[1:] + x[:-1]) for x in (log.gyro, feet_I))
    by_foot = -np.diff(feet_I, axis=0) - np.cross(omega[:, None], place) * np.diff(t)[:, None, None]
    step_I = np.zeros((len(t), 3))
    step_I[1:] = np.sum(np.where(both[..., None], by_foot, 0.0), axis=1) @ flat
    step_I[1:] /= np.maximum(both.sum(axis=1), 1)[:, None]
    stance = np.append(0, np.cumsum(np.any(contact[1:] != contact[:-1], axis=1)))
    whole_I = np.zeros((stance[-1] + 1, 3))
    np.add.at(whole_I, stance, step_I)
    turned = np.zeros(len(whole_I))
    for k, (a, b) in enumerate(pairwise(np.searchsorted(stance, np.arange(len(turned) + 1)))):
        if b - a > 1 and contact[a].sum() > 1:
            turned[k] = _turned(t[a:b], log.gyro[a:b], feet_I[a:b, contact[a]], up)
    shown = np.append(False, both.any(axis=1))
    return Way(stance, step_I, shown, np.linalg.norm(whole_I, axis=1), turned)


def _turned(t: np.ndarray, gyro: np.ndarray, feet_I: np.ndarray, up: np.ndarray) -> float:
    """Angle [rad] by which feet (n, K, 3) turn about `up` over the ground.

    The line between feet that stick keeps its direction, so that its rotation in I and that of the
    body cancel.
    """
    arm = feet_I - feet_I.mean(axis=1, keepdims=True)
    arm -= (arm @ up)[..., None] * up
    across = np.cross(arm, np.gradient(arm, t, axis=0)) @ up
    rate = gyro @ up + across.sum(axis=1) / np.sum(arm**2, axis=(1, 2))
    return float(np.trapezoid(np.abs(rate), t))
