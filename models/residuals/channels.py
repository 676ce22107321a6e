"""The residual channels: the bundled ones, against the log's reference or its model, then those of
plug-ins.

    imu_gyro, imu_accel   reading minus the value implied by the reference motion
    leg_velocity          body velocity by each standing foot's kinematics minus the reference's
    stance_velocity       its mean over each stance
    stance_displacement   displacement of a foot over the ground while its contact is on
    foot_height           height of each standing foot in the world, where the ground is level
    joint_torque          measured torque minus inverse dynamics, of legs in swing or a fixed base
    base_wrench           wrench of the standing feet on the base minus inverse dynamics
    joint_rate            slope of a joint's measured angle minus its measured rate
    command               measured torque minus the commanded one
    contact_timing        time of a contact change minus that of the foot's stop or start

Residuals are means over bins of 20 ms.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, ClassVar

import numpy as np

from surefoot.models.residuals.binning import BIN, Bins, bin_mean
from surefoot.models.residuals.channel import Channel, Column, ResidualInputs
from surefoot.models.residuals.contact_timing import contact_timing
from surefoot.models.residuals.feet import (
    foot_heights,
    stance_displacement,
    stance_means,
    travel_regressors,
)
from surefoot.models.residuals.torques import slope, smooth_121, unbalanced_wrench
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.plugins import Registry
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.effects.base import AXES
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.robot.feet import shown_feet
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.sensors.streams import Sensors

LEVER_ARM = 0.5
"""Lever arm from a joint to the foot [m], to propagate its noise where only data sheets give it."""
STANCE_BINS = 10
"""Bins of a stance, to propagate noise over a stance where only data sheets give it."""


class ImuGyro(Channel):
    """Angular rate minus that of the reference motion."""

    name = "imu_gyro"
    unit = "rad/s"
    needs = ("imu", "reference")
    on_given_feet = True

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        return _of_axes("gyro", self.unit, limbs)

    def residual(self, inputs: ResidualInputs) -> np.ndarray:
        return inputs.bins.gyro

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        return sensors.gyro_noise / np.sqrt(BIN)


class ImuAccel(Channel):
    """Specific force minus that of the reference motion.

    A reference without velocities smooths its accelerations. By how much, only simulated walks
    tell, which a machine that is known by its feet alone does not have.
    """

    name = "imu_accel"
    unit = "m/s^2"
    needs = ("imu", "reference")
    on_given_feet = True

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        return _of_axes("accel", self.unit, limbs)

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        if inputs.robot.limbs.feet_alone and not inputs.log.has("ref_v"):
            return None
        return inputs.bins.accel

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        return sensors.accel_noise / np.sqrt(BIN)

    def missing_groups(self, log: Log, fixed: bool, by_feet: bool = False) -> tuple[str, ...]:
        missing = super().missing_groups(log, fixed, by_feet)
        return (*missing, "ref_v") if by_feet and not log.has("ref_v") else missing


class LegVelocity(Channel):
    """Velocity of the body by the kinematics of each standing foot minus that of the reference."""

    name = "leg_velocity"
    unit = "m/s"
    needs = ("q", "contact", "reference")
    on_given_feet = True
    imu_replaces_reference = True
    masked_by = ("slid", "elsewhere")

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        return _of_legs("leg", self.unit, limbs)

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        return inputs.leg_velocities

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        return sensors.velocity_noise * LEVER_ARM * np.sqrt(3 / rows_of_bin(rate))

    def nuisance_regressors(self, inputs: ResidualInputs) -> Sequence[np.ndarray]:
        """Shares of their way that feet of unknown size roll, where the log gives the feet."""
        feet = shown_feet(inputs.log, inputs.robot.feet)
        if feet is None or not feet.roll_unknown:
            return ()
        return travel_regressors(inputs.bins, feet)


class StanceVelocity(LegVelocity):
    """Mean of the leg velocity residual over each stance, which leg odometry accumulates."""

    name = "stance_velocity"

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        return _of_legs("stance", self.unit, limbs)

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        v = inputs.leg_velocities
        return None if v is None else _means_of_stances(inputs.bins, v)

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        return sensors.velocity_noise * LEVER_ARM * np.sqrt(3 / rows_of_bin(rate) / STANCE_BINS)

    def nuisance_regressors(self, inputs: ResidualInputs) -> Sequence[np.ndarray]:
        """The same shares as of the leg velocity."""
        return [_means_of_stances(inputs.bins, way) for way in super().nuisance_regressors(inputs)]


def _means_of_stances(bins: Bins, v: np.ndarray) -> np.ndarray:
    """Means over stances of leg velocities (M, 3 L), in the middle bin of each; else NaN."""
    by_leg = v.reshape(len(v), -1, 3)
    return stance_means(bins.t, by_leg, np.isfinite(by_leg[..., 0])).reshape(v.shape)


class StanceDisplacement(Channel):
    """Displacement of each foot over the ground, forward and to the left, while its contact is on.

    This is the error of leg odometry per step, including touchdown and lift-off. It is used for
    evaluation only: in a fit, effects would compensate for one another, such as a foot radius for
    contacts that end late.
    """

    name = "stance_displacement"
    unit = "m"
    needs = ("q", "contact", "reference")
    masked_by = ("slid", "elsewhere")
    of_events = True
    evaluation_only = True

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        return _of_legs("moved", self.unit, limbs, AXES[:2])

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        if inputs.feet is None:
            return None
        late = inputs.robot.extras.liftoff_late
        return stance_displacement(inputs.log, inputs.feet, inputs.motion, late)

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        return sensors.velocity_noise * LEVER_ARM * np.sqrt(3 * STANCE_BINS * BIN / rate)


class FootHeight(Channel):
    """Height of each standing foot, up to a ground plane and a constant for each leg."""

    name = "foot_height"
    unit = "m"
    needs = ("q", "contact", "reference")
    on_given_feet = True
    on_level_ground = True
    masked_by = ("slid", "elsewhere")
    least_noise = 2e-4
    """Simulated ground is level to 0.01 mm, finer than any reference measures [m]."""

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        legs = enumerate(limbs.legs)
        return tuple(Column(f"height_{leg}", self.unit, leg, "", i) for i, leg in legs)

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        if inputs.feet is None or not inputs.motion.level:
            return None
        return foot_heights(inputs.bins, inputs.feet)

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        return float(np.hypot(sensors.encoder_step * LEVER_ARM, evenness))

    def nuisance_regressors(self, inputs: ResidualInputs) -> Sequence[np.ndarray]:
        """The plane that a log's feet stand on."""
        if not inputs.motion.level:
            return ()
        x, y = inputs.bins.p_GI[:, :2].T
        return np.ones((len(x), 1)), x[:, None], y[:, None]


