"""Checks of contacts against the motion of the feet: dead, stuck and inverted ones."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.plausibility.view import LogView

FARTHEST_STILL = 0.3
"""Distance that a standing body may sway or be lowered [m]; beyond it, the robot walks or is
carried.
"""
OTHERS_CHANGE = 6
"""Number of changes of each other contact within which a contact must change: three strides."""
UNCHANGED = 1.0
"""Shortest time without a change to report [s], two strides; bouncing contacts change often in
less.
"""
FLICKERS = 30.0
"""Changes per second to report: strides have four, and a sensor that misses one row in a hundred at
500 Hz another ten.
"""
LASTING = 0.05
"""Shortest lasting state of a contact [s], a fifth of the shortest stance; contacts of a standing
robot flicker for less.
"""
BOUNCES = 0.1
"""Time for which a foot may bounce at touchdown or lift-off [s]; on ice, seven times within some
rows.
"""
MISSES, MOST_SURE = 0.7, 16
"""Share of the touchdowns and lifts of most feet below which a contact misses steps, and the least
number of them: eight strides.
"""
HIGHER = 0.005
"""Height of feet in contact above lifted ones to report [m]; trotting robots lift by 30 to 80
mm.
"""
_CLEAR = 0.3
"""Correlation of contact with height from which it is inverted: clean walks have -0.4 to -0.9, on
stairs and slopes too, since heights are relative to the body.
"""


def missed(view: LogView) -> Iterator[Finding]:
    """Check that feet touch down about as often as each other."""
    log = view.log
    if not log.has("contact") or len(log.legs) < 3 or not view.comparable:
        return
    changes = np.array([_lasting(view.t, contact) for contact in log.contact.T])
    usual = float(np.median(changes))
    rare = (changes > 0) & (changes < MISSES * usual) & (usual >= MOST_SURE)
    for i in np.flatnonzero(rare):
        told = f"changes {changes[i]} times, where most feet do {usual:.0f} times"
        cause = "a threshold that lighter steps do not reach, or a leg that is held up"
        yield Finding((f"contact_{log.legs[i]}",), told, cause)


def dead(view: LogView) -> Iterator[Finding]:
    """Check that each foot of a walking robot touches down and lifts off."""
    log = view.log
    if not log.has("contact") or len(log.legs) < 2 or not view.comparable:
        return
    contact = log.contact
    changes = np.abs(np.diff(contact.astype(int), axis=0))
    count = changes.sum(axis=0)
    still = np.flatnonzero(count == 0)
    walks = int(np.sum(count >= OTHERS_CHANGE)) >= 2
    if len(still) == len(log.legs) and log.has("reference"):
        walks = float(np.ptp(log.ref_p[:, :2], axis=0).max()) > FARTHEST_STILL
        walks = walks and _legs_swing(view)
    if walks and still.size:
        for state, words in ((True, "always 1"), (False, "always 0")):
            columns = tuple(f"contact_{log.legs[i]}" for i in still if contact[0, i] == state)
            if columns:
                told = f"{words} although the robot walks"
                yield Finding(columns, told, "a dead sensor, or a wrong threshold")
    for i in np.flatnonzero(count > 0):
        first, last = _longest(np.flatnonzero(changes[:, i]), len(contact))
        if view.t[last - 1] - view.t[first] < UNCHANGED:
            continue
        others = [_lasting(view.t[first:last], x[first:last]) for x in np.delete(contact.T, i, 0)]
        if np.median(others) >= OTHERS_CHANGE:
            told = (
                f"no change from {view.t[first]:.2f} to {view.t[last - 1]:.2f} s, while the others "
                f"change {np.median(others):.0f} times"
            )
            yield Finding((f"contact_{log.legs[i]}",), told, "a sensor that hangs")


def flickering(view: LogView) -> Iterator[Finding]:
    """Check that a foot does not touch down and lift off too often."""
    log = view.log
    if not log.has("contact") or not view.comparable:
        return
    rate = np.array([_changes(view.t, x) for x in log.contact.T]) / (view.t[-1] - view.t[0])
    if (bad := np.flatnonzero(rate > FLICKERS)).size:
        columns = tuple(f"contact_{log.legs[i]}" for i in bad)
        told = f"{rate[bad].max():.0f} changes a second"
        yield Finding(columns, told, "noise about the threshold", "[contact] debounce")


def _changes(t: np.ndarray, contact: np.ndarray) -> int:
    """Number of changes of a contact (N,) at t; bounces at touchdown or lift-off count as one."""
    start, lasts = _states(t, contact)
    kept = np.flatnonzero(lasts)
    between = np.diff(kept)  # changes from one lasting state to the next, odd if it is the other
    took = t[start[kept[1:]]] - t[start[kept[:-1] + 1]]
    bounces = (between % 2 == 1) & (took < BOUNCES)
    return len(start) - 1 - int(np.sum(between[bounces] - 1))


def _lasting(t: np.ndarray, contact: np.ndarray) -> int:
    """Number of changes of a contact (N,) at t between lasting states."""
    start, lasts = _states(t, contact)
    return int(np.sum(np.diff(contact[start[lasts]].astype(int)) != 0))


def _states(t: np.ndarray, contact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First rows of the states of a contact (N,), and which of them are lasting."""
    start = np.concatenate([[0], np.flatnonzero(np.diff(contact.astype(int))) + 1])
    return start, np.diff(t[[*start, len(t) - 1]]) >= LASTING


