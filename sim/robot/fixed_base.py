"""Machines with a fixed base: a pendulum, an arm, any MJCF without a free joint."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import mujoco

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled, is_file
from surefoot.sim.log import Log
from surefoot.sim.robot.catalog import robot_file
from surefoot.sim.robot.given_feet import GivenFeet, Walker
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.model_file import compiled_model
from surefoot.sim.robot.model_of_log import robot_of_log
from surefoot.sim.robot.robot import DeclaredExtras, Robot

BUNDLED_MACHINES = bundled("surefoot.sim.robot", "machines")


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
        declared: as of `Limbs`.
    """

    name: str
    file: Path
    joint_names: tuple[str, ...]
    extras: DeclaredExtras = field(default_factory=DeclaredExtras)
    legless: str = ""
    declared: tuple[tuple[tuple[str, str], float], ...] = ()

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
            declared=self.declared,
        )


Machine = Walker | FixedBase


def load_machine(
    name_or_path: str | Path, feet: Mapping[str, str] | None = None
) -> Robot | FixedBase:
    """Load a robot with legs, or a fixed base if the model has no free joint or is a URDF without
    legs.

    Raises SurefootError. feet: as for `Robot.load`; with feet it is a robot with legs.
    """
    bundled = BUNDLED_MACHINES / f"{name_or_path}.xml"
    file = bundled if is_file(bundled) else robot_file(name_or_path)
    model, legless = compiled_model(file), ""
    if (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any():
        try:
            return Robot.load(name_or_path, feet)
        except SurefootError as error:
            if feet or file.suffix != ".urdf":
                raise
            legless = str(error)
    moves = {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}
    single = [model.joint(j).name for j in range(model.njnt) if int(model.jnt_type[j]) in moves]
    if not single:
        raise SurefootError(f"robot {file}: has no hinge or slide")
    return FixedBase(file.stem, file, tuple(single), legless=legless)


def machine_for_log(log: Log, name: str | Path | None = None) -> Machine:
    """The machine `name`, or else the one the log names, with the values of the log's map; without
    either, that of the feet that the log gives.

    Raises SurefootError where a fixed base lacks a joint that the log has, and where no legs were
    found for a log with feet.
    """
    chosen = name or robot_of_log(log)
    if not chosen:
        # `Robot.for_log` says what the log lacks.
        return GivenFeet.of_log(log) if log.has("foot") else Robot.for_log(log)
    machine = load_machine(chosen, log.meta.model.get("feet"))
    if isinstance(machine, Robot):
        return Robot.for_log(log, chosen)
    if machine.legless and (log.has("contact") or log.has("foot")):
        raise SurefootError(f"{log.name}: is of a machine with legs; {machine.legless}")
    if not log.has("q"):
        raise SurefootError(f"{log.name}: the log has no joints")
    for joint in log.joints:
        if joint not in machine.joint_names:
            raise SurefootError(
                f"{log.name}: joint {joint} is not one of {machine.name}'s: "
                f"{', '.join(machine.joint_names)}"
            )
    return FixedBase(machine.name, machine.file, log.joints)
