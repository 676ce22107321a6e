"""What a reader should know of a recording before its numbers: reference, clocks, held streams."""

import numpy as np

from surefoot.sim.importing.reference_check import check_reference, without_jumps
from surefoot.sim.importing.reference_noise import FEWEST_SAMPLES, reference_noise
from surefoot.sim.importing.streams import held_streams, late_streams
from surefoot.sim.log import Log
from surefoot.sim.log.dead_reckoning import beside_imu
from surefoot.sim.log.derived import derivative
from surefoot.sim.log.reference import Poses, reference_poses

_TURN_WINDOW = 0.08
"""s over which rates of turning are compared: short against a stride, some samples long."""
_UNALIKE = 0.5
"""Share of the gyro's turning that a reference may miss before it is another body's, or another
clock's: noise of a walking robot's motion capture leaves a few hundredths."""


def reference_lines(log: Log, poses: Poses | None = None) -> tuple[str, ...]:
    """The reference of a log in lines: its samples, and what IMU and samples say together.

    `poses` are its samples where they are known; else they are found in the log. Empty without a
    reference.
    """
    if not log.has("reference"):
        return ()
    poses = reference_poses(log) if poses is None else poses
    lines = check_reference(poses).lines
    if not log.has("imu"):
        return lines
    within = without_jumps(poses)
    within = within.rows((within.t > log.t[1]) & (within.t < log.t[-1]))
    if len(within.t) < FEWEST_SAMPLES:
        return lines
    missed = _turning_missed(log, within)
    if missed > _UNALIKE:
        return (
            *lines,
            f"reference: does not turn as the IMU does (differs by {100 * missed:.0f} % of it):"
            " another clock, other axes or another body; try surefoot align",
        )
    noise = reference_noise(log.t, log.gyro, log.accel, within)
    return (*lines, noise.line) if noise else lines


def import_lines(log: Log, poses: Poses | None = None) -> tuple[str, ...]:
    """`reference_lines`, and the streams that are held or late."""
    streams = (*held_streams(log), *late_streams(log))
    return (*reference_lines(log, poses), *(one.line for one in streams))


def _turning_missed(log: Log, poses: Poses) -> float:
    """Share of the gyro's turning that is not the reference's; over 1 where it is another's."""
    beside = beside_imu(log.t, log.gyro, log.accel, poses)
    other = derivative(poses.t, beside.turn, _TURN_WINDOW, causal=False)
    turning = np.sum(np.var(beside.omega, axis=0))
    return float(np.sum(np.var(other, axis=0)) / max(turning, 1e-12))
