"""What residual the declared model leaves by itself: repeats of the log's own motion in simulation."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from sim.log import Log, reference_velocity
from sim.robot import Robot
from sim.scenario import Scenario, Segment
from sim.terrain import Ground
from sim.walk import Fallen, walk

REPEATS = 4
SECONDS = 12.0
"""s of walking in each repeat."""
PIECE = 1.0
"""s over which the log's motion is averaged into one commanded velocity."""
FRICTION = 0.8
SEED = 20_011
STAND = 0.5  # s


def repeats(logs: Sequence[Log], robot: Robot) -> tuple[list[Log], Robot | None]:
    """Short walks of the declared robot along stretches of the logs' own courses, and its model.

    Each repeat follows the body velocities of the reference. Seeds are fixed, so the floor is a
    function of the logs. A stretch on which the robot falls is tried again slower; the list is empty
    and the robot None where it cannot walk.
    """
    walks = [_walk(robot.file, course, SEED + i) for i, course in enumerate(courses(logs))]
    done = [log for log in walks if log is not None]
    return (done, Robot.load(robot.file)) if done else ([], None)


def courses(logs: Sequence[Log]) -> list[tuple[tuple[float, float, float], ...]]:
    """Commanded forward, lateral velocity [m/s] and turn [rad/s] a second, for each repeat."""
    motion = [piece for log in logs for piece in _motion(log)]
    length = max(1, min(round(SECONDS / PIECE), len(motion)))
    starts = np.linspace(0, len(motion) - length, REPEATS).round().astype(int)
    return [tuple(motion[start : start + length]) for start in starts] if motion else []


def _motion(log: Log) -> list[tuple[float, float, float]]:
    t, ok, R, v = log.t, log.ref_ok, log.ref_R_GI, reference_velocity(log)
    yaw = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    c, s = np.cos(yaw), np.sin(yaw)
    forward, lateral = c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0]
    pieces = []
    for begin in np.arange(t[0], t[-1] - PIECE, PIECE):
        rows = np.flatnonzero((t >= begin) & (t < begin + PIECE) & ok)
        if len(rows) < 2 or t[rows[-1]] - t[rows[0]] < 0.5 * PIECE:
            continue
        turn = (yaw[rows[-1]] - yaw[rows[0]]) / (t[rows[-1]] - t[rows[0]])
        # Two decimals: rounding makes equal courses equal, so that they are walked once.
        velocity = forward[rows].mean(), lateral[rows].mean(), turn
        pieces.append(tuple(round(float(x), 2) for x in velocity))
    return pieces


@lru_cache(maxsize=64)
def _walk(file: Path, course: tuple[tuple[float, float, float], ...], seed: int) -> Log | None:
    robot = Robot.load(file)
    for slower in (1.0, 0.6, 0.3):
        segments = tuple(
            Segment(PIECE, forward * slower, lateral * slower, turn * slower)
            for forward, lateral, turn in course
        )
        scenario = Scenario("floor", segments, Ground(FRICTION), stand=STAND)
        try:
            return walk(scenario, robot, seed)
        except Fallen:
            continue
    return None
