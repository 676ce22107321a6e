"""A measured reference: when its samples were, and how much they err."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from surefoot.models.attribution.sensor_noise import (
    ReferenceSampling,
    reference_notes,
    reference_sampling,
    resample_reference,
)


def test_a_reference_with_a_sample_a_row_is_not_coarse(log):
    assert reference_sampling(log) is None


def test_samples_and_their_noise_are_found_again(log):
    rng = np.random.default_rng(0)
    intervals = tuple(rng.choice([0.0083, 0.0167, 0.025], 1000))
    true = ReferenceSampling(intervals, 0.8e-3, 1.5e-3, 2e-3)
    found = reference_sampling(resample_reference(log, true, rng))
    assert found is not None
    seen = np.sum(np.cumsum(intervals) < log.t[-1] - log.t[0])
    assert len(found.intervals) == pytest.approx(seen, rel=0.01)
    assert_allclose(np.median(found.intervals), np.median(intervals), atol=1e-6)
    assert found.stamp == pytest.approx(true.stamp, rel=0.25)
    assert found.angle == pytest.approx(true.angle, rel=0.25)
    assert found.position == pytest.approx(true.position, rel=0.25)


def test_without_an_imu_only_the_samples_are_known(log):
    rng = np.random.default_rng(1)
    resampled = resample_reference(log, ReferenceSampling((0.02,) * 50, 1e-3, 1e-3), rng)
    names = [n for n in resampled.frame if str(n).startswith(("gyro_", "accel_"))]
    bare = type(resampled)(resampled.frame.drop(columns=names), resampled.meta, resampled.name)
    found = reference_sampling(bare)
    assert found is not None
    assert (found.position, found.angle) == (0.0, 0.0)


def test_a_reference_without_error_keeps_the_motion(log):
    seen = resample_reference(log, ReferenceSampling((0.01,), 0.0, 0.0), np.random.default_rng(2))
    assert_allclose(seen.ref_p, log.ref_p, atol=5e-4)
    assert_allclose(seen.ref_R_GI, log.ref_R_GI, atol=4e-3)


def test_a_reference_with_a_noisy_sample_a_row_is_seen_by_the_floor(log):
    """As motion capture logged with an IMU is; a simulated one, with velocities, is not."""
    slow = log.rows(slice(None, None, 5))
    noisy = resample_reference(
        slow, ReferenceSampling((), 0.6e-3, 1e-3, 1e-3), np.random.default_rng(3)
    )
    names = [n for n in noisy.frame if str(n).startswith("ref_v")]
    measured = type(noisy)(noisy.frame.drop(columns=names), noisy.meta, noisy.name)
    found = reference_sampling(measured)
    assert found is not None
    assert found.intervals == ()
    assert found.position == pytest.approx(0.6e-3, rel=0.35)
    assert reference_sampling(noisy) is None
    assert any("included in the noise floor" in note for note in reference_notes(measured))
    assert reference_notes(noisy) == ()
