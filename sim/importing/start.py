"""Whether a robot already moves where its log starts: filters without a reference start at rest."""

import numpy as np

from surefoot.sim.log import Log, foot_velocity, joint_velocity, reference_velocity
from surefoot.sim.robot.feet import shown_feet
from surefoot.sim.robot.machine import Machine

BEGINNING = 0.1
"""Time at the start over which motion is averaged [s], three rows at least: a fifth of a stride."""
LEG_MOVES, BODY_TURNS = 0.3, 0.1
"""Rate from which a joint [rad/s] or a foot [m/s] moves (standing robots have 0.01, walking ones
0.7), and RMS rate from which a body turns [rad/s] (twenty times the noise of a gyro at rest).
"""


def start_line(log: Log, machine: Machine | None = None) -> str:
    """Say how fast a robot moves in the first rows of a log, and what to do about it.

    "" if it rests, and without an IMU, since no filter runs then. `machine` is the log's, None if
    unknown.
    """
    if not log.has("imu"):
        return ""
    first = log.rows(log.t <= max(log.t[0] + BEGINNING, log.t[:3][-1]))
    turning, leg = float(np.sqrt(np.mean(np.sum(first.gyro**2, axis=1)))), 0.0
    shown = [f"gyro {turning:.2f} rad/s"]
    if log.has("q"):
        leg = float(np.abs(joint_velocity(first).mean(axis=0)).max())
        shown.append(f"a joint {leg:.1f} rad/s")
    elif log.has("foot"):
        leg = float(np.abs(foot_velocity(first).mean(axis=0)).max())
        shown.append(f"a foot {leg:.1f} m/s")
    if turning < BODY_TURNS and leg < LEG_MOVES:
        return ""
    if log.has("reference") and log.ref_ok[0]:
        speed = np.linalg.norm(reference_velocity(first).mean(axis=0))
        shown.append(f"reference {speed:.2f} m/s")
        remedy = "filters take its velocity from there; begin where it stands for the gyro's bias"
    else:
        speed = _speed_of_legs(first, machine)
        shown += [f"standing legs {speed:.2f} m/s"] if speed else []
        deviation = np.ceil(10.0 * speed) / 10.0 if speed else 1.0
        remedy = (
            "filters without a reference start at rest: begin where it stands, or set "
            f"start.velocity={deviation:g}"
        )
    return f"start: the robot moves already in the first rows ({', '.join(shown)}); {remedy}"


def _speed_of_legs(first: Log, machine: Machine | None) -> float | None:
    """Speed of the IMU by the feet in contact [m/s]; None where they are unknown."""
    feet = None if machine is None else shown_feet(first, machine.feet)
    if feet is None or not first.has("contact") or not first.contact.any():
        return None
    up = first.accel / np.linalg.norm(first.accel, axis=1, keepdims=True)
    v_I = feet.imu_velocity(*feet.readings(first), first.gyro, up, first.contact)
    return float(np.linalg.norm(np.nanmedian(v_I.reshape(-1, 3), axis=0)))
