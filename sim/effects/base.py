"""Base class of the effects that a real robot has and a model may lack.

An effect defines two things independently: how it is injected into a simulation (MjSpec, ground,
sensors or their streams), and how a model that includes it compensates it in a log (`compensate`).
A third, `traced`, says how `trace` looks for it. Its influence on the residual of a log follows
from `compensate` by finite differences; `Traced.chain_rule` declares a faster way.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.errors import SurefootError, unknown
from surefoot.sim.effects.targets import AXES, Part, groups, parts
from surefoot.sim.effects.traced import Prior, Traced
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.physics.leg_loads import knows_loads
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine
from surefoot.sim.sensors.streams import Reference, Streams

Kind = TypeVar("Kind", bound=Any)

_ESTIMATED = 1.25
"""What a machine may lose of a declared size, as a multiple: the size is an estimate too."""
ON_SLIDES = {
    "rad": "m",
    "N m": "N",
    "rad/(N m)": "m/N",
    "N m s/rad": "N s/m",
    "kg m^2": "kg",
}
"""Unit of an effect on a joint -> on one that slides, whose angle is a distance and whose torque a
force.
"""


@dataclass(frozen=True)
class Effect:
    """An effect of one scalar size on one target: a joint, leg, axis, or a group of them.

    A subclass states its name, unit, bounds, kind of target and how `trace` looks for it. It
    overrides one of the `alter_` methods or `edit_spec` to inject the effect and, if a model can
    compensate it, `compensate`. Raises SurefootError for an unknown target or a size out of bounds;
    which parts exist depends on the machine (`members`).
    """

    target: str
    value: float

    name: ClassVar[str]
    unit: ClassVar[str]
    bounds: ClassVar[tuple[float, float]]
    may_lessen: ClassVar[bool] = False
    """Whether sizes below zero are valid as well, down to minus the upper bound: the machine may
    have less than what was declared before. The bounds are then those of what it may have more.
    """
    targets: ClassVar[Part | tuple[str, ...]]
    """Kind of part that the effect is on, or the names of its targets if they are no parts."""
    groups: ClassVar[bool] = False
    """Whether a group of parts may share one size (`targets.groups`)."""
    traced: ClassVar[Traced] = Traced()
    """How `trace` looks for the effect."""

    def __post_init__(self):
        if isinstance(self.targets, tuple) and self.target not in self.targets:
            raise SurefootError(self._unknown(self.target, self.targets))
        low, high = self.bounds_on(None, self.target)
        low = -high if self.may_lessen else low
        if not low <= self.value <= high:
            raise SurefootError(
                f"effect {self.name} {self.target}: value must lie between {low:g} and {high:g} "
                f"{self.unit}, is {self.value:g}"
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
        if not (single or found):
            raise SurefootError(f"effect {cls.name}: no part of this machine can have it")
        if target not in found:
            raise SurefootError(cls._unknown(target, (*single, *found)))
        return found[target]

    def members(self, limbs: Limbs) -> tuple[str, ...]:
        """The single targets that the effect's target comprises (see `members_of`)."""
        return self.members_of(self.target, limbs)

    @classmethod
    def _unknown(cls, target: str, known: tuple[str, ...]) -> str:
        return f"effect {cls.name}: {unknown('target', target, known)}"

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
    def is_compensated(cls) -> bool:
        """Whether a model can compensate the effect, which makes it a candidate of `trace`."""
        return cls.compensate is not Effect.compensate

    @classmethod
    def is_compensated_on(cls, log: Log) -> bool:
        """Whether a log has the columns that `compensate` needs, and those that show loads."""
        loaded = not cls.traced.uses_loads or knows_loads(log)
        return loaded and all(log.has(group) for group in cls.traced.needs)

    @classmethod
    def traced_at(cls, target: str) -> Traced:
        """How `trace` looks for the effect on this target, if that differs between targets."""
        return cls.traced

    @classmethod
    def starts_on(cls, target: str, log: Log) -> tuple[float, ...]:
        """Initial sizes for a search on this log."""
        return cls.traced.starts or (cls.traced_at(target).step,)

    @classmethod
    def shift_in(cls, span: float) -> float:
        """Time by which compensation shifts noisy readings, on average over a log of this length
        [s], per unit of the size.
        """
        return 0.0

    @classmethod
    def size_prior(cls) -> Prior:
        """Prior of the size; as wide as the bounds where none is declared."""
        wide = float(np.max(np.abs(cls.bounds)))
        return cls.traced.prior or Prior(wide, "no figure found: as wide as the bounds")

    @classmethod
    def plausible_size(cls, target: str, limbs: Limbs) -> float:
        """Bound on the magnitude for 19 of 20 machines with these limbs."""
        return cls.size_prior().within

    @classmethod
    def most_taken(cls, target: str, machine: Machine) -> float:
        """How much a machine has of what a size below zero takes, by its model."""
        return np.inf

    @classmethod
    def bounds_on(cls, limbs: Limbs | None, target: str | None = None) -> tuple[float, float]:
        """The bounds on a machine with these limbs, and for this target where the machine may have
        less than was declared; `bounds` if it is not known.
        """
        on_legs = cls.traced.bounds_on_legs if limbs and limbs.legs else None
        low, high = on_legs or cls.bounds
        if cls.may_lessen and limbs and limbs.declared and target:
            sizes, members = dict(limbs.declared), cls.members_of(target, limbs)
            low -= _ESTIMATED * max(0.0, min(sizes.get((cls.name, one), 0.0) for one in members))
        return low, high

    @classmethod
    def interior_bounds(cls, target: str, limbs: Limbs | None = None) -> tuple[float, float]:
        """The bounds (`bounds_on`), reduced by a little more than a step at each end, for
        derivatives within them.
        """
        (low, high), step = cls.bounds_on(limbs, target), cls.traced_at(target).step
        return low + 1.1 * step, high - 1.1 * step

    @classmethod
    def unit_of_slides(cls) -> str:
        """Unit on a joint that slides; `unit` for what is not on joints."""
        return ON_SLIDES.get(cls.unit, cls.unit) if cls.targets == "joint" else cls.unit

    @classmethod
    def unit_on(cls, target: str, limbs: Limbs) -> str:
        """Unit on a machine with these limbs: `unit_of_slides` for a joint that slides, or for
        several that all do.
        """
        slides = limbs.slides and set(cls.members_of(target, limbs)) <= set(limbs.slides)
        return cls.unit_of_slides() if slides else cls.unit

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

    def as_dict(self) -> dict[str, Any]:
        return {"name": self.name, "target": self.target, "value": self.value, "unit": self.unit}


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
