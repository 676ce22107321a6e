"""The course as a reference trajectory: where the base should be, and how fast, at every tick."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surefoot.sim.common.kernels import kernel
from surefoot.sim.scenario import Segment

ACCELERATION = 0.8  # m/s^2, of the commanded speed
TURN_ACCELERATION = 1.5  # rad/s^2


@dataclass(frozen=True)
class Course:
    """Commanded motion in the plane, one row a controller tick."""

    t: np.ndarray  # (N,) s
    pose: np.ndarray  # (N, 3) x, y [m] and yaw [rad] in G
    velocity: np.ndarray  # (N, 3) forward, lateral [m/s], yaw rate [rad/s], along the heading


def lay_course(
    segments: Sequence[Segment], dt: float, stand: float, laps: int = 1, lead: float = 0.0
) -> Course:
    """Integrate the segments from the origin, with ramps between their velocities.

    Args:
        segments: of one lap.
        dt: of the course's rows [s].
        stand: time of standing still at the beginning and at the end [s].
        laps: how often the segments are walked.
        lead: further time of standing at the beginning [s].
    """
    targets = [np.zeros((round((lead + stand) / dt), 3))]
    for _ in range(laps):
        for s in segments:
            targets.append(np.tile([s.forward, s.lateral, s.turn], (round(s.duration / dt), 1)))
    targets.append(np.zeros((round((stand + 1.0) / dt), 3)))
    target = np.concatenate(targets)
    velocity = _ramped(target, np.array([ACCELERATION, ACCELERATION, TURN_ACCELERATION]) * dt)
    yaw = np.cumsum(velocity[:, 2]) * dt
    c, s = np.cos(yaw), np.sin(yaw)
    x = np.cumsum(c * velocity[:, 0] - s * velocity[:, 1]) * dt
    y = np.cumsum(s * velocity[:, 0] + c * velocity[:, 1]) * dt
    return Course(np.arange(len(yaw)) * dt, np.column_stack([x, y, yaw]), velocity)


@kernel
def _ramped(target, step):
    """`target` (N, 3) followed from rest, by at most `step` (3,) a row."""
    velocity = np.empty_like(target)
    now = np.zeros(3)
    for k in range(len(target)):
        for a in range(3):
            now[a] += min(max(target[k, a] - now[a], -step[a]), step[a])
            velocity[k, a] = now[a]
    return velocity
