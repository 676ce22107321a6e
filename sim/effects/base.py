"""What an effect is: something that a real robot has and a model may lack.

An effect says two things that share no code: how it is injected into a simulation (the MjSpec,
the ground, the sensors or their streams), and how a model that knows of it compensates it on a log
(`compensate`). What a size does to the residual of a log follows from the latter alone, by a
difference of the residual; `chain_rule` names a shortcut.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects.targets import AXES, Part, groups, parts
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.sensors.streams import Reference, Streams

__all__ = ["AXES", "Effect", "changed_columns", "joint_sizes", "turn_about", "with_columns"]


@dataclass(frozen=True)
class Effect:
    """One effect on one target (a joint, leg, axis, or several of one size), of one scalar size.

    A subclass gives its name, unit, bounds and sort of target, which residual channels it can
    affect, how it is injected (one of the `alter_` methods or `edit_spec`), and, where a model can
    compensate it, how. Raises SurefootError for a target it does not have or a size out of bounds;
    which parts there are depends on the machine (`members`).
    """

    target: str
    value: float

    name: ClassVar[str]
    unit: ClassVar[str]
    bounds: ClassVar[tuple[float, float]]
    channels: ClassVar[tuple[str, ...]]
    targets: ClassVar[Part | tuple[str, ...]]
    """What it is on: a sort of part, of which a machine has its own, or words of the effect's."""
    groups: ClassVar[bool] = False
    """Whether several parts may share one size, as those of one make do (`targets.groups`)."""
    step: ClassVar[float]
    """A small size, for numerical derivatives by it; an effect that is compensated needs one."""
    starts: ClassVar[tuple[float, ...]] = ()
    """Sizes to begin a search from, where the residual is far from linear in the size."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Groups of a log's columns, as of `Log.require`, that `compensate` needs, beyond those of its
    channels."""
    chain_rule: ClassVar[Literal["readings", "legs", "mass"] | None] = None
    """By what alone `compensate` acts, so that the derivative of the residual by the size may be
    taken by the chain rule: "readings" (columns of gyro, accel, q, dq, tau), "legs" (the robot's
    leg geometry and foot radius), "mass" (what its base carries). None: the derivative is a
    difference of the residual itself, which holds for any effect."""

    lossy: ClassVar[bool] = False
    """Whether undoing it leaves readings that are worse than without it: what streams that were
    moved in time have lost between their rows, or the noise of a derivative."""

    takes_loads: ClassVar[bool] = False
    """Whether `compensate` takes the loads of joints or feet from the log, which is to be as all
    other effects leave it."""

    def __post_init__(self):
        if isinstance(self.targets, tuple) and self.target not in self.targets:
            raise SurefootError(self._unknown(self.target, self.targets))
        low, high = self.bounds
        if not low <= self.value <= high:
            raise SurefootError(
                f"effect {self.name}: value must lie between {low:g} and {high:g} {self.unit}, "
                f"is {self.value:g}"
            )

    @classmethod
    def single_targets(cls, limbs: Limbs) -> tuple[str, ...]:
        """The single targets of this effect: parts of a machine with these limbs, or the words of
        `targets` where these are its targets."""
        return cls.targets if isinstance(cls.targets, tuple) else parts(cls.targets, limbs)

    @classmethod
    def group_targets(cls, limbs: Limbs) -> dict[str, tuple[str, ...]]:
        """The groups of parts that may share one size: name -> members, which are single targets.

        None where `groups` is not set, or where the machine has no two parts of the sort.
        """
        if not cls.groups or isinstance(cls.targets, tuple):
            return {}
        return groups(cls.targets, limbs)

    @classmethod
    def targets_on(cls, limbs: Limbs) -> tuple[str, ...]:
        """Every target on a machine with these limbs: single ones, then groups."""
        return (*cls.single_targets(limbs), *cls.group_targets(limbs))

    @classmethod
    def members_of(cls, target: str, limbs: Limbs) -> tuple[str, ...]:
        """The single targets that a target stands for: itself, or a group's members.

        Raises SurefootError for a target that a machine with these limbs does not have.
        """
        if target in (single := cls.single_targets(limbs)):
            return (target,)
        found = cls.group_targets(limbs)
        if target not in found:
            raise SurefootError(cls._unknown(target, (*single, *found)))
        return found[target]

    def members(self, limbs: Limbs) -> tuple[str, ...]:
        """The single targets that its own target stands for (see `members_of`)."""
        return self.members_of(self.target, limbs)

    @classmethod
    def _unknown(cls, target: str, known: tuple[str, ...]) -> str:
        return f"effect {cls.name}: unknown target '{target}'; known: {', '.join(known)}"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Change the simulated world; effects of sensors mostly leave it as it is."""

    def alter_ground(self, ground: Ground) -> Ground:
        """Change the ground's contacts; its shape stays, since the controller knows it."""
        return ground

    def alter_mounting(self, robot: Robot) -> Robot:
        """Change where the IMU really is; the reference stays with the nominal mounting."""
        return robot

    def alter_reference(self, reference: Reference) -> Reference:
        """Change the reference measurement; effects of the robot leave it as it is."""
        return reference

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        """Change the sensors' readings; effects of the world mostly leave them as they are."""
        return streams

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        """The log and the robot as a model sees them that knows of the effect.

        What it changed in the readings is undone in the log; what it changed in the robot is added
        to the robot's declared model.
        """
        raise NotImplementedError(f"effect {self.name} is only for simulation")

    @classmethod
    def step_of(cls, target: str) -> float:
        """The step of the size on this target for numerical derivatives."""
        return cls.step

    @classmethod
    def starts_on(cls, target: str, log: Log) -> tuple[float, ...]:
        """Sizes from which a search on this log begins: `starts`, or else a small one."""
        return cls.starts or (cls.step_of(target),)

    @classmethod
    def inside(cls, target: str) -> tuple[float, float]:
        """The bounds less a step at each end, so that derivatives can be taken within them."""
        (low, high), step = cls.bounds, cls.step_of(target)
        return low + 1.1 * step, high - 1.1 * step

    @classmethod
    def is_lossy(cls, target: str) -> bool:
        """Whether undoing it on this target leaves worse readings (`lossy`)."""
        return cls.lossy

    @classmethod
    def is_compensated(cls) -> bool:
        """Whether a model can know of the effect, so that `trace` has it as a candidate."""
        return cls.compensate is not Effect.compensate

    @classmethod
    def channels_of(cls, target: str) -> tuple[str, ...]:
        """The residual channels that it affects on this target."""
        return cls.channels

    @classmethod
    def is_another(cls, target: str, robot: Robot) -> bool:
        """Whether it is indistinguishable on this machine from another effect, which `trace` tries
        instead."""
        return False

    @classmethod
    def is_certain(cls, target: str, robot: Robot) -> bool:
        """Whether every real machine has it and this model lacks it: only its size is open."""
        return False

    @classmethod
    def is_compensated_on(cls, log: Log) -> bool:
        """Whether a log has the columns that `compensate` needs."""
        return all(log.has(group) for group in cls.needs)

    def as_dict(self) -> dict[str, Any]:
        return {"name": self.name, "target": self.target, "value": self.value, "unit": self.unit}


def joint_sizes(one: Effect, limbs: Limbs) -> np.ndarray:
    """(J,): the size at the joints that an effect is on, zero at the others."""
    return one.value * np.isin(limbs.joints, one.members(limbs))


def turn_about(axis: str, angle: float) -> np.ndarray:
    """Rotation matrix (3, 3) by an angle [rad] about an axis, one of AXES."""
    return Rotation.from_rotvec(angle * np.eye(3)[AXES.index(axis)]).as_matrix()


def with_columns(log: Log, columns: Mapping[str, np.ndarray]) -> Log:
    """The log with some columns replaced."""
    return log.with_columns(columns)


def changed_columns(before: Log, after: Log) -> tuple[str, ...]:
    """The columns of `after` whose numbers are not those of `before`, or that it lacks."""
    old = before.columns
    return tuple(
        name
        for name, x in after.columns.items()
        if name not in old or not (old[name] is x or np.array_equal(old[name], x))
    )
