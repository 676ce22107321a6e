"""Time at which contacts begin and end, relative to when the foot stops and starts to move.

The motion is that of the foot's contact point, from the leg's kinematics and the reference. A
landing foot stops within a millisecond; a lifting foot is unloaded for a while before it moves, and
is sensed as lifted in that time. A foot that slides as it lands does not show when.
"""

from dataclasses import replace

import numpy as np

from surefoot.models.residuals.binning import STANCE_MARGIN, ReferenceMotion, at_rows
from surefoot.sim.common.kernels import kernel
from surefoot.sim.log import Log
from surefoot.sim.robot.feet import Feet, shown_feet
from surefoot.sim.robot.machine import Machine
from surefoot.sim.robot.robot import DeclaredExtras
from surefoot.sim.sensors.stances import SHORTEST_FLIGHT, changes, inside_stances

STANDING_SPEED = 0.2
"""Speed over the ground from which a foot does not stand [m/s]: a tenth of its speed in swing."""
NEARING_SPEED = 0.1
"""Mean speed towards the ground below which a landing foot slides along it, even if it bounces
[m/s]: a fifth of that with which feet land.
"""
LEAST_SHIFT = 0.01
"""Delay of contacts that exceeds the duration of landing and lifting [s]: half a bin, and ten times
the variation on simulated walks.
"""
FEWEST_ROWS = 3
"""Rows that a foot slides for at least, at a low rate."""
FEWEST_CHANGES = 8
"""Contact changes needed for a median delay."""
NEARLY_ALL = 95.0
"""Percentile of the delays by which nearly all contacts have begun."""
CHANGE_WINDOW = 0.08
"""Time before and after a contact change in which the foot's motion is examined [s]."""
USUAL_DELAY = (-0.0005, -0.018)
"""Usual delay of the beginning and end of contacts on simulated walks [s], within 0.7 ms and 12 ms
on models of seven robots.
"""


def contact_timing(
    log: Log, feet: Feet, motion: ReferenceMotion, extras: DeclaredExtras
) -> np.ndarray:
    """Delay of contact changes (M, 2 legs) [s]: touchdowns of the feet, then their lift-offs,
    beyond those of the declared `extras`.

    Each change is in the bin in which the foot stopped or started to move; all other bins are NaN.
    """
    moves = log.once(
        "when touching points stop and start",
        (*feet.groups, "imu", "contact", "reference", "ref_v"),
        lambda: _all_motion_changes(log, feet, motion),
        *(motion.R_GI, motion.v_I, motion.gyro, motion.ok, motion.normal_G),
        *vars(feet).values(),  # the same objects until they change
    )
    late = np.full((len(motion.first), 2 * len(moves)), np.nan)
    # A debounced contact begins late by the debounce time.
    begins = USUAL_DELAY[0] + log.meta.model.get("contact_debounce", 0.0) + extras.touchdown_late
    usual = (begins, USUAL_DELAY[1] + extras.liftoff_late)
    for leg, (change, (at, when, lifts)) in enumerate(moves):
        behind = 0.5 * (log.t[change] + log.t[change - 1]) - when
        known = np.isfinite(when)
        bins = np.searchsorted(motion.first, at[known], side="right") - 1
        column = leg + len(moves) * lifts[known]
        late[bins, column] = (behind - np.where(lifts, *usual[::-1]))[known]
    return late


