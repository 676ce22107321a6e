"""Machines with a fixed base: a pendulum, an arm, any MJCF without a free joint."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import mujoco

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log
from surefoot.sim.robot.inverse_dynamics import BodyChanges, Dynamics, dynamics_of
from surefoot.sim.robot.limbs import Limbs, refuse_foreign
from surefoot.sim.robot.model_file import compiled_model
from surefoot.sim.robot.robot import DeclaredExtras


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
