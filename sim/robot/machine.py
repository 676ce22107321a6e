"""What a machine can do, and the machine of a name, a file or a log."""

from collections.abc import Mapping
from pathlib import Path

import mujoco

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log
from surefoot.sim.robot.catalog import machine_file
from surefoot.sim.robot.fixed_base import FixedBase
from surefoot.sim.robot.given_feet import GivenFeet
from surefoot.sim.robot.model_file import compiled_model
from surefoot.sim.robot.model_of_log import robot_of_log
from surefoot.sim.robot.robot import Robot

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