def within_windows(motion: ReferenceMotion, log: Log, robot: Machine) -> ReferenceMotion:
    """Restrict stances and swings of the reference motion to the feet's actual ones.

    Where contacts end late or begin early relative to the foot's motion, stances are shortened by
    that much. A leaving foot deviates by a hundred times the noise of a standing one, and a foot
    radius or a leg's compliance would be fitted to it. Where contacts begin late, the ends of
    swings, in which legs already carry load, are removed, by the delay of nearly all steps since
    each step has a delay of its own. Unchanged where the log shows no feet.
    """
    feet = shown_feet(log, robot.feet)
    if feet is None:
        return motion
    begins, ends = (
        part[np.isfinite(part)]
        for part in np.hsplit(contact_timing(log, feet, motion, robot.extras), 2)
    )
    behind, late = (
        float(np.median(x)) if len(x) >= FEWEST_CHANGES else 0.0 for x in (begins, ends)
    )
    if behind > LEAST_SHIFT:
        loaded = STANCE_MARGIN + float(np.percentile(begins, NEARLY_ALL))
        swings = inside_stances(log.t, ~log.contact, STANCE_MARGIN, loaded)
        motion = replace(motion, lifted=swings & motion.ok[:, None])
    early = max(-behind - log.meta.model.get("contact_debounce", 0.0), 0.0)
    if max(early, late) < LEAST_SHIFT:
        return motion
    late = max(late, 0.0)
    inside = inside_stances(log.t, log.contact, STANCE_MARGIN + early, STANCE_MARGIN + late)
    return replace(motion, standing=inside & motion.ok[:, None], early=early, late=late)


def _all_motion_changes(
    log: Log, feet: Feet, motion: ReferenceMotion
) -> list[tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """Rows at which each foot's contact changes, and `motion_changes` there."""
    rows, bounce, slide = (
        round(time * log.rate) for time in (CHANGE_WINDOW, SHORTEST_FLIGHT, LEAST_SHIFT)
    )
    rows, slide, contact = max(1, rows), max(FEWEST_ROWS, slide), log.contact
    turns = [changes(stands) for stands in contact.T]
    near = np.zeros(contact.shape, dtype=bool)
    for leg, turn in enumerate(turns):
        around = turn[:, None] + np.arange(-rows - 1, rows + 1)
        near[np.clip(around, 0, len(contact) - 1), leg] = True
    speeds = speeds_over_ground(log, feet, motion, near & motion.ok[:, None])
    return [
        (
            turn,
            motion_changes(log.t, contact[:, leg], *speeds[:, :, leg], turn, rows, bounce, slide),
        )
        for leg, turn in enumerate(turns)
    ]


def speeds_over_ground(
    log: Log, feet: Feet, motion: ReferenceMotion, where: np.ndarray
) -> np.ndarray:
    """Speeds (2, N, L) [m/s] of the feet's contact points over the ground, and along its normal
    (positive towards it), where `where` (N, L); NaN elsewhere.
    """
    omega = at_rows(log.gyro if log.has("imu") else motion.gyro)
    v = feet.imu_velocity(*feet.readings(log), omega, motion.normal_I, where)
    x, y, z = np.moveaxis(v - motion.v_I[:, None], 2, 0)
    a, b, c = motion.normal_I.T[:, :, None]
    # Unlike a norm over the last axis, fast.
    return np.stack([np.sqrt(x * x + y * y + z * z), a * x + b * y + c * z])


@kernel
def motion_changes(t, stands, speed, nearing, changes, rows, bounce, slide):
    """Find when the foot stopped or started to move at each of K contact changes.

    The search starts in the middle of the swing, or as far into it as `rows` reach, and goes
    towards the stance, so that a slip in mid-stance does not count.

    Args:
        t: (N,) [s].
        stands: (N,) bool.
        speed: (N,) [m/s], of the foot.
        nearing: (N,) [m/s], along the normal of the ground.
        changes: (K,), rows at which `stands` changes.
        rows: to search on either side.
        bounce: rows up to which a foot in the air has only bounced; it has then landed before.
        slide: rows before a landing foot stops, in which it comes no nearer to the ground if it
            slides.

    Returns:
        The row and the time [s] of each, NaN where not seen within `rows` or where the foot bounced
        or slid, and whether the foot lifts, (K,) each. Where the search ended at a row without a
        speed, that row, and NaN for the time.
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
        if not speed[row] > STANDING_SPEED:
            continue
        for _ in range(far + rows):
            row += step
            if row < 0 or row >= len(t):
                break
            if speed[row] > STANDING_SPEED:
                continue
            if not lifts[k] and abs(np.mean(nearing[max(0, row - slide) : row])) < NEARING_SPEED:
                break
            at[k] = row
            if np.isfinite(speed[row]):
                share = (STANDING_SPEED - speed[row]) / (speed[row - step] - speed[row])
                when[k] = t[row] + share * (t[row - step] - t[row])
            break
    return at, when, lifts
