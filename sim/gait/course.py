"""The course as a reference trajectory: pose and velocity of the base at every tick."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from surefoot.sim.common.kernels import kernel

ACCELERATION = 0.8  # m/s^2, of the commanded speed
TURN_ACCELERATION = 1.5  # rad/s^2


@dataclass(frozen=True)
class Segment:
    """A section of the course with one commanded velocity of the base."""

    duration: float  # s
    forward: float = 0.0  # m/s
    lateral: float = 0.0  # m/s, positive to the left
    turn: float = 0.0  # rad/s, positive to the left


@dataclass(frozen=True)
class Course:
    """Commanded motion in the plane, one row for each controller tick."""

    t: np.ndarray  # (N,) s
    pose: np.ndarray  # (N, 3) x, y [m] and yaw [rad] in G
    velocity: np.ndarray  # (N, 3) forward, lateral [m/s], yaw rate [rad/s], along the heading


Stretch = tuple[int, tuple[float, float, float]]
"""Rows of constant command: their number, and forward, lateral [m/s] and yaw rate [rad/s]."""


def stretches(
    segments: Sequence[Segment], dt: float, stand: float, laps: int = 1, lead: float = 0.0
) -> list[Stretch]:
    """The commands of a walk along the segments.

    Args:
        segments: of one lap.
        dt: of the course's rows [s].
        stand: time of standing still at the beginning and at the end [s].
        laps: how often the segments are walked.
        lead: further time of standing at the beginning [s].
    """
    still = (0.0, 0.0, 0.0)
    lap = [(round(s.duration / dt), (s.forward, s.lateral, s.turn)) for s in segments]
    return [(round((lead + stand) / dt), still), *lap * laps, (round((stand + 1.0) / dt), still)]


def integrate_course(commands: Sequence[Stretch], dt: float) -> Course:
    """Integrate the commands from the origin, with ramps between their velocities.

    Args:
        commands: of the walk.
        dt: of the course's rows [s].
    """
    (whole,) = course_pieces(commands, dt, sum(count for count, _ in commands))
    return whole


def course_pieces(commands: Sequence[Stretch], dt: float, rows: int) -> Iterator[Course]:
    """The rows of `integrate_course` in pieces of `rows`, the last one maybe shorter, using the
    memory of one piece.
    """
    step = np.array([ACCELERATION, ACCELERATION, TURN_ACCELERATION]) * dt
    first, now, sums = 0, np.zeros(3), np.zeros(3)
    for target in _targets(commands, rows):
        velocity = _ramped(target, step, now)
        yaw = _summed(velocity[:, 2], sums, 2) * dt
        c, s = np.cos(yaw), np.sin(yaw)
        x = _summed(c * velocity[:, 0] - s * velocity[:, 1], sums, 0) * dt
        y = _summed(s * velocity[:, 0] + c * velocity[:, 1], sums, 1) * dt
        t = np.arange(first, first + len(yaw)) * dt
        yield Course(t, np.column_stack([x, y, yaw]), velocity)
        first += len(yaw)


def _targets(commands: Iterable[Stretch], rows: int) -> Iterator[np.ndarray]:
    """The commands (N, 3), one row per tick, at most `rows` at a time."""
    piece, used = np.empty((rows, 3)), 0
    for count, command in commands:
        while count:
            part = min(count, rows - used)
            piece[used : used + part] = command
            used, count = used + part, count - part
            if used == rows:
                yield piece
                used = 0
    if used:
        yield piece[:used]


def _summed(x: np.ndarray, sums: np.ndarray, which: int) -> np.ndarray:
    """Cumulative sums of x (N,), continued from the sums of the pieces before, which are
    updated.
    """
    total = np.cumsum(np.append(sums[which], x))[1:]
    sums[which] = total[-1]
    return total


@kernel
def _ramped(target, step, now):
    """Follow `target` (N, 3) from `now` (3,), which is updated, by at most `step` (3,) per row."""
    velocity = np.empty_like(target)
    for k in range(len(target)):
        for a in range(3):
            now[a] += min(max(target[k, a] - now[a], -step[a]), step[a])
            velocity[k, a] = now[a]
    return velocity
