"""The Log, the only data passed between the packages: its file, schema and checks."""

# ruff: noqa: F401
from surefoot.sim.log.derived import (
    foot_velocity,
    joint_velocity,
    reference_velocity,
    with_velocities,
)
from surefoot.sim.log.file import LogError, LogReader, LogWriter
from surefoot.sim.log.log import Log, MemoisedLog
from surefoot.sim.log.schema import JOINTS, LEGS, SCHEMA, Meta
