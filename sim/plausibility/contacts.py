"""Checks of contacts against the motion of the feet: dead, stuck and inverted ones."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.streams import still_sections
from surefoot.sim.plausibility.view import LogView
from surefoot.sim.sensors.stances import changes

FARTHEST_STILL = 0.3
"""Distance that a standing body may sway or be lowered [m]; beyond it, the robot walks or is
carried.
"""
OTHERS_CHANGE = 6
"""Number of changes of each other contact within which a contact must change: three strides."""
STRIDE = 2
"""Number of lasting changes of a contact in a stride."""
MOVES_APART, MOVES = 0.2, 0.2
"""Speed of a foot against others in contact that is none of a standing foot [m/s], and share of the
time of a foot that does not stand: sliding feet have 0.14 in half a second, swinging ones 0.26.
"""
FEWEST_TIMES = 10
"""Least number of times for such a share."""
UNCHANGED = 1.0
"""Shortest time without a change to report [s], two strides; bouncing contacts change often in
less.
"""
FLICKERS = 0.5
"""Share of its time that a contact spends in states that do not last: bouncing feet have a quarter.
"""
LASTING = 0.05
"""Shortest lasting state of a contact [s], a fifth of the shortest stance; contacts of a standing
robot flicker for less.
"""
MISSES, MOST_SURE = 0.7, 16
"""Share of the touchdowns and lifts of most feet below which a contact misses steps, and the least
number of them: eight strides.
"""
HIGHER = 0.005
"""Height of feet in contact above lifted ones to report [m]; trotting robots lift by 30 to 80
mm.
"""
_VARIES = 0.05**2
"""Least variance of a contact."""
_CLEAR = 0.3
"""Correlation of contact with height from which it is inverted: clean walks have -0.4 to -0.9, on
stairs and slopes too, since heights are relative to the body.
"""


@plausibility_rule("flickering", "t contact", when="comparable")
def flickering(view: LogView) -> Iterator[Finding]:
    """Check that a foot does not touch down and lift off too often.

    Compares: contacts with themselves over time.
    Threshold: {FLICKERS:.0%} of its time in states of less than {LASTING:g} s.
    Reason: a fifth of the shortest stance; feet bounce for less than a quarter of their time.
    Remedy: [contact] debounce, or a threshold that is further from the noise; `import` compares
        sources of contacts.
    """
    for i, contact in enumerate(view.log.contact.T):
        start, lasts = _states(view.t, contact)
        times = np.diff(view.t[[*start, -1]])
        share = float(times[~lasts].sum() / times.sum())
        if share > FLICKERS:
            seen = f"{100 * share:.0f} % of its time in states of less than {LASTING:g} s"
            cause = "noise about the threshold: on, off and debounce of [contact]"
            yield Finding(view.columns("contact", [i]), seen, cause)


@plausibility_rule("contacts", "contact")
def dead(view: LogView) -> Iterator[Finding]:
    """Check that each foot of a walking robot touches down and lifts off as often as the others.

    Compares: contacts with each other over time, and the velocity of each foot in contact with
        that of the others.
    Threshold: at most one changes, or one does not for {UNCHANGED:g} s in which the others change
        {OTHERS_CHANGE} times and more, although the robot walks; in a log in which it never
        changes, one stride of the others, or a foot that moves for {MOVES:.0%} of its time;
        less than {MISSES:g} of the changes of most feet, where these have {MOST_SURE} or more.
    Reason: a foot of a robot that walks lifts once a stride; feet that stand move alike.
    Remedy: the threshold of [contact] for that foot, or another source of contacts, which `import`
        compares; leave a dead contact out.
    """
    contact = view.log.contact
    if contact.shape[1] < 2:
        return
    steps = np.array([_lasting(view.t, one) for one in contact.T])
    usual = float(np.median(steps))
    for i in np.flatnonzero(_never_changes(view, steps)):
        cause = f"a dead sensor, or a wrong threshold: always {contact[0, i]:d}"
        yield Finding(view.columns("contact", [i]), "no change although the robot walks", cause)
    for i in np.flatnonzero(np.ptp(contact.astype(int), axis=0)):
        column = view.columns("contact", [i])
        # Of two feet, neither is unlike most.
        if len(steps) > 2 and usual >= MOST_SURE and 0 < steps[i] < MISSES * usual:
            seen = f"changes {steps[i]} times, where most feet do {usual:.0f} times"
            cause = "a threshold that lighter steps do not reach, or a leg that is held up"
            yield Finding(column, seen, cause)
        for rows in still_sections(view.t, contact[:, i], UNCHANGED)[:1]:
            t, beside = view.t[rows], np.delete(contact, i, axis=1)[rows]
            others = np.median([_lasting(t, x) for x in beside.T])
            if others >= OTHERS_CHANGE:
                seen = f"no change, while the others change {others:.0f} times"
                when = f"from {t[0]:.2f} to {t[-1]:.2f} s"
                yield Finding(column, seen, f"a sensor that hangs {when}")


def _never_changes(view: LogView, steps: np.ndarray) -> np.ndarray:
    """Mask (L,) of contacts that never change although the robot walks; `steps` (L,) are the
    lasting changes of each.
    """
    log, contact = view.log, view.log.contact
    count = np.abs(np.diff(contact.astype(int), axis=0)).sum(axis=0)
    moves = _moving_in_contact(view)
    # A robot that has just begun to walk has not lifted every foot.
    walks = np.where(contact[0], np.sum(count >= OTHERS_CHANGE), np.sum(steps >= STRIDE)) >= 2
    wrong = np.where(np.isfinite(moves), moves > MOVES, walks) & (count == 0)
    if np.sum(steps >= STRIDE) < 2 and not wrong.any() and log.has("reference"):
        far = float(np.ptp(log.ref_p[:, :2], axis=0).max()) > FARTHEST_STILL
        # Its feet move under it, so that it is not carried.
        feet = None if view.stance is None else view.stance.foot[:, :, :2]
        strides = feet is None or float(np.median(np.ptp(feet, axis=0))) > 0.05
        wrong = (count == 0) & (far and strides)
    return wrong


def _moving_in_contact(view: LogView) -> np.ndarray:
    """Share (L,) of its time in contact in which a foot moves against the median of those in
    contact; NaN where that is unknown.
    """
    legs = view.feet if view.log.has("imu") else None
    if legs is None:
        return np.full(len(view.log.legs), np.nan)
    some = legs.at(np.flatnonzero(legs.contact.any(axis=1)))
    by_foot = np.where(some.contact[..., None], some.by_leg, np.nan)
    apart = np.linalg.norm(by_foot - np.nanmedian(by_foot, axis=1, keepdims=True), axis=2)
    share = np.sum(apart > MOVES_APART, axis=0) / np.maximum(some.contact.sum(axis=0), 1)
    return np.where(some.contact.sum(axis=0) < FEWEST_TIMES, np.nan, share)


def _lasting(t: np.ndarray, contact: np.ndarray) -> int:
    """Number of changes of a contact (N,) at t between lasting states."""
    start, lasts = _states(t, contact)
    return int(np.sum(np.diff(contact[start[lasts]].astype(int)) != 0))


def _states(t: np.ndarray, contact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First rows of the states of a contact (N,), and which of them are lasting."""
    start = np.concatenate([[0], changes(contact)])
    return start, np.diff(t[[*start, len(t) - 1]]) >= LASTING


