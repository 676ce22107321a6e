"""The Log, the only thing that is passed between the rooms: its file, its schema, its checks."""

from surefoot.sim.log.derived import joint_velocity, reference_velocity, with_velocities
from surefoot.sim.log.log import SCHEMA, Log, LogError, Meta
from surefoot.sim.log.schema import JOINTS, LEGS

__all__ = [
    "JOINTS",
    "LEGS",
    "SCHEMA",
    "Log",
    "LogError",
    "Meta",
    "joint_velocity",
    "reference_velocity",
    "with_velocities",
]
