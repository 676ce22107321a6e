"""When contacts begin and end, against when the foot stops and starts to move.

The motion is that of the point with which the foot would touch, by the leg's kinematics and the
reference. A foot that lands stops within a millisecond; one that lifts is unloaded for a while
before it moves, and is sensed as lifted then.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from surefoot.models.residuals.binning import EDGE, ReferenceMotion
from surefoot.models.residuals.leg_velocity import leg_velocity
from surefoot.sim.common.kernels import kernel
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.contact import SHORTEST_FLIGHT
from surefoot.sim.sensors.stances import changes, inside_stances

MOVES = 0.2
"""m/s over the ground from which a foot does not stand: a tenth of what one swings at."""
LEAST_SHIFT = 0.01
"""s by which contacts are late or early that have more than a foot's landing and lifting in them:
half a bin, and ten times what they vary by on simulated walks."""
FEWEST_CHANGES = 8
"""Changes of contact whose median is known."""
NEARLY_ALL = 95.0
"""Percentile of the contacts' lateness by which nearly all have begun."""
CHANGE_WINDOW = 0.08
"""s on either side of a change of contact in which the foot is looked at."""
USUAL = (-0.0005, -0.018)
"""s, how late contacts begin and end on simulated walks: within 0.7 ms and 12 ms on models of seven
robots."""


def contact_timing(log: Log, robot: Robot, frame: ReferenceMotion) -> np.ndarray:
    """How late contacts change (M, 2 legs) [s]: touchdowns of the feet, then their liftoffs.

    Each change is in the bin in which the foot stopped or started; all other bins are NaN.
    """
    rows, bounce = max(1, round(CHANGE_WINDOW * log.rate)), round(SHORTEST_FLIGHT * log.rate)
    turns = [changes(stands) for stands in log.contact.T]
    speed = log.once(
        "speed of touching points",
        log.columns_of("q", "dq", "imu", "contact", "reference", "ref_v"),
        lambda: over_ground(log, robot, frame, near_changes(turns, frame, rows)),
        *(frame, robot.legs, robot.foot_radius, robot.R_BI, robot.p_BI),
    )
    late = np.full((len(frame.first), 2 * len(turns)), np.nan)
    # A contact that must last for a time before it counts begins late by that.
    begins = USUAL[0] + log.meta.model.get("contact_debounce", 0.0) + robot.extras.touchdown_late
    usual = (begins, USUAL[1] + robot.extras.liftoff_late)
    for leg, change in enumerate(turns):
        at, when, lifts = moments(log.t, log.contact[:, leg], speed[:, leg], change, rows, bounce)
        behind = 0.5 * (log.t[change] + log.t[change - 1]) - when
        known = np.isfinite(when)
        bins = np.searchsorted(frame.first, at[known], side="right") - 1
        column = leg + len(turns) * lifts[known]
        late[bins, column] = (behind - np.where(lifts, *usual[::-1]))[known]
    return late


def within_windows(frame: ReferenceMotion, log: Log, robot: Robot) -> ReferenceMotion:
    """The reference motion, whose feet stand and swing only while they do by their own motion.

    Where contacts end late, or begin early, by the legs' kinematics, that much more is left out at
    the ends of every stance. What the foot does there as it leaves is a hundred times the noise of
    one that stands, and a foot's radius or a spring in its leg would be fitted to it. Where they
    begin late, the ends of swings are left out, in which legs already carry: as many as nearly all
    steps are late by, for each is late by its own time.
    """
    timing = contact_timing(log, robot, frame)
    legs = timing.shape[1] // 2
    begins, ends = timing[:, :legs], timing[:, legs:]
    begins, ends = (x[np.isfinite(x)] for x in (begins, ends))
    behind = float(np.median(begins)) if len(begins) >= FEWEST_CHANGES else 0.0
    late = float(np.median(ends)) if len(ends) >= FEWEST_CHANGES else 0.0
    if behind > LEAST_SHIFT:
        loaded = EDGE + float(np.percentile(begins, NEARLY_ALL))
        swings = inside_stances(log.t, ~log.contact, EDGE, loaded)
        frame = replace(frame, lifted=swings & frame.ok[:, None])
    early = max(-behind - log.meta.model.get("contact_debounce", 0.0), 0.0)
    if max(early, late) < LEAST_SHIFT:
        return frame
    late = max(late, 0.0)
    inside = inside_stances(log.t, log.contact, EDGE + early, EDGE + late)
    return replace(frame, standing=inside & frame.ok[:, None], early=early, late=late)


def near_changes(turns: Sequence[np.ndarray], frame: ReferenceMotion, rows: int) -> np.ndarray:
    """Rows and feet (N, L) no more than `rows` from a foot's changes of contact."""
    n = len(frame.ok)
    near = np.zeros((n, len(turns)), dtype=bool)
    for leg, change in enumerate(turns):
        count = np.zeros(n + 1, dtype=int)
        np.add.at(count, np.maximum(change - rows - 1, 0), 1)
        np.add.at(count, np.minimum(change + rows + 1, n), -1)
        near[:, leg] = np.cumsum(count[:-1]) > 0
    return near & frame.ok[:, None]


def over_ground(log: Log, robot: Robot, frame: ReferenceMotion, where: np.ndarray) -> np.ndarray:
    """Speed (N, L) [m/s] over the ground of the points with which feet touch, at the rows and feet
    `where` (N, L), NaN elsewhere."""
    rows = np.flatnonzero(where.any(axis=1))
    omega = log.gyro if log.has("imu") else frame.gyro
    dq = joint_velocity(log)[rows]
    v = leg_velocity(robot, log.q[rows], dq, omega[rows], frame.up_I[rows], where[rows])
    speed = np.full(where.shape, np.nan)
    speed[rows] = np.linalg.norm(v - frame.v_I[rows, None], axis=2)
    return speed


@kernel
def moments(t, stands, speed, changes, rows, bounce):
    """Of each change (K,), the row and time [s] at which the foot stopped or started to move, and
    whether it lifts. NaN where that is not seen within `rows`, or where the foot bounced: one that
    stands again has landed before.

    Searched from the middle of the swing, or from as far into it as `rows` go, towards the stance:
    a slip in mid-stance does not count.

    Args:
        t: (N,) [s].
        stands: (N,) bool.
        speed: (N,) [m/s], of the foot.
        changes: (K,), rows at which `stands` changes.
        rows: to search on either side.
        bounce: rows up to which a foot in the air has only bounced.
    """
    at, when = np.zeros(len(changes), np.int64), np.full(len(changes), np.nan)
    lifts = np.zeros(len(changes), np.bool_)
    for k, change in enumerate(changes):
        lifts[k] = not stands[change]
        other = k + 1 if lifts[k] else k - 1
        if other < 0 or other >= len(changes):
            continue
        swing = abs(changes[other] - change)
        if not lifts[k] and swing <= bounce:
            continue
        far = min(rows, swing // 2)
        step = -1 if lifts[k] else 1
        row = change - step * far
        if not speed[row] > MOVES:
            continue
        for _ in range(far + rows):
            row += step
            if row < 0 or row >= len(t) or not np.isfinite(speed[row]):
                break
            if speed[row] <= MOVES:
                share = (MOVES - speed[row]) / (speed[row - step] - speed[row])
                when[k] = t[row] + share * (t[row - step] - t[row])
                at[k] = row
                break
    return at, when, lifts
