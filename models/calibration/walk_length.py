"""Length of the walk that a calibration needs."""

from itertools import count

from surefoot.models.calibration.mixing import LONGEST_LAG
from surefoot.models.calibration.regions import Calibrator, calibrator

ERROR_STEP = 0.01
"""Interval between an observer's errors [s]: 1 / RATE of `surefoot.models.observer.decimate`, which
imports pandas; a --help that prints this length need not wait for it.
"""


def errors_needed(how: Calibrator) -> int:
    """Least number of independent errors for a method, including those for `fit`."""
    if not 0.0 <= how.fit_share < 1.0:
        raise ValueError(f"fit_share must be from 0 to below 1, is {how.fit_share}")
    least = how.samples_needed()
    return next(m for m in count(least) if m - int(how.fit_share * m) >= least)


def walk_enough(gamma: float = 0.8, method: str = "conformal") -> float:
    """Seconds of walk with a reference that suffice for the slowest mixing.

    That is with K = LONGEST_LAG; a walk that mixes faster needs less. Raises BoundsError like
    `calibrator`.
    """
    return errors_needed(calibrator(method, gamma)) * LONGEST_LAG * ERROR_STEP