class JointTorque(Channel):
    """Measured torque minus inverse dynamics, of legs in swing or of a fixed base."""

    name = "joint_torque"
    unit = "N m"
    needs = ("q", "tau", "contact")
    imu_replaces_reference = True
    on_fixed_base = True

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        return _per_joint("torque", self.unit, limbs)

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        s, needed = inputs.steps, inputs.inverse_dynamics
        if needed is None:
            return None
        return np.where(s.swings, smooth_121(s.bins.tau - needed.torque), np.nan)

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        return sensors.torque_noise / np.sqrt(rows_of_bin(rate))


class BaseWrench(Channel):
    """Force and moment of the standing feet on the base minus inverse dynamics."""

    name = "base_wrench"
    unit = "N and N m"
    needs = ("q", "tau", "contact", "reference")
    masked_by = ("elsewhere",)

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        if not limbs.point_feet:  # a flat foot gives moments too
            return ()
        return (*_of_axes("force", "N", limbs), *_of_axes("moment", "N m", limbs))

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        robot, s, needed = inputs.robot.legged, inputs.steps, inputs.inverse_dynamics
        if robot is None or needed is None:
            return None
        return np.where(s.steady[:, None], smooth_121(unbalanced_wrench(s, needed, robot)), np.nan)

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        return sensors.torque_noise / np.sqrt(rows_of_bin(rate)) / LEVER_ARM * np.sqrt(12)


class JointRate(Channel):
    """Slope of a joint's measured angle minus its measured rate."""

    name = "joint_rate"
    unit = "rad/s"
    needs = ("q", "dq")
    on_fixed_base = True

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        return _per_joint("rate", self.unit, limbs)

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        if not (inputs.log.has("q") and inputs.log.has("dq")):
            return None
        rates = slope(inputs.bins.lag)
        rates[[0, -1]] = np.nan
        return rates

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        root = np.sqrt(rows_of_bin(rate))
        return sensors.velocity_noise / root + sensors.encoder_step / BIN / root


class ContactTiming(Channel):
    """Time of a contact change minus the time at which the foot stopped or started to move.

    The time of an event does not change smoothly with a reading; the chain rule treats it as
    constant.
    """

    name = "contact_timing"
    unit = "s"
    needs = ("q", "contact", "reference")
    on_given_feet = True
    least_noise = 1e-3
    """A contact changes at a row, so its time is known to half a sample [s]."""
    of_events = True
    level_spread: ClassVar[Mapping[str, float]] = {"touchdown": 0.0015, "liftoff": 0.006}
    """On models of seven robots, contacts begin within 1 ms of one another, 3 ms earlier where a
    landing foot slides (friction 0.3), and end within 12 ms (`contact_timing.USUAL_DELAY`); these
    count as two standard deviations [s].
    """

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        return tuple(
            Column(f"{change}_{leg}", self.unit, f"{change}_{leg}", change, i)
            for change in ("touchdown", "liftoff")
            for i, leg in enumerate(limbs.legs)
        )

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        if inputs.feet is None:
            return None
        return contact_timing(inputs.log, inputs.feet, inputs.motion, inputs.robot.extras)

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        return 1.0 / rate


