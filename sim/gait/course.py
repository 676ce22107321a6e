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


def course_ticks(
    segments: Sequence[Segment], dt: float, stand: float, laps: int = 1, lead: float = 0.0
) -> int:
    """Number of rows of the course, as `course_pieces` integrates it.

    Args:
        segments, dt, stand, laps, lead: as for `course_pieces`.
    """
    return sum(rows for rows, _ in _stretches(segments, dt, stand, laps, lead))


def course_pieces(
    segments: Sequence[Segment],
    dt: float,
    stand: float,
    laps: int,
    lead: float,
    rows: int,
) -> Iterator[Course]:
    """Integrate the segments from the origin, with ramps between their velocities, in pieces of
    `rows` rows.

    Args:
        segments: of one lap.
        dt: of the course's rows [s].
        stand: time of standing still at the beginning and at the end [s].
        laps: how often the segments are walked.
        lead: further time of standing at the beginning [s].
        rows: of a piece; the last one may be shorter.
    """
    step = np.array([ACCELERATION, ACCELERATION, TURN_ACCELERATION]) * dt
    first, now, sums = 0, np.zeros(3), np.zeros(3)
    for target in _targets(_stretches(segments, dt, stand, laps, lead), rows):
        velocity = _ramped(target, step, now)
        yaw = _summed(velocity[:, 2], sums, 2) * dt
        c, s = np.cos(yaw), np.sin(yaw)
        x = _summed(c * velocity[:, 0] - s * velocity[:, 1], sums, 0) * dt
        y = _summed(s * velocity[:, 0] + c * velocity[:, 1], sums, 1) * dt
        t = np.arange(first, first + len(yaw)) * dt
        yield Course(t, np.column_stack([x, y, yaw]), velocity)
        first += len(yaw)


def _stretches(
    segments: Sequence[Segment], dt: float, stand: float, laps: int, lead: float
) -> Iterator[tuple[int, tuple[float, float, float]]]:
    """Sections of constant command: number of rows, and forward, lateral [m/s] and yaw rate
    [rad/s].

    Args:
        segments, dt, stand, laps, lead: as for `course_pieces`.
    """
    yield round((lead + stand) / dt), (0.0, 0.0, 0.0)
    for _ in range(laps):
        for s in segments:
            yield round(s.duration / dt), (s.forward, s.lateral, s.turn)
    yield round((stand + 1.0) / dt), (0.0, 0.0, 0.0)


def _targets(
    stretches: Iterable[tuple[int, tuple[float, float, float]]], rows: int
) -> Iterator[np.ndarray]:
    """The commands (N, 3), one row per tick, at most `rows` at a time."""
    piece, used = np.empty((rows, 3)), 0
    for count, command in stretches:
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
