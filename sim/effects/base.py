"""Base class of the effects that a real robot has and a model may lack.

An effect defines two things independently: how it is injected into a simulation (MjSpec, ground,
sensors or their streams), and how a model that includes it compensates it in a log (`compensate`).
Its influence on the residual of a log follows from `compensate` by finite differences; `chain_rule`
declares a faster way.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, TypeVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.errors import SurefootError, unknown
from surefoot.sim.effects.targets import AXES, Part, groups, parts
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.sensors.streams import Reference, Streams

Kind = TypeVar("Kind", bound=Any)

_ESTIMATED = 1.25
"""What a machine may lose of a declared size, as a multiple: the size is an estimate too."""


@dataclass(frozen=True)
class Effect:
    """An effect of one scalar size on one target: a joint, leg, axis, or a group of them.

    A subclass states its name, unit, bounds, kind of target and the residual channels that it can
    affect. It overrides one of the `alter_` methods or `edit_spec` to inject the effect and, if a
    model can compensate it, `compensate`. Raises SurefootError for an unknown target or a size out
    of bounds; which parts exist depends on the machine (`members`).
    """

    target: str
    value: float

    name: ClassVar[str]
    unit: ClassVar[str]
    bounds: ClassVar[tuple[float, float]]
    bounds_on_legs: ClassVar[tuple[float, float] | None] = None
    """Narrower bounds within which `trace` looks on a machine with legs, whose parts are small."""
    may_lessen: ClassVar[bool] = False
    """Whether sizes below zero are valid as well, down to minus the upper bound: the machine may
    have less than what was declared before. The bounds are then those of what it may have more.
    """
    unit_of_slides: ClassVar[str | None] = None
    """Unit on a joint that slides, whose angle is a distance and whose torque a force, if it
    differs.
    """
    channels: ClassVar[tuple[str, ...]]
    targets: ClassVar[Part | tuple[str, ...]]
    """Kind of part that the effect is on, or the names of its targets if they are no parts."""
    groups: ClassVar[bool] = False
    """Whether a group of parts may share one size (`targets.groups`)."""
    step: ClassVar[float]
    """Step of numerical derivatives with respect to the size; required if it is compensated."""
    starts: ClassVar[tuple[float, ...]] = ()
    """Initial sizes for a search, where the residual is far from linear in the size."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Groups of a log's columns, as for `Log.require`, that `compensate` needs beyond those of its
    channels.
    """
    chain_rule: ClassVar[Literal["readings", "legs", "mass"] | None] = None
    """The only quantities that `compensate` changes, so that derivatives of the residual may use
    the chain rule: "readings" (columns of gyro, accel, q, dq, tau), "legs" (leg geometry and foot
    radius) or "mass" (inertial parameters). None: finite differences of the residual, valid for any
    effect.
    """

    lossy: ClassVar[bool] = False
    """Whether compensation degrades the readings, by interpolation of streams shifted in time or by
    the noise of a derivative.
    """

    uses_loads: ClassVar[bool] = False
    """Whether `compensate` takes the loads of joints or feet from the log, in which all other
    effects must be compensated before.
    """

    unseen_by: ClassVar[tuple[str, ...]] = ()
    """Residual channels whose readings are not compensated. A spring's compensation replaces the
    encoders' angles by those of a rigid leg with the feet at their actual positions; the motors,
    and the links if only the feet yield, remain at the encoders' angles.
    """

    on_given_feet: ClassVar[bool] = False
    """Whether `compensate` also works for a machine that is known by its feet alone
    (`sim.robot.given_feet`), by changing the readings or `extras` only.
    """

    def __post_init__(self):
        if isinstance(self.targets, tuple) and self.target not in self.targets:
            raise SurefootError(self._unknown(self.target, self.targets))
        low, high = self.bounds
        low = -high if self.may_lessen else low
        if not low <= self.value <= high:
            raise SurefootError(
                f"effect {self.name}: value must lie between {low:g} and {high:g} {self.unit}, "
                f"is {self.value:g}"
            )

    @classmethod
    def single_targets(cls, limbs: Limbs) -> tuple[str, ...]:
        """Single targets of this effect: the parts of a machine with these limbs, or the names in
        `targets`.
        """
        return cls.targets if isinstance(cls.targets, tuple) else parts(cls.targets, limbs)

    @classmethod
    def group_targets(cls, limbs: Limbs) -> dict[str, tuple[str, ...]]:
        """Groups of parts that may share one size: name -> members, which are single targets.

        Empty if `groups` is not set, or the machine has no two parts of the kind.
        """
        if not cls.groups or isinstance(cls.targets, tuple):
            return {}
        return groups(cls.targets, limbs)

    @classmethod
    def targets_on(cls, limbs: Limbs) -> tuple[str, ...]:
        """All targets on a machine with these limbs: single ones, then groups."""
        return (*cls.single_targets(limbs), *cls.group_targets(limbs))

    @classmethod
    def members_of(cls, target: str, limbs: Limbs) -> tuple[str, ...]:
        """The single targets that a target comprises: itself, or a group's members.

        Raises SurefootError for a target that a machine with these limbs does not have.
        """
        if target in (single := cls.single_targets(limbs)):
            return (target,)
        found = cls.group_targets(limbs)
        if target not in found:
            raise SurefootError(cls._unknown(target, (*single, *found)))
        return found[target]

    def members(self, limbs: Limbs) -> tuple[str, ...]:
        """The single targets that the effect's target comprises (see `members_of`)."""
        return self.members_of(self.target, limbs)

    def left_of(self, size: float, part: str, least: float = 0.0) -> float:
        """What a part of this size has with the effect.

        Raises SurefootError where the effect takes so much that less than `least` is left.
        """
        if self.value < 0.0 and size + self.value < least:
            raise SurefootError(
                f"effect {self.name} {self.target}: {part} has only {size:.4g} {self.unit}, from "
                f"which {-self.value:g} cannot be taken"
            )
        return size + self.value

    @classmethod
    def _unknown(cls, target: str, known: tuple[str, ...]) -> str:
        return f"effect {cls.name}: {unknown('target', target, known)}"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Inject the effect into the simulated world."""

    def alter_ground(self, ground: Ground) -> Ground:
        """Inject the effect into the ground's contacts. The shape must not change, since the
        controller knows it.
        """
        return ground

    def alter_mounting(self, robot: Robot) -> Robot:
        """Change the true mounting of the IMU; the reference keeps the nominal mounting."""
        return robot

    def alter_reference(self, reference: Reference) -> Reference:
        """Inject the effect into the reference measurement."""
        return reference

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        """Inject the effect into the sensors' readings."""
        return streams

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        """The log and the robot with the effect compensated.

        A change of the readings is undone in the log; a change of the robot is added to its
        declared model. Raises NotImplementedError if no model can compensate the effect.
        """
        raise NotImplementedError(f"effect {self.name} is only for simulation")

    @classmethod
    def step_of(cls, target: str) -> float:
        """Step of numerical derivatives for this target."""
        return cls.step

    @classmethod
    def starts_on(cls, target: str, log: Log) -> tuple[float, ...]:
        """Initial sizes for a search on this log: `starts`, by default one step."""
        return cls.starts or (cls.step_of(target),)

    @classmethod
    def bounds_on(cls, limbs: Limbs | None, target: str | None = None) -> tuple[float, float]:
        """The bounds on a machine with these limbs, and for this target where the machine may have
        less than was declared; `bounds` if it is not known.
        """
        legs = bool(limbs and limbs.legs)
        low, high = cls.bounds_on_legs if legs and cls.bounds_on_legs else cls.bounds
        if cls.may_lessen and limbs and limbs.declared and target:
            sizes, members = dict(limbs.declared), cls.members_of(target, limbs)
            low -= _ESTIMATED * max(0.0, min(sizes.get((cls.name, one), 0.0) for one in members))
        return low, high

    @classmethod
    def unit_on(cls, target: str, limbs: Limbs) -> str:
        """Unit on a machine with these limbs: m and N for a joint that slides, or for several that
        all do, else `unit`.
        """
        if cls.unit_of_slides is None or not limbs.slides:
            return cls.unit
        slides = set(cls.members_of(target, limbs)) <= set(limbs.slides)
        return cls.unit_of_slides if slides else cls.unit

    @classmethod
    def interior_bounds(cls, target: str, limbs: Limbs | None = None) -> tuple[float, float]:
        """The bounds (`bounds_on`), reduced by a little more than a step at each end, for
        derivatives within them.
        """
        (low, high), step = cls.bounds_on(limbs, target), cls.step_of(target)
        return low + 1.1 * step, high - 1.1 * step

    @classmethod
    def is_lossy(cls, target: str) -> bool:
        """Whether compensation for this target degrades the readings (`lossy`)."""
        return cls.lossy

    @classmethod
    def is_compensated(cls) -> bool:
        """Whether a model can compensate the effect, which makes it a candidate of `trace`."""
        return cls.compensate is not Effect.compensate

    @classmethod
    def channels_of(cls, target: str) -> tuple[str, ...]:
        """Residual channels that the effect can change for this target."""
        return cls.channels

    @classmethod
    def equals_another(cls, target: str, robot: Robot) -> bool:
        """Whether the effect is indistinguishable on this machine from another one, which `trace`
        tries instead.
        """
        return False

    @classmethod
    def is_always_present(cls, target: str, robot: Robot) -> bool:
        """Whether every real machine has the effect and this model lacks it, so that only its size
        is unknown.
        """
        return False

    @classmethod
    def is_compensated_on(cls, log: Log) -> bool:
        """Whether a log has the columns that `compensate` needs."""
        return all(log.has(group) for group in cls.needs)

    def as_dict(self) -> dict[str, Any]:
        return {"name": self.name, "target": self.target, "value": self.value, "unit": self.unit}


