"""How long a walk a calibration takes."""

from itertools import count

from surefoot.models.calibration.mixing import LONGEST_LAG
from surefoot.models.calibration.regions import Calibrator, calibrator

ERROR_STEP = 0.01
"""s between an observer's errors: 1 / RATE of `surefoot.models.observer.decimate`, which brings
pandas; a --help that says this length is not to wait for it."""


def errors_needed(how: Calibrator) -> int:
    """Least number of independent errors that a method takes, those it is fitted to with them."""
    least = how.samples_needed()
    return next(m for m in count(least) if m - int(how.fit_share * m) >= least)


def walk_enough(gamma: float = 0.8, method: str = "conformal") -> float:
    """Seconds of walk with a reference that suffice even where errors forget most slowly.

    That is with K = LONGEST_LAG; one that mixes sooner needs less. Raises BoundsError as
    `calibrator` does.
    """
    return errors_needed(calibrator(method, gamma)) * LONGEST_LAG * ERROR_STEP
