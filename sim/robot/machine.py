"""What a machine can do, the kinds that are no robots with legs, and the machine of a name, a file
or a log.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import mujoco

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log
from surefoot.sim.robot.body_changes import BodyChanges
from surefoot.sim.robot.catalog import machine_file, robot_of_log
from surefoot.sim.robot.feet import PointFeet
from surefoot.sim.robot.inverse_dynamics import Dynamics, dynamics_of
from surefoot.sim.robot.limbs import Limbs, refuse_foreign
from surefoot.sim.robot.model_file import compiled_model
from surefoot.sim.robot.robot import DeclaredExtras, Robot


@dataclass(frozen=True)
class FixedBase:
    """The declared model of a machine on a fixed base: its file and its joints, in its order.

    Attributes:
        name: of its file.
        file: MJCF or URDF.
        joint_names: as in the file.
        extras: properties beyond the file, from a log's map or effects.
        legless: why no legs were found in a URDF, which may be of a robot with legs; empty where
            the file says that the base is fixed.
        fixed: as of `Machine`, as are `feet` and `legged`.
    """

    name: str
    file: Path
    joint_names: tuple[str, ...]
    extras: DeclaredExtras = field(default_factory=DeclaredExtras)
    legless: str = ""
    fixed: ClassVar[bool] = True
    feet: ClassVar[None] = None
    legged: ClassVar[None] = None

    @classmethod
    def of_model(cls, file: Path, model: mujoco.MjModel, legless: str = "") -> "FixedBase":
        """The machine of a compiled file. Raises SurefootError where no joint turns or slides."""
        moves = {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}
        single = [model.joint(j).name for j in range(model.njnt) if int(model.jnt_type[j]) in moves]
        if not single:
            raise SurefootError(f"robot {file}: has no hinge or slide")
        return cls(file.stem, file, tuple(single), legless=legless)

    def in_log(self, log: Log) -> "FixedBase":
        """The machine with the joints of a log, in its order.

        Raises SurefootError where it lacks one of them, and where no legs were found for a log with
        feet.
        """
        if self.legless and (log.has("contact") or log.has("foot")):
            raise SurefootError(f"{log.name}: is of a machine with legs; {self.legless}")
        if not log.has("q"):
            raise SurefootError(f"{log.name}: the log has no joints")
        refuse_foreign(log.joints, self.joint_names, f"{log.name}: joint", self.name)
        return FixedBase(self.name, self.file, log.joints)

    @property
    def dynamics(self) -> Dynamics:
        """As of `Machine`: of its file, with the declared links."""
        return dynamics_of(self.file, self.joint_names, BodyChanges(links=self.extras.links))

    @cached_property
    def limbs(self) -> Limbs:
        """Its joints, which of them slide, and what they move; it has no legs."""
        model = compiled_model(self.file)
        joints = [model.joint(name) for name in self.joint_names]
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        return Limbs(
            (),
            self.joint_names,
            (),
            slides=tuple(joint.name for joint in joints if int(joint.type[0]) == slide),
            inertia=tuple(float(model.dof_M0[joint.dofadr[0]]) for joint in joints),
            mass=float(model.body_mass[model.body_weldid != 0].sum()),
            declared=self.extras.declared,
        )


@dataclass(frozen=True)
class GivenFeet:
    """A walking machine whose logs give the positions of its feet in I, such as one with closed
    chains.

    It has no model of its joints, links and masses.

    Attributes:
        limbs: names of the legs; there are no joints.
        extras: properties that effects add.
        fixed: as of `Machine`, as are `feet`, `legged` and `dynamics`.
    """

    limbs: Limbs
    extras: DeclaredExtras = field(default_factory=DeclaredExtras)
    fixed: ClassVar[bool] = False
    feet: ClassVar[PointFeet] = PointFeet()
    legged: ClassVar[None] = None
    dynamics: ClassVar[None] = None

    @classmethod
    def of_log(cls, log: Log) -> "GivenFeet":
        """The machine of a log. Raises LogError where it does not give feet."""
        log.require("foot")
        return cls(Limbs(log.legs, (), ()))


Modelled = Robot | FixedBase
"""A machine with a model of its links."""
Machine = Modelled | GivenFeet
"""A machine as its logs are compared with it.

Callers ask for what they need, and every kind answers with what it has: `limbs`, names of legs and
joints; `extras`, properties beyond its file; `fixed`, whether its base cannot move; and, or None,
`feet`, how its logs show them; `dynamics`, of its links, with what is declared of them; `legged`,
itself as a robot whose legs, links and floating base are modelled.
"""


def load_machine(name_or_path: str | Path, feet: Mapping[str, str] | None = None) -> Modelled:
    """Load a robot with legs, or a fixed base if the model has no free joint or is a URDF without
    legs.

    Raises SurefootError. feet: as for `Robot.load`; with feet it is a robot with legs.
    """
    file, legless = machine_file(name_or_path), ""
    model = compiled_model(file)
    if (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any():
        try:
            return Robot.load(name_or_path, feet)
        except SurefootError as error:
            if feet or file.suffix != ".urdf":
                raise
            legless = str(error)
    return FixedBase.of_model(file, model, legless)


def machine_for_log(log: Log, name: str | Path | None = None) -> Machine:
    """The machine `name`, or else the one the log names, with the values of the log's map; without
    either, that of the feet that the log gives.

    Raises SurefootError where a fixed base lacks a joint that the log has, and where no legs were
    found for a log with feet.
    """
    chosen = name or robot_of_log(log)
    if chosen:
        return load_machine(chosen, log.meta.model.get("feet")).in_log(log)
    # `Robot.for_log` says what the log lacks.
    return GivenFeet.of_log(log) if log.has("foot") else Robot.for_log(log)