@plausibility_rule("contact heights", "contact", beside="q foot accel")
def inverted(view: LogView) -> Iterator[Finding]:
    """Check that feet in contact are lower than lifted ones.

    Compares: the height of a foot in contact with that when lifted.
    Threshold: {HIGHER:g} m higher.
    Reason: trotting robots lift their feet by 30 to 80 mm.
    Remedy: contact from the other level of the switch; the order of the legs.
    """
    legs, up = view.feet, view.up_by_body
    if legs is None or up is None:
        return
    # Slow changes are due to terrain and posture.
    height, on = legs.foot @ up, legs.contact.astype(float)
    height, on = height - height.mean(axis=0), on - on.mean(axis=0)
    both, power = np.sum(on * height, axis=0), np.sum(on**2, axis=0)
    alike = both / np.maximum(np.sqrt(power * np.sum(height**2, axis=0)), 1e-12)
    lifted = np.array([_lasting(view.t, contact) for contact in view.log.contact.T])
    # A contact that hardly changes has no other height.
    higher = both / np.where(power > _VARIES * len(on), power, np.inf)
    wrong = np.flatnonzero((higher > HIGHER) & (alike > _CLEAR) & (lifted > STRIDE))
    # By chance of posture, one foot may seem so for a stride or two, though less clearly.
    if wrong.size > 1 or np.any((lifted[wrong] >= OTHERS_CHANGE) | (alike[wrong] > 2.0 * _CLEAR)):
        seen = f"feet are {1e3 * higher[wrong].mean():.0f} mm higher in contact than lifted"
        # In a trot, one diagonal stands while the other swings.
        all_of_them = "inverted: 1 means lifted, or left and right are swapped"
        cause = all_of_them if len(wrong) > 1 else "inverted, or another leg's"
        yield Finding(view.columns("contact", wrong), seen, cause)