def _legs_swing(view: LogView) -> bool:
    """Whether the feet move under the body as in walking."""
    if view.stance is None:
        return True
    return bool(np.median(np.ptp(view.stance.foot[:, :, :2], axis=0)) > 0.05)


def _longest(at: np.ndarray, rows: int) -> tuple[int, int]:
    edges = np.concatenate([[0], at + 1, [rows]])
    k = int(np.argmax(np.diff(edges)))
    return int(edges[k]), int(edges[k + 1])


def inverted(view: LogView) -> Iterator[Finding]:
    """Check that feet in contact are lower than lifted ones."""
    heights = contact_heights(view)
    if heights is None:
        return
    difference, alike = heights
    lifted = np.array([_lasting(view.t, contact) for contact in view.log.contact.T])
    wrong = (np.diag(difference) > HIGHER) & (np.diag(alike) > _CLEAR)
    wrong = np.flatnonzero(wrong & (lifted >= OTHERS_CHANGE))
    if wrong.size:
        columns = tuple(f"contact_{view.log.legs[i]}" for i in wrong)
        higher = 1e3 * np.diag(difference)[wrong].mean()
        told = f"feet are {higher:.0f} mm higher in contact than lifted"
        # In a trot, one diagonal stands while the other swings.
        all_of_them = "inverted: 1 means lifted, or left and right are swapped"
        cause = all_of_them if len(wrong) > 1 else "inverted, or another leg's"
        yield Finding(columns, told, cause)


def contact_heights(view: LogView) -> tuple[np.ndarray, np.ndarray] | None:
    """Mean height of foot i with contact k on, relative to off (L, L) [m], and their
    correlation.
    """
    legs, up = view.stance, view.up_by_body
    if legs is None or up is None:
        return None
    # Slow changes are due to terrain and posture.
    height = legs.foot @ up
    on = legs.contact.astype(float)
    moves = on.std(axis=0)
    if not (moves > 0.05).any():
        return None
    difference, alike = np.zeros((2, len(moves), len(moves)))
    h = height - height.mean(axis=0)
    for k in np.flatnonzero(moves > 0.05):
        c = on[:, k] - on[:, k].mean()
        difference[:, k] = (c @ h) / (c @ c)
        alike[:, k] = (c @ h) / np.maximum(np.linalg.norm(c) * np.linalg.norm(h, axis=0), 1e-12)
    return difference, alike
