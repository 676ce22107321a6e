"""Base class of the effects that a real robot has and a model may lack.

An effect defines two things independently: how it is injected into a simulation (MjSpec, ground,
sensors or their streams), and how a model that includes it compensates it in a log (`compensate`).
A third, `traced`, says how `trace` looks for it. Its influence on the residual of a log follows
from `compensate` by finite differences; `Traced.chain_rule` declares a faster way.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, TypeVar

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.errors import SurefootError, check_known, errors_in
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.physics.loads import knows_loads
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine
from surefoot.sim.sensors.streams import Reference, Streams

Part = Literal["joint", "link", "link_axis", "leg", "leg_link", "leg_axis"]
"""A joint; the link that it moves, by its name; that link along one of its body's axes,
`<joint>_<axis>`; a leg; a link of a leg, named after the joint at its upper end; a leg along one of
the base's axes, `<leg>_<axis>`.
"""


AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Prior:
    """Prior of an effect's size, in the effect's unit.

    Attributes:
        within: bound on the magnitude for 19 of 20 machines.
        source: of that figure.
        most: magnitude beyond which the size is implausible for any machine, so that another cause
            must explain the residual: three times the limit of a working sensor's data sheet.
    """

    within: float
    source: str
    most: float = np.inf


@dataclass(frozen=True)
class Traced:
    """How `trace` looks for an effect.

    Attributes:
        channels: residual channels that the effect can change.
        step: of numerical derivatives with respect to the size, in its unit; required if a model
            can compensate the effect.
        prior: of the size; without one, any size within the bounds is equally plausible.
        belongs_to: what has the effect: the machine; a sensor, whose error is no change of the
            machine; or a run, in which a zero, bias or clock has a size of its own.
        motion: that tells the effect from others.
        needs: groups of a log's columns, as for `Log.require`, that `compensate` needs beyond those
            of its channels.
        bounds_on_legs: narrower bounds on a machine with legs, whose parts are small.
        starts: initial sizes for a search, where the residual is far from linear in the size; by
            default one step.
        chain_rule: the only quantities that `compensate` changes, so that derivatives of the
            residual may use the chain rule: "readings" (columns of gyro, accel, q, dq, tau), "legs"
            (leg geometry and foot radius) or "mass" (inertial parameters). None: finite differences
            of the residual, valid for any effect.
        lossy: whether compensation degrades the readings, by interpolation of streams shifted in
            time or by the noise of a derivative.
        uses_loads: whether `compensate` takes the loads of joints or feet from the log, in which
            all other effects must be compensated before.
        unseen_by: residual channels whose readings are not compensated. A spring's compensation
            replaces the encoders' angles by those of a rigid leg with the feet at their actual
            positions; the motors, and the links if only the feet yield, remain at the encoders'
            angles.
        on_given_feet: whether `compensate` also works for a machine that is known by its feet alone
            (`sim.robot.machine`), by changing the readings or `extras` only.
        by_search: whether the search over residuals fits the size; False where it has an estimate
            of its own.
        spread: relative spread of the size between parts of one kind, at 95 %, of an effect that
            machines have by construction; None if it may be on any part alone.
        scales_with: what a size measured on one robot is multiplied by for another: what its unit
            says (`carry.DIMENSIONS`), or the radius of the foot.
    """

    channels: tuple[str, ...] = ()
    step: float = 0.0
    prior: Prior | None = None
    belongs_to: Literal["machine", "sensor", "run"] = "machine"
    motion: str = "more varied motion"
    needs: tuple[str, ...] = ()
    bounds_on_legs: tuple[float, float] | None = None
    starts: tuple[float, ...] = ()
    chain_rule: Literal["readings", "legs", "mass"] | None = None
    lossy: bool = False
    uses_loads: bool = False
    unseen_by: tuple[str, ...] = ()
    on_given_feet: bool = False
    by_search: bool = True
    spread: float | None = None
    scales_with: Literal["unit", "foot_radius"] = "unit"


NO_FIGURE_OF_DRIVES = "no figure found: wide for legs; large arms may have more"
"""Source of priors of drives for which none was found."""


Kind = TypeVar("Kind", bound=Any)


_ESTIMATED = 1.25
"""Largest decrease of a declared size, as a multiple of it: above 1, since the declared size is an
estimate too.
"""


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
    """By default that of the class, in words: `gyro_bias` of a class GyroBias."""
    unit: ClassVar[str]
    bounds: ClassVar[tuple[float, float]]
    may_lessen: ClassVar[bool] = False
    """Whether sizes below zero are valid as well, down to minus the upper bound: the machine may
    have less of the effect than its model declares. The bounds are then those of an increase.
    """
    targets: ClassVar[Part | tuple[str, ...]]
    """Kind of part that the effect is on, or the names of its targets if they are no parts."""
    groups: ClassVar[bool] = False
    """Whether a group of parts may share one size (`group_targets`)."""
    by_torque: ClassVar[bool] = False
    """Whether it grows with the torque of a joint's drive or errs in its reading, so that a joint
    without a drive cannot have it.
    """
    traced: ClassVar[Traced] = Traced()
    """How `trace` looks for the effect."""

    def __init_subclass__(cls) -> None:
        if "name" not in vars(cls):
            cls.name = re.sub(r"(?<=.)(?=[A-Z])", "_", cls.__name__).lower()

    def __post_init__(self):
        if isinstance(self.targets, tuple):
            with errors_in(f"effect {self.name}"):
                check_known("target", self.target, self.targets)
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
        known = {one: (one,) for one in cls.single_targets(limbs)} | cls.group_targets(limbs)
        with errors_in(f"effect {cls.name}"):
            if not known:
                raise SurefootError("no part of this machine can have it")
            check_known("target", target, known)
        return known[target]

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

    @property
    def order(self) -> tuple[bool, bool]:
        """Place in which the effect is compensated beside others: errors of sensors before those of
        the body, whose sizes are in true units, and last those that take loads from the log.
        """
        return self.traced.uses_loads, type(self).edit_spec is not Effect.edit_spec

    @classmethod
    def is_compensated(cls) -> bool:
        """Whether a model can compensate the effect, which makes it a candidate of `trace`."""
        return cls.compensate is not Effect.compensate

    @classmethod
    def is_compensated_on(cls, log: Log, target: str) -> bool:
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
        """Largest decrease [unit] that the machine's model allows: of a mass, the mass itself."""
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


