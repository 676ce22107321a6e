"""Logs that give the feet of a simulated robot instead of its joint angles."""

from dataclasses import replace

import pandas as pd

from surefoot.sim.log import Log
from surefoot.sim.log.schema import named_columns
from surefoot.sim.robot import Robot


def with_feet_for_joints(log: Log, robot: Robot, name: str = "feet") -> Log:
    """The log as a machine with closed chains would have it: it names no robot, and positions of
    the feet replace what is known of joints.
    """
    feet_I = robot.feet_I(log.q)
    kept = [c for c in log.frame if c == "t" or c.startswith(("gyro", "accel", "contact", "ref"))]
    names = [f"{leg}_{axis}" for leg in log.legs for axis in "xyz"]
    columns = named_columns("foot", feet_I.reshape(len(feet_I), -1), names)
    frame = pd.concat([log.frame[kept], pd.DataFrame(columns)], axis=1)
    return Log(frame, replace(log.meta, robot=None, scenario=None, effects=(), model={}), name)
