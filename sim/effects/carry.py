"""Scale the sizes of effects measured on one robot to another robot.

Robots are assumed to be dynamically similar: under its own weight a joint yields by the same angle
and a foot by the same share of the leg's length, in the same share of a stride. A size is therefore
scaled by its dimension, in units of the robot's weight, leg length and stride period, and a length
of the foot by the foot's radius. Angles, ratios and sensor errors (biases, noise
densities) are not scaled.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.toml import Positive
from surefoot.sim.effects.base import Effect
from surefoot.sim.gait.controller import gait_for
from surefoot.sim.robot import Robot

DIMENSIONS = {
    **dict.fromkeys(("rad", "ratio", "rad/s", "m/s^2", "rad/s per m/s^2"), (0, 0, 0)),
    **dict.fromkeys(("m", "m/rad"), (0, 1, 0)),
    "s": (0, 0, 1),
    "kg": (1, 0, 0),
    "kg m^2": (1, 1, 2),
    "N": (1, 0, 0),
    "N m": (1, 1, 0),
    "m/N": (-1, 1, 0),
    "rad/(N m)": (-1, -1, 0),
    "N m s/rad": (1, 1, 1),
}
"""Unit of an effect -> powers of weight, leg length and stride period by which its size scales.

Rates and accelerations are errors of an IMU, which do not depend on the robot's size.
"""


@dataclass(frozen=True)
class BodyScale:
    """Scales of a robot by which the sizes of its effects become dimensionless."""

    weight: Positive  # N
    leg_length: Positive  # m
    foot_radius: Positive  # m, by the robot's file: a declared model may have points
    period: Positive  # s, of its stride


def scale_of(robot: Robot, period: float | None = None) -> BodyScale:
    """Scales of a robot; `period` [s] of its stride, by default the controller's."""
    return BodyScale(
        robot.mass * GRAVITY,
        robot.leg_length,
        float(Robot.load(robot.file).foot_radius.mean()),
        period or gait_for(robot, 0.0).period,
    )


def growth(dimension: tuple[int, int, int], measured: BodyScale, to: BodyScale) -> float:
    """Factor from a size on one robot to that on another.

    dimension: powers of weight, leg length and stride period by which the size scales.
    """
    weight, length, time = dimension
    factor = (to.weight / measured.weight) ** weight
    factor *= (to.leg_length / measured.leg_length) ** length
    return factor * (to.period / measured.period) ** time


def carried(effects: Sequence[Effect], measured: BodyScale, to: BodyScale) -> tuple[Effect, ...]:
    """Scale effects measured on a robot of scale `measured` to one of scale `to`.

    Sizes are clipped to each effect's bounds. Raises SurefootError for a unit without a rule.
    """
    found = []
    for one in effects:
        if one.unit not in DIMENSIONS:
            raise SurefootError(f"effect {one.name}: no rule carries '{one.unit}' to another robot")
        factor = growth(DIMENSIONS[one.unit], measured, to)
        if one.traced.scales_with == "foot_radius":
            factor = to.foot_radius / measured.foot_radius
        low, high = one.traced.bounds_on_legs or one.bounds
        found.append(replace(one, value=float(min(max(factor * one.value, low), high))))
    return tuple(found)
