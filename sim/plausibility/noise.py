"""Noise of a stream from row to row."""

from collections.abc import Iterator, Sequence

import numpy as np

from surefoot.sim.plausibility.finding import Finding


def noise_of(x: np.ndarray, names: Sequence[str], most: float, unit: str) -> Iterator[Finding]:
    """Find the columns of x (N, D), by name, with more than `most` noise (in that unit) from row to
    row.
    """
    # Third differences of white noise have 20 times its variance; the median ignores impacts.
    rough = np.median(np.abs(np.diff(x, n=3, axis=0)), axis=0) / 0.6745 / np.sqrt(20.0)
    if (noisy := np.flatnonzero(rough > most)).size:
        told = f"{rough[noisy].max():.2f} {unit} from row to row"
        cause = "a broken sensor, a drive that chatters, or readings of several samples mixed up"
        yield Finding(tuple(names[i] for i in noisy.tolist()), told, cause)