class ReadingError(Effect):
    """An error of the readings of some joints, or along some axes of the IMU."""

    readings: ClassVar[tuple[str, ...]]
    """The readings that err: some of gyro, accel, q, dq and tau."""
    targets = "joint"
    chain_rule = "readings"

    def sizes(self, robot: Robot) -> np.ndarray:
        """Sizes at all joints (J,) or axes (3,), zero where the effect does not act."""
        at = AXES if self.targets == AXES else robot.limbs.joints
        return self.value * np.isin(at, self.members(robot.limbs))

    def altered(self, streams: Streams, change: Callable[[np.ndarray], np.ndarray]) -> Streams:
        """The streams after a change of the readings that err."""
        return replace(streams, **{name: change(getattr(streams, name)) for name in self.readings})

    def undone(self, log: Log, robot: Robot, change: Callable[[np.ndarray], np.ndarray]) -> Log:
        """The log after a change of the columns that err, as far as it has them."""
        at = self.members(robot.limbs)
        names = [f"{kind}_{part}" for part in at for kind in self.readings]
        return log.with_columns({n: change(log.columns[n]) for n in names if n in log.columns})


class Offset(ReadingError):
    """Readings have a constant offset."""

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        sizes = self.sizes(robot)
        return self.altered(streams, lambda x: x + sizes)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return self.undone(log, robot, lambda x: x - self.value), robot


