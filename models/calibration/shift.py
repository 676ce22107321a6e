"""Walks unlike the calibration's: an alarm, without a reference.

The alarm is by the filter's innovations. Those of each second have a size. If the walk is like the
calibration's, the rank of a new size among all before it is uniform, and a gambler who bets on
large ones cannot win: the probability that his wealth ever reaches 1 / alpha is at most alpha
(Ville). The bets are those of the "simple jumper" (Vovk, Gammerman and Shafer, Algorithmic Learning
in a Random World, 2nd edition, 2022, section 8.2), on large sizes only.
"""

import numpy as np

UPDATES_OF_BLOCK = 100
"""Updates in a block: 1 s, about two strides, since errors repeat with the stride."""
SETTLING_BLOCKS = 1
"""Blocks at a walk's beginning that are skipped while the filter converges."""
FALSE_ALARM = 0.01
"""Probability of a false alarm in a walk like the calibration's."""
STAKES = np.array([0.0, 1.0, 2.0])
RESTART = 0.01


def block_sizes(squared: np.ndarray) -> np.ndarray:
    """Root mean square (m,) of normalised innovations over whole blocks of `squared` (M,)."""
    m = len(squared) // UPDATES_OF_BLOCK
    blocks = squared[: m * UPDATES_OF_BLOCK].reshape(m, UPDATES_OF_BLOCK)
    return np.sqrt(blocks.mean(axis=1))[SETTLING_BLOCKS:]


def shift_alarm(
    calibration: np.ndarray, seen: np.ndarray, chance: float = FALSE_ALARM
) -> float | None:
    """Monitor block sizes `seen` (m,) as they come, against those of the calibration (n,).

    Returns the time into the walk at which the alarm is raised [s]; None if never. `chance`: that
    of a false alarm in a whole walk; it is exact for exchangeable blocks, which last a second each.
    It is a test of similarity, so a walk may raise it on which the bounds still hold.
    """
    raised = np.flatnonzero(fortune(calibration, seen) >= 1 / chance)
    return float(raised[0] + SETTLING_BLOCKS + 1) if len(raised) else None


def fortune(calibration: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The gambler's wealth (m,): a third each holds, bets a little and bets all, with exchange."""
    n = len(calibration)
    everything = np.concatenate((calibration, seen))
    purse = np.full(STAKES.size, 1 / STAKES.size)
    wealth = np.empty(len(seen))
    for k in range(len(seen)):
        size = everything[n + k]
        p = (np.sum(everything[: n + k] >= size) + 1) / (n + k + 1)
        purse = (1 - RESTART) * purse + RESTART * purse.mean()
        purse = purse * (1 + STAKES * (0.5 - p))
        wealth[k] = purse.sum()
    return wealth
