"""The style of a measured walk (speeds and turns, gait and posture), and walks on flat ground in
that style.
"""

from dataclasses import dataclass, replace

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.gait.controller import gait_for
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log, reference_velocity
from surefoot.sim.physics.scene import refuse_other_legs
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Ranges, Scenario, Segment
from surefoot.sim.sensors.stances import stances_between_swings

PIECE = 1.0
"""Length of the pieces over which the walk's velocities are averaged [s]."""
SHORTEST = 3
"""Least number of pieces with a reference."""
LONGEST_STRIDE = 2.0
"""Time between touchdowns beyond which a foot has paused [s]."""
MOVING = 0.05
"""Mean speed of the base over half a second from which it walks [m/s]."""
PERIODS, CLEARANCES = (0.6, 1.6), (0.5, 2.0)
"""Range of factors on the controller's own gait within which it walks."""


@dataclass(frozen=True)
class WalkingStyle:
    """Speeds, gait and posture of a walk."""

    twists: np.ndarray  # (N, 3) forward, lateral [m/s], turn [rad/s] of each piece
    period: float  # factor on the controller's gait period
    clearance: float  # factor on the height of its swing foot
    q_stance: np.ndarray  # (12,) rad, the middle of stance


def walking_style(log: Log, robot: Robot) -> WalkingStyle:
    """The style of a walk, from the velocities of its reference and, if available, contacts and
    joints.

    Raises SurefootError if the reference covers too little of the walk, or for a robot that cannot
    walk in simulation.
    """
    refuse_other_legs(robot)
    twists = body_twists(log)
    if len(twists) < SHORTEST:
        raise SurefootError(f"{log.name}: the reference covers less than {SHORTEST} s of walk")
    if not (log.has("contact") and log.has("q")):
        return WalkingStyle(twists, 1.0, 1.0, robot.q_home)
    gait = gait_for(robot, 0.0)
    period = _period(log)
    walks = moving(log)
    height = np.einsum("jk,nlk->nlj", robot.R_BI, robot.feet_I(log.q))[..., 2]
    contact = log.contact & walks[:, None]
    q, stance, lifts = log.q.reshape(-1, 4, 3), robot.q_home.copy(), []
    for leg, stands in enumerate(contact.T):
        if stands.any():
            lifts.append(np.quantile(height[walks, leg], 0.98) - np.median(height[stands, leg]))
            stance[3 * leg : 3 * leg + 3] = np.median(q[stands, leg], axis=0)
    return WalkingStyle(
        twists,
        float(np.clip(period / gait.period, *PERIODS)) if period else 1.0,
        float(np.clip(np.median(lifts) / gait.clearance, *CLEARANCES)) if lifts else 1.0,
        np.clip(stance, robot.joint_range[:, 0], robot.joint_range[:, 1]),
    )


def style_of(style: WalkingStyle, robot: Robot, speed: float, turn: float) -> WalkingStyle:
    """The style for another robot, with that robot's own period and posture.

    Args:
        style: of the measured walk.
        robot: that is to walk so.
        speed: factor on the velocities, for longer legs and strides.
        turn: factor on the rates of turning.
    """
    return WalkingStyle(style.twists * (speed, speed, turn), 1.0, style.clearance, robot.q_home)


def replica(style: WalkingStyle, robot: Robot, name: str) -> tuple[Scenario, Robot]:
    """A walk in the style of a measured one, with its pieces in their own order and nothing varied.

    It lasts from the first moving piece to the last: before and after, the measured robot stands,
    while the simulated one would step in place. Returns the scenario, and the robot in the measured
    posture.
    """
    moves = np.flatnonzero(np.hypot(*style.twists[:, :2].T) > MOVING)
    walks = style.twists[moves[0] : moves[-1] + 1] if len(moves) else style.twists
    segments = tuple(Segment(PIECE, *map(float, twist)) for twist in walks)
    period, clearance = style.period, style.clearance
    as_measured = Ranges(period=(period, period), clearance=(clearance, clearance))
    scenario = Scenario(name, segments, Ground(0.8), robot.name, ranges=as_measured)
    return scenario, replace(robot, q_home=style.q_stance)


def slower(scenario: Scenario, factor: float) -> Scenario:
    """The same course at a fraction of its velocities, for a robot that falls at the measured
    ones.
    """
    segments = tuple(
        Segment(s.duration, s.forward * factor, s.lateral * factor, s.turn * factor)
        for s in scenario.segments
    )
    return replace(scenario, segments=segments)


def body_twists(log: Log) -> np.ndarray:
    """Mean forward and lateral velocity [m/s] and yaw rate [rad/s] of each PIECE with a
    reference.
    """
    t, ok, R, v = log.t, log.ref_ok, log.ref_R_GI, reference_velocity(log)
    yaw = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    c, s = np.cos(yaw), np.sin(yaw)
    forward, lateral = c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0]
    twists = []
    for begin in np.arange(t[0], t[-1] - PIECE, PIECE):
        rows = np.flatnonzero((t >= begin) & (t < begin + PIECE) & ok)
        if len(rows) < 2 or t[rows[-1]] - t[rows[0]] < 0.5 * PIECE:
            continue
        turn = (yaw[rows[-1]] - yaw[rows[0]]) / (t[rows[-1]] - t[rows[0]])
        twists.append((forward[rows].mean(), lateral[rows].mean(), turn))
    return np.array(twists).reshape(-1, 3)


def moving(log: Log) -> np.ndarray:
    """Rows (N,) at which the base moves, by the reference averaged over half a second."""
    v = reference_velocity(log)
    n = max(1, round(0.5 * log.rate))
    smooth = np.stack([np.convolve(v[:, a], np.full(n, 1 / n), "same") for a in range(2)])
    return np.hypot(*smooth) > MOVING


def strides(t: np.ndarray, stands: np.ndarray) -> np.ndarray:
    """Times (K, 3) [s] of each stride of a foot: touchdown, lift-off, next touchdown. Pauses are
    left out.

    t (N,) [s]; stands (N,) bool. A bounce is no lift-off.
    """
    first, end = stances_between_swings(t, stands)
    # A stance that the log begins with landed before.
    first, end = first[first > 0], end[first > 0]
    found = np.column_stack([t[first[:-1]], t[end[:-1]], t[first[1:]]])
    return found[found[:, 2] - found[:, 0] < LONGEST_STRIDE]


def _period(log: Log) -> float | None:
    """Median time between touchdowns of a leg [s]; None without touchdowns."""
    each = np.concatenate([strides(log.t, stands) for stands in log.contact.T])
    return float(np.median(each[:, 2] - each[:, 0])) if len(each) else None
