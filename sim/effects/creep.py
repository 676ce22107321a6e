"""Effects of standing feet that move over the ground, on a machine that is known by its feet.

The body then goes less far than its legs, or further if round feet roll. A foot that slides in one
direction has less grip in all others, since dry friction opposes the whole velocity: a body that
turns its standing feet over the ground loses way in proportion to the angle.

Their sizes follow from displacements (`models.attribution.way_lost`).
"""

from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from surefoot.sim.effects.base import Effect, Prior, Traced
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.sensors.stances import stances


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


STANCES = 10.0
"""Stances, as a standard deviation, over which the way lost by turning is averaged: some strides,
through which a robot walks alike.
"""


_way = partial(
    Traced,
    channels=("leg_velocity",),
    step=1e-3,
    needs=("imu", "foot", "contact"),
    motion="walk with more and with less turning of the standing feet",
    on_given_feet=True,
    by_search=False,
)


class FootCreep(Effect):
    """The body goes less far than its standing feet say, by this share of the way; further, if the
    size is negative, as on round feet that are taken for points.
    """

    unit = "ratio"
    bounds = (-0.5, 0.5)
    targets = ("all",)
    traced = _way(
        prior=Prior(0.1, "feet with a radius of 2 to 4 cm on legs of 30 to 50 cm: 4 to 13 %")
    )

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        way = way_by_feet(log)
        share = self.share_lost(self.value, way.length, way.turned)
        return without_way(log, way, share), robot

    @classmethod
    def share_lost(cls, size: float, length: np.ndarray, turned: np.ndarray) -> np.ndarray:
        """Share (S,), at most 1, of the way that the body loses in each stance by an effect of this
        size; length and turned as of `Way`.
        """
        return np.full(len(length), size)

    @classmethod
    def single_targets(cls, limbs: Limbs) -> tuple[str, ...]:
        return ("all",) if limbs.feet_alone else ()


class FootScrub(FootCreep):
    """The body goes less far than its standing feet say, by this way for each radian that they turn
    over the ground, which gyro and feet show.
    """

    unit = "m/rad"
    bounds = (0.0, 1.0)
    traced = _way(prior=Prior(1.0, "no figure found: as far as a foot is from the body's middle"))

    @classmethod
    def share_lost(cls, size: float, length: np.ndarray, turned: np.ndarray) -> np.ndarray:
        # The angle of a single stance is noisy; without way, as of a robot at rest, none is lost.
        lost = gaussian_filter1d(np.minimum(size * turned, length), STANCES)
        return np.minimum(lost / np.maximum(gaussian_filter1d(length, STANCES), 1e-9), 1.0)


def without_way(log: Log, way: Way, share: np.ndarray) -> Log:
    """The log with its standing feet moved so that the body goes less far, by a share (S,) of the
    way in each stance.

    A foot lands where the log says, and returns to where the log says while it swings.
    """
    columns, lost_I = {}, share[way.stance, None] * way.step_I
    rows = np.arange(len(log.t))
    for i, leg in enumerate(log.legs):
        stands = log.contact[:, i]
        held = stands & np.append(False, stands[:-1])
        moved = np.cumsum(np.where(held[:, None], lost_I, 0.0), axis=0)
        lands, ends = stances(stands)
        if not len(lands):
            continue
        knots, before = np.stack([lands, ends - 1], axis=1).ravel(), np.repeat(moved[lands], 2, 0)
        for axis, name in enumerate("xyz"):
            back = np.interp(rows, knots, before[:, axis])
            columns[f"foot_{leg}_{name}"] = log.foot_I[:, i, axis] + moved[:, axis] - back
    return log.with_columns(columns)


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