class Scale(ReadingError):
    """Readings are 1 + size times the true values."""

    unit = "ratio"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        factors = 1.0 + self.sizes(robot)
        return self.altered(streams, lambda x: x * factors)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return self.undone(log, robot, lambda x: x / (1 + self.value)), robot


def turn_about(axis: str, angle: float) -> np.ndarray:
    """Rotation matrix (3, 3) by an angle [rad] about an axis, one of AXES."""
    return Rotation.from_rotvec(angle * np.eye(3)[AXES.index(axis)]).as_matrix()


def along(axis: str, value: float) -> np.ndarray:
    """A vector (3,) of this length along an axis, one of AXES."""
    return value * np.eye(3)[AXES.index(axis)]


def declared_on(robot: Kind, **sizes: Any) -> Kind:
    """The machine with these sizes added to those that its model declares (`extras`), by name."""
    known = {name: getattr(robot.extras, name) + size for name, size in sizes.items()}
    return replace(robot, extras=replace(robot.extras, **known))


def with_columns(log: Log, columns: Mapping[str, np.ndarray]) -> Log:
    """The log with some columns replaced."""
    return log.with_columns(columns)


def changed_columns(before: Log, after: Log) -> tuple[str, ...]:
    """Names of the columns of `after` that differ from those of `before` or are missing there."""
    old = before.columns
    return tuple(
        name
        for name, x in after.columns.items()
        if name not in old or not (old[name] is x or np.array_equal(old[name], x))
    )