def parts(part: Part, limbs: Limbs) -> tuple[str, ...]:
    """Names of the parts of this kind on a machine with these limbs."""
    names = {
        "joint": limbs.joints,
        "link": limbs.joints,
        "leg": limbs.legs,
        "leg_link": limbs.links,
    }
    if part in names:
        return names[part]
    return tuple(f"{one}_{axis}" for one in names[part.removesuffix("_axis")] for axis in AXES)


def groups(part: Part, limbs: Limbs) -> dict[str, tuple[str, ...]]:
    """Groups of parts of this kind for which one size makes sense, with their members.

    Joints and links are grouped by kind (`thigh`), but for links of legs also by side and as `all`;
    legs as `front`, `rear`, `left`, `right` and `all`. A group has at least two members, and no two
    have the same.
    """
    single = parts(part, limbs)
    found: dict[str, tuple[str, ...]] = {}
    if part in ("joint", "link", "leg_link"):
        for kind, joints in limbs.kinds.items():
            found[kind] = tuple(joint for joint in joints if joint in single)
    for side, legs in limbs.sides.items():
        if part in ("joint", "link") and side in ("left", "right"):
            found[side] = tuple(limbs.joints[j] for leg in legs for j in limbs.chains[leg])
        elif part == "leg":
            found[side] = tuple(limbs.legs[leg] for leg in legs)
    if part in ("joint", "link", "leg"):
        found["all"] = single
    distinct: dict[frozenset[str], str] = {}
    for name, members in found.items():
        if len(members) > 1 and name not in single:
            distinct.setdefault(frozenset(members), name)
    return {name: found[name] for name in distinct.values()}


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
