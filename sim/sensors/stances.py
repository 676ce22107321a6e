"""Contacts of feet: from their force, and the stances and swings that they show."""

import numpy as np

SHORTEST_FLIGHT = 0.05
"""Shortest swing of a foot [s]; a shorter time in the air is a bounce."""


def changes(stands: np.ndarray) -> np.ndarray:
    """Rows (K,) at which a contact (N,) differs from the row before."""
    return 1 + np.flatnonzero(stands[1:] != stands[:-1])


def stances(stands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First row, and one past the last, of every uninterrupted contact in stands (N,) bool."""
    edges = np.diff(np.concatenate([[0], stands.astype(int), [0]]))
    return np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)


def stances_between_swings(t: np.ndarray, stands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same for t (N,) [s] and stands (N,), where a bounce does not interrupt a stance (as for
    `swings`).
    """
    (first, end), (lifts, lands) = stances(stands), swings(t, stands)
    return np.append(first[:1], lands), np.append(lifts, end[-1:])


def swings(t: np.ndarray, stands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First rows of a foot's swings, and of the stances after them (K,).

    A foot that is up for no longer than SHORTEST_FLIGHT has bounced. t (N,) [s]; stands (N,) bool.
    """
    first, end = stances(stands)
    lifts, lands = end[:-1], first[1:]
    swung = t[lands] - t[lifts] > SHORTEST_FLIGHT
    return lifts[swung], lands[swung]


def inside_stances(t: np.ndarray, contact: np.ndarray, begin: float, end: float) -> np.ndarray:
    """Rows and feet (N, L) in stance, more than `begin` and `end` [s] away from its beginning and
    end.

    t (N,) [s]; contact (N, L) bool.
    """
    inside = contact.copy()
    for leg in range(contact.shape[1]):
        change = changes(contact[:, leg])
        middle, lands = 0.5 * (t[change - 1] + t[change]), contact[change, leg]
        edges = np.zeros(len(t) + 1, dtype=int)
        np.add.at(edges, np.searchsorted(t, middle - np.where(lands, 0.0, end)), 1)
        behind = middle + np.where(lands, begin, 0.0)
        np.add.at(edges, np.searchsorted(t, behind, side="right"), -1)
        inside[np.cumsum(edges[:-1]) > 0, leg] = False
    return inside


def stance_phase(stands: np.ndarray) -> np.ndarray:
    """Phase (N,) of the stance at each row of stands (N,) bool, from 0 to 1; NaN in the air."""
    phase = np.full(len(stands), np.nan)
    for begin, end in zip(*stances(stands), strict=True):
        phase[begin:end] = (np.arange(end - begin) + 0.5) / (end - begin)
    return phase


def contact_from_force(
    t: np.ndarray, force: np.ndarray, on: float, off: float, debounce: float
) -> np.ndarray:
    """Contact (N,) of a foot from its force.

    Contact begins once the force has stayed above `on` for `debounce` seconds, and ends as soon as
    it falls below `off`. Later rows are not used. The first row needs no debouncing.

    Args:
        t: (N,) [s].
        force: (N,), less its offset, in the sensor's own unit.
        on: threshold of contact, in that unit.
        off: threshold of lift-off, off <= on.
        debounce: time above `on` before contact begins [s].
    """
    above = force > on
    # The start of the run of rows above `on` that each row belongs to.
    starts = above & ~np.concatenate(([False], above[:-1]))
    since = np.maximum.accumulate(np.where(starts, np.arange(len(t)), 0))
    # The tolerance of half a microsecond allows for rounded stamps.
    landed = above & ((t - t[since] >= debounce - 5e-7) | (since == 0))
    lifted = force < off
    # The last event decides; before any, the foot is in the air.
    event = np.maximum.accumulate(np.where(landed | lifted, np.arange(len(t)), -1))
    return landed[event] & (event >= 0)