class CommandedTorque(Channel):
    """Measured torque minus the commanded one, or that of the motor law."""

    name = "command"
    unit = "N m"
    needs = ("q", "tau", "tau_ff")
    on_fixed_base = True

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        return _per_joint("command", self.unit, limbs)

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        log, late = inputs.log, inputs.robot.extras.command_late
        law = ("q_des", "dq_des", "q", "dq") if log.meta.motor_law else ()

        def made() -> np.ndarray | None:
            asked = commanded_torque(log)
            if asked is None or not log.has("tau"):
                return None
            if late:
                asked = interpolate_rows(log.t - late, log.t, asked)
            return bin_mean(inputs.motion)(log.tau - asked)

        uses = ("tau", "tau_ff", *law)
        return log.once("torque less the command", uses, made, late, inputs.motion.first)

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        return sensors.torque_noise / np.sqrt(rows_of_bin(rate))

    def is_available(self, log: Log, fixed: bool, level: bool, by_feet: bool = False) -> bool:
        return log.has("tau") and commanded_torque(log) is not None


def commanded_torque(log: Log) -> np.ndarray | None:
    """Commanded torques kp (q_des - q) + kd (dq_des - dq) + tau_ff (N, J) [N m].

    Uses the terms that the log has; None where it has none, or where its torques were derived from
    them.
    """
    if "tau" in log.meta.derived:
        return None
    total = log.tau_ff if log.has("tau_ff") else None
    if log.meta.motor_law and log.has("q_des"):
        kp, kd = (np.asarray(log.meta.motor_law[gain], dtype=float) for gain in ("kp", "kd"))
        wanted = log.dq_des if log.has("dq_des") else 0.0
        law = kp * (log.q_des - log.q) + kd * (wanted - joint_velocity(log))
        total = law if total is None else law + total
    return total


def _of_axes(what: str, unit: str, limbs: Limbs) -> tuple[Column, ...]:
    """A column for each axis of a vector; none for a machine without legs."""
    return tuple(Column(f"{what}_{a}", unit, what, f"{what}_{a}") for a in AXES if limbs.legs)


def _of_legs(what: str, unit: str, limbs: Limbs, axes: Sequence[str] = AXES) -> tuple[Column, ...]:
    """A column for each axis of each foot, with the same noise for all feet."""
    return tuple(
        Column(f"{what}_{leg}_{axis}", unit, leg, axis, i)
        for i, leg in enumerate(limbs.legs)
        for axis in axes
    )


_OF_SLIDES = {"N m": "N", "rad/s": "m/s"}
"""Unit of a hinge -> that of a joint that slides."""


def _per_joint(what: str, unit: str, limbs: Limbs) -> tuple[Column, ...]:
    """A column for each joint, with the same noise on all legs."""
    units = [_OF_SLIDES.get(unit, unit) if name in limbs.slides else unit for name in limbs.joints]
    return tuple(
        Column(f"{what}_{name}", of, name, limbs.kind_of[i])
        for i, (name, of) in enumerate(zip(limbs.joints, units, strict=True))
    )


def rows_of_bin(rate: float) -> float:
    """Number of rows in a bin."""
    return max(1.0, BIN * rate)


CHANNEL_GROUP = "surefoot.channels"
"""Entry point group for channels of other packages."""
BUNDLED_CHANNELS: tuple[type[Channel], ...] = (
    *(ImuGyro, ImuAccel, LegVelocity, StanceVelocity, StanceDisplacement, FootHeight),
    *(JointTorque, BaseWrench, JointRate, ContactTiming, CommandedTorque),
)


def _check(kind: Any) -> None:
    if not (isinstance(kind, type) and issubclass(kind, Channel)):
        raise SurefootError("must be a subclass of Channel")


CHANNELS = Registry(
    CHANNEL_GROUP, {kind.name: kind for kind in BUNDLED_CHANNELS}, ("name", "unit", "needs"), _check
)
"""Name -> class; a plug-in's is imported and checked when it is looked up."""


@cache
def channels() -> dict[str, Channel]:
    """Name -> channel, of those that can be used (see `Registry.usable` for the others)."""
    return {name: kind() for name, kind in CHANNELS.usable()[0].items()}
