"""Ego velocity from Doppler: the truth under outliers, and a covariance that means what it says."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from scipy.stats import chi2

from surefoot.estimator.ego_velocity import _ego_velocity, _solve, ego_velocities


def ego_velocity(direction, doppler, noise, angle_noise=(0.0, 0.0)):
    """Velocity, covariance and mask of the inliers of one frame, or None."""
    noises = np.array([noise, *angle_noise])
    v, cov, inlier = np.empty(3), np.empty((3, 3)), np.empty(len(direction), dtype=np.bool_)
    found = _ego_velocity(direction, doppler, noises, v, cov, inlier)
    return (v, cov, inlier) if found else None


def directions(azimuth, elevation):
    flat = np.cos(elevation)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def frame(rng, v, count=60, noise=0.03, outliers=0.0):
    """Directions in a field of view of 120 x 40 degrees, Dopplers, and which are true."""
    u = directions(rng.uniform(-1.05, 1.05, count), rng.uniform(-0.35, 0.35, count))
    d = -u @ v + noise * rng.standard_normal(count)
    ghost = rng.random(count) < outliers
    d[ghost] = rng.uniform(-3.0, 3.0, ghost.sum())
    return u, d, ~ghost


def test_perfect_dopplers_give_the_velocity():
    rng = np.random.default_rng(0)
    for _ in range(50):
        v = rng.normal(size=3)
        u, d, _ = frame(rng, v, noise=0.0)
        found = ego_velocity(u, d, 0.01)
        assert found is not None
        assert_allclose(found[0], v, atol=1e-12)


@pytest.mark.parametrize(("share", "told"), [(0.3, 300), (0.5, 270)])
def test_the_truth_is_found_among_outliers(share, told):
    """No frame that says anything is led astray, at half of it ghosts too; plain squares are."""
    rng = np.random.default_rng(1)
    errors, plain, wrong = [], [], 0
    for _ in range(300):
        v = rng.normal(size=3)
        u, d, true = frame(rng, v, outliers=share)
        plain.append(np.linalg.lstsq(-u, d, rcond=None)[0] - v)
        found = ego_velocity(u, d, 0.03)
        if found is not None:
            errors.append(found[0] - v)
            wrong += np.sum(found[2] & ~true & (np.abs(d + u @ v) > 0.15))
    assert len(errors) >= told
    assert np.abs(errors).max() < 0.25
    assert wrong == 0
    assert np.std(plain) > 10 * np.std(errors)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_the_covariance_is_consistent(share):
    """The sum of n chi-square(3) numbers stays between its 0.1 % points."""
    rng, n = np.random.default_rng(2), 1000
    total = 0.0
    for _ in range(n):
        v = rng.normal(size=3)
        u, d, _ = frame(rng, v, outliers=share)
        found = ego_velocity(u, d, 0.03)
        assert found is not None
        e = found[0] - v
        total += e @ np.linalg.solve(found[1], e)
    low, high = chi2.ppf([0.001, 0.999], 3 * n)
    # A ghost can hide among inliers: where there are some, only optimism within 20 % is granted.
    assert 0.9 * low < total < high * (1.2 if share else 1.0)


def test_errors_of_directions_are_taken_off():
    """Elevations out by 5.8 degrees pull plain squares to one side; compensated, a third."""
    rng, angles = np.random.default_rng(5), np.radians([1.9, 5.8])
    plain, better, v = [], [], np.array([1.0, 0.1, 0.0])
    for _ in range(1500):
        azimuth, elevation = rng.uniform(-1.0, 1.0, 40), rng.uniform(-1.0, -0.1, 40)
        u = directions(azimuth, elevation)
        d = -u @ v + 0.03 * rng.standard_normal(40)
        seen = directions(
            azimuth + angles[0] * rng.standard_normal(40),
            elevation + angles[1] * rng.standard_normal(40),
        )
        for found, angle_noise in ((plain, (0.0, 0.0)), (better, (angles[0], angles[1]))):
            result = ego_velocity(seen, d, 0.06, angle_noise)
            assert result is not None
            found.append(result[0] - v)
    bias, left = np.abs(np.mean(plain, axis=0)), np.abs(np.mean(better, axis=0))
    assert bias[2] > 0.02
    assert left.max() < bias.max() / 3


def test_a_frame_that_does_not_tell_gives_nothing():
    rng = np.random.default_rng(3)
    u, d, _ = frame(rng, np.ones(3))
    assert ego_velocity(u[:5], d[:5], 0.03) is None
    flat = u * [1, 1, 0]
    flat /= np.linalg.norm(flat, axis=1)[:, None]
    assert ego_velocity(flat, -flat @ np.ones(3), 0.03) is None
    assert ego_velocity(np.tile(u[0], (30, 1)), np.tile(d[0], 30), 0.03) is None
    assert ego_velocity(u[:8], rng.uniform(-4, 4, 8), 1e-3) is None


@pytest.mark.parametrize(("determinant", "told"), [(0.95e-9, False), (1.05e-9, True)])
def test_an_axis_is_told_by_a_few_billionths_of_the_weight(determinant, told):
    """Three returns along the axes: their shares of the weight multiply to the determinant."""
    v, u = np.array([1.0, -2.0, 3.0]), np.eye(3)
    share = 4.0 * determinant
    weight = np.array([0.5 * (1.0 - share), 0.5 * (1.0 - share), share])
    for order in ([0, 1, 2], [0, 2, 1], [2, 0, 1]):
        found, cov = np.empty(3), np.empty((3, 3))
        assert _solve(u, -u @ v, weight[order], np.zeros(3), found, cov) == told
        if told:
            assert_allclose(found, v, rtol=1e-7)


def test_frames_in_one_loop_are_frames_one_by_one():
    rng = np.random.default_rng(4)
    counts = [40, 0, 4, 60, 25]
    parts = [frame(rng, rng.normal(size=3), count, outliers=0.2) for count in counts]
    index = np.repeat(np.arange(5), counts)
    u, d = (np.concatenate([p[k] for p in parts]) for k in (0, 1))
    rows, velocities, covariances = ego_velocities(index, u, d, 5, 0.03)
    assert rows.tolist() == [0, 3, 4]
    for k, v, cov in zip(rows, velocities, covariances, strict=True):
        one = ego_velocity(parts[k][0], parts[k][1], 0.03)
        assert one is not None
        assert np.array_equal(one[0], v)
        assert np.array_equal(one[1], cov)


def test_bad_input_is_one_clear_line():
    frames, u, d = np.zeros(4), np.ones((4, 3)), np.ones(4)
    refused("direction: shape", ego_velocities, frames, u[:, :2], d, 1, 0.03)
    refused("doppler: shape", ego_velocities, frames, u, d[:3], 1, 0.03)
    refused("noise", ego_velocities, frames, u, d, 1, 0.0)
    refused("noise: inf", ego_velocities, frames, u, d, 1, np.inf)
    refused("angle_noise", ego_velocities, frames, u, d, 1, 0.1, (0.0, -0.1))
