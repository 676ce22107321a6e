"""Contact of a foot from its raw force."""

import numpy as np


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
