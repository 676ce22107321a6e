"""Report on an imported recording: feet, stamps and reference."""

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.clock import jitter_line
from surefoot.sim.importing.reference_check import (
    FEWEST_SAMPLES,
    check_reference,
    reference_noise,
    without_jumps,
)
from surefoot.sim.log import Log
from surefoot.sim.log.reference import Poses, reference_poses
from surefoot.sim.robot.machine import Machine, machine_for_log


def reference_lines(log: Log, poses: Poses | None = None) -> tuple[str, ...]:
    """Lines on the reference of a log: its samples, and their agreement with the IMU.

    `poses` are its samples where known; else they are recovered from the log. Empty without a
    reference.
    """
    if not log.has("reference"):
        return ()
    poses = reference_poses(log) if poses is None else poses
    found = check_reference(poses)
    lines = (found.samples, *found.faults)
    within = without_jumps(poses)
    within = within.rows((within.t > log.t[1]) & (within.t < log.t[-1]))
    if not log.has("imu") or len(within.t) < FEWEST_SAMPLES:
        return lines
    noise = reference_noise(log.t, log.gyro, log.accel, within)
    otherwise = "reference: does not turn as the IMU does; try surefoot align"
    return (*lines, noise.line if noise else otherwise)


def import_lines(
    log: Log,
    poses: Poses | None = None,
    wrong: np.ndarray | None = None,
    notes: tuple[str, ...] = (),
) -> tuple[str, ...]:
    """Lines on an imported log.

    `notes` on how it was read, the radius of its feet, its stamps, whether it starts in motion, its
    reference, and which of the `poses` were omitted since the IMU contradicts them (`wrong`, (K,)
    bool). Implausible values are reported by `sim.plausibility`.
    """
    try:
        machine, unknown = machine_for_log(log), ""
    except SurefootError as error:
        machine, unknown = None, f"robot: {error}" if log.meta.robot else ""
    about = (unknown, _radius_line(log, machine), _contact_line(log, machine), jitter_line(log.t))
    return (
        *notes,
        *(line for line in about if line),
        *reference_lines(log, poses),
        *_contradictions(poses, wrong),
    )


def _radius_line(log: Log, machine: Machine | None) -> str:
    """The radius of the feet that is used if the map states none; "" for a simulated log."""
    robot = None if machine is None else machine.legged
    said = "foot_radius" in log.meta.model or log.meta.seed is not None
    if robot is None or said or not log.has("q"):
        return ""
    sizes = " and ".join(f"{one:.3g}" for one in sorted(set((1e3 * robot.foot_radius).round(3))))
    return f"feet: a radius of {sizes} mm, of the robot's file; the map has no [robot] foot_radius"


def _contact_line(log: Log, machine: Machine | None) -> str:
    """Where the contacts of a legged robot can be taken from, if it has none; "" otherwise."""
    legged = log.has("foot") or (machine is not None and machine.legged and log.has("q"))
    if log.has("contact") or not (legged and log.has("imu")):
        return ""
    return "contacts: none; surefoot info LOG --contacts finds what the map's [contact] can be of"


def _contradictions(poses: Poses | None, wrong: np.ndarray | None) -> tuple[str, ...]:
    if poses is None or wrong is None or not wrong.any():
        return ()
    edges = np.flatnonzero(np.diff(wrong.astype(int), prepend=0, append=0)).reshape(-1, 2)
    when = ", ".join(f"{poses.t[a]:.2f} to {poses.t[b - 1]:.2f} s" for a, b in edges)
    left = f"reference: {wrong.sum()} samples left out, the accelerometer contradicts them: {when}"
    return (left,)
