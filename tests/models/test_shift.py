"""The alarm where a walk is unlike the calibration."""

import numpy as np
from scipy.signal import lfilter
from scipy.stats import binom

from surefoot.models.calibration.shift import (
    UPDATES_OF_BLOCK,
    block_sizes,
    fortune,
    shift_alarm,
)

TRIALS = 1000


def test_false_alarms_are_no_more_than_stated():
    rng = np.random.default_rng(0)
    for chance in (0.05, 0.2):
        raised = sum(
            shift_alarm(x[:40], x[40:], chance) is not None
            for x in rng.lognormal(size=(TRIALS, 120))
        )
        assert raised <= binom.ppf(0.999, TRIALS, chance)


def test_false_alarms_on_innovations_that_remember():
    """Blocks of a second are not quite exchangeable where a sample remembers the one before."""
    rng = np.random.default_rng(1)
    raised = 0
    for _ in range(300):
        noise = rng.standard_normal((100 * UPDATES_OF_BLOCK,))
        squared = np.square(np.asarray(lfilter([1.0], [1.0, -0.95], noise)))
        sizes = block_sizes(squared)
        raised += shift_alarm(sizes[:40], sizes[40:], 0.05) is not None
    assert raised <= binom.ppf(0.999, 300, 0.05)


def test_a_growth_by_half_is_found_within_twenty_seconds():
    rng = np.random.default_rng(2)
    delays = []
    for _ in range(200):
        calibration = block_sizes(rng.standard_normal(61 * UPDATES_OF_BLOCK) ** 2)
        walk = rng.standard_normal(81 * UPDATES_OF_BLOCK) ** 2
        walk[41 * UPDATES_OF_BLOCK :] *= 1.5**2
        at = shift_alarm(calibration, block_sizes(walk))
        assert at is not None
        delays.append(at - 41)
    assert min(delays) > 0
    assert np.median(delays) < 20


def test_smaller_innovations_raise_no_alarm():
    rng = np.random.default_rng(3)
    assert fortune(rng.uniform(1, 2, 50), rng.uniform(0, 1, 500)).max() < 2
