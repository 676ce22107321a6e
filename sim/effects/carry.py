"""Sizes of effects that were measured on one robot, carried to another: the rule, set beforehand.

What a leg's elasticity does is a share of the leg, whatever the robot weighs: a joint gives by the
same angle under the robot's own weight at its own leg's length, a foot by the same share of the
leg, and both take the same share of a stride. So every size is scaled by its dimension, in units of
the robot's weight, its leg length and its stride period; what feet roll on, by the foot's radius.
Angles and ratios, and what belongs to a sensor (biases, densities), stay as they are.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.effects.base import Effect
from surefoot.sim.effects.catalogue import effect, known_effects
from surefoot.sim.gait.controller import gait_for
from surefoot.sim.robot import Robot

DIMENSIONS = {
    "rad": (0, 0, 0),
    "ratio": (0, 0, 0),
    "m": (0, 1, 0),
    "s": (0, 0, 1),
    "kg": (1, 0, 0),
    "kg m^2": (1, 1, 2),
    "N": (1, 0, 0),
    "N m": (1, 1, 0),
    "m/N": (-1, 1, 0),
    "rad/(N m)": (-1, -1, 0),
    "N m s/rad": (1, 1, 1),
    "rad/s": (0, 0, 0),
    "m/s^2": (0, 0, 0),
}
"""Unit of an effect -> powers of weight, leg length and stride period that its size grows by. Rates
and accelerations are those of an IMU's errors, which are no matter of the robot's size."""
ON_FEET = ("foot_rolling",)
"""Effects whose lengths are the foot's and not the leg's."""


@dataclass(frozen=True)
class BodyScale:
    """What the sizes of a robot's effects are measured by."""

    weight: float  # N
    leg_length: float  # m
    foot_radius: float  # m, by the robot's file: a declared model may have points
    period: float  # s, of its stride


def scale_of(robot: Robot, period: float | None = None) -> BodyScale:
    """The scale of a robot; `period` [s] of its stride, the controller's own where left out."""
    return BodyScale(
        robot.mass * GRAVITY,
        robot.leg_length,
        float(Robot.load(robot.file).foot_radius.mean()),
        period or gait_for(robot, 0.0).period,
    )


def growth(dimension: tuple[int, int, int], measured: BodyScale, to: BodyScale) -> float:
    """Factor by which a size grows from one robot to another, of these powers of weight, leg length
    and stride period."""
    weight, length, time = dimension
    factor = (to.weight / measured.weight) ** weight
    factor *= (to.leg_length / measured.leg_length) ** length
    return factor * (to.period / measured.period) ** time


def carried(effects: Sequence[Effect], measured: BodyScale, to: BodyScale) -> tuple[Effect, ...]:
    """The effects of a robot of scale `measured` as one of scale `to` would have them, cut at the
    bounds of each. Raises SurefootError for a unit that the rule does not know."""
    found = []
    for one in effects:
        if one.unit not in DIMENSIONS:
            raise SurefootError(f"effect {one.name}: no rule carries '{one.unit}' to another robot")
        factor = growth(DIMENSIONS[one.unit], measured, to)
        if one.name in ON_FEET:
            factor = to.foot_radius / measured.foot_radius
        low, high = known_effects()[one.name].bounds
        found.append(effect(one.name, one.target, min(max(factor * one.value, low), high)))
    return tuple(found)
