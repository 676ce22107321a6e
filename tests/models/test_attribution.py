"""Attribution on evidence with a known answer: sizes, intervals, masks, rivals and a placebo."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from models.attribution import Split, judge
from models.candidates import Evidence
from models.fitting import Whitened, by_block, fit, overlap, resampled, whiten
from models.floor import Floor
from models.masking import slips, trust

KEYS = (
    ("encoder_offset", "FL_hip"),
    ("encoder_offset", "FL_thigh"),
    ("gyro_scale", "x"),
    ("joint_delay", "all"),
)
BINS = 1500
NOISE = np.repeat([5e-4, 1e-2, 2e-3], [3, 3, 12])
NO_WALKS = Floor(NOISE, (), (), "none")


def evidence(sizes=(0, 0, 0, 0), bias=(0, 0, 0, 0, 0, 0), seed=0, noise=NOISE):
    """Smooth random regressors on the columns that effects touch; feet stand half the time."""
    rng = np.random.default_rng(seed)
    t = 0.01 + 0.02 * np.arange(BINS)
    X = np.zeros((BINS, 18, len(KEYS)))
    waves = np.sin(
        2 * np.pi * rng.uniform(0.3, 4, (18, 4)) * t[:, None, None] + rng.uniform(0, 6, (18, 4))
    )
    X[:, 6:9, 0], X[:, 6:9, 1] = waves[:, 6:9, 0], waves[:, 6:9, 1]
    X[:, 0, 2] = 0.4 * waves[:, 0, 2]
    X[:, 6:, 3] = 3.0 * waves[:, 6:, 3]
    Z = np.zeros((BINS, 18, 6))
    Z[:, range(6), range(6)] = 1.0
    Z[:, 6:, :3] = 0.3
    table = X @ np.asarray(sizes, float) + Z @ np.asarray(bias, float)
    table += rng.normal(size=table.shape) * noise
    standing = (np.arange(BINS)[:, None] // 12 + np.array([0, 1, 1, 0])) % 2 == 0
    missing = np.repeat(~standing, 3, axis=1)
    table[:, 6:][missing] = np.nan
    X[:, 6:][missing] = 0.0
    Z[:, 6:][missing] = 0.0
    return Evidence(t, np.zeros(BINS, int), table, KEYS, X, Z)


def halves(one):
    block = np.floor(one.t / 4).astype(int)
    return Split(block % 2 == 0, block % 2 == 1, np.zeros(len(one.t), bool))


def judged(one, chosen=(), floor=NO_WALKS, explained=0.0):
    data = whiten(one, trust(one, NOISE))
    return judge(data, floor, halves(one), chosen, explained, np.random.default_rng(0))


def test_fit_recovers_sizes_and_biases_with_honest_errors():
    truth = np.array([0.01, -0.004, 0.02, 0.003, 1e-3, -2e-3, 1e-3, 0.02, 0.01, -0.02])
    pulls = []
    for seed in range(12):
        one = evidence(truth[:4], truth[4:], seed)
        found = fit(whiten(one, trust(one, NOISE)), KEYS)
        pulls.append((found.sizes - truth) / np.sqrt(np.diag(found.covariance)))
    assert np.abs(pulls).max() < 5.5
    assert 0.7 < np.std(pulls) < 1.5


def test_a_column_without_excitation_has_no_size_and_no_bound():
    one = evidence()
    X = one.X.copy()
    X[..., 2] = 0.0
    dead = Evidence(one.t, one.log, one.table, KEYS, X, one.Z)
    found = fit(whiten(dead, trust(dead, NOISE)), KEYS[2:3])
    assert found.sizes[0] == 0.0
    assert np.isinf(found.covariance[0, 0])
    assert not any(c.earned for c in judged(dead) if c.key == KEYS[2])


@pytest.mark.parametrize(("which", "size"), [(0, 0.004), (2, 0.005), (3, 0.001)])
def test_the_right_candidate_comes_first(which, size):
    sizes = np.zeros(4)
    sizes[which] = size
    best, *others = judged(evidence(sizes, bias=(1e-3, 0, 0, 0.02, 0, 0), seed=which))
    assert best.key == KEYS[which]
    assert best.earned
    assert best.size == pytest.approx(size, rel=0.1)
    assert not any(c.earned for c in others)


def test_noise_and_turn_on_biases_earn_nothing():
    for seed in range(10):
        one = evidence(bias=(2e-3, -2e-3, 1e-3, 0.05, 0.05, -0.05), seed=seed)
        assert not any(c.earned for c in judged(one))


def test_a_placebo_earns_nothing_beside_the_truth():
    """A regressor of pure noise, scaled up so that its size is large, never enters the model."""
    rng = np.random.default_rng(3)
    for seed in range(5):
        one = evidence((0.004, 0, 0, 0), seed=seed)
        X = one.X.copy()
        X[..., 1] = np.where(np.isfinite(one.table), rng.normal(size=one.table.shape), 0.0)
        with_placebo = Evidence(one.t, one.log, one.table, KEYS, X, one.Z)
        best, *others = judged(with_placebo)
        assert best.key == KEYS[0]
        assert not any(c.earned for c in others)
        assert not any(c.earned for c in judged(with_placebo, [KEYS[0]]))


def test_what_the_declared_model_fakes_is_taken_off():
    """Walks without the effect that show it at 2 mrad: 2 mrad are nothing, 8 mrad are 6."""
    walks = tuple(
        whiten(e, trust(e, NOISE)) for e in (evidence((0.002, 0, 0, 0), seed=k) for k in (1, 2, 3))
    )
    floor = Floor(NOISE, walks, (), "three walks")
    assert not any(c.earned for c in judged(evidence((0.002, 0, 0, 0), seed=7), floor=floor))
    best = judged(evidence((0.008, 0, 0, 0), seed=7), floor=floor)[0]
    assert best.key == KEYS[0]
    assert best.earned
    assert best.size == pytest.approx(0.006, rel=0.1)


def test_a_size_beyond_the_bounds_fails():
    bounded = judged(evidence((0, 0, 0.5, 0)))
    assert all(not c.earned for c in bounded if c.key == KEYS[2])
    assert next(c for c in bounded if c.key == KEYS[2]).at_bound


def test_a_slipping_stance_is_masked_and_a_systematic_error_is_not():
    one = evidence((0.01, 0, 0, 0))
    table = one.table.copy()
    standing = np.isfinite(table[:, 9])
    first = np.flatnonzero(standing)[60:72]
    table[first, 9] += 0.2
    hurt = Evidence(one.t, one.log, table, KEYS, one.X, one.Z)
    masked = trust(hurt, NOISE).masked
    assert masked[first, 1].all()
    assert masked.sum() == len(first)
    brief = one.table.copy()
    brief[first[5:7], 9] += 0.05
    slid = Evidence(one.t, one.log, brief, KEYS, one.X, one.Z)
    assert trust(slid, NOISE).masked[first, 1].all(), "a slide of 40 ms in a longer stance"
    biased = one.table.copy()
    biased[:, 9] += 0.2
    whole = Evidence(one.t, one.log, biased, KEYS, one.X, one.Z)
    assert not trust(whole, NOISE).masked.any()


def test_few_stances_are_no_bulk_to_stand_out_from():
    one = evidence().rows(np.arange(60))
    left = one.table.copy()
    left[:12, 6] = 1.0
    assert not slips(one, left, NOISE).any()


def test_overlap_is_the_cosine_of_what_biases_leave():
    one = evidence()
    X = one.X.copy()
    X[..., 1] = -2.0 * X[..., 0]
    data = whiten(Evidence(one.t, one.log, one.table, KEYS, X, one.Z), trust(one, NOISE))
    assert overlap(data, KEYS[0], KEYS[1], ()) == pytest.approx(1.0)
    assert overlap(data, KEYS[0], KEYS[2], ()) < 1e-4


def test_block_sums_and_their_bootstrap():
    data = Whitened(
        np.zeros((6, 18)), np.zeros((6, 18, 6)), np.ones((6, 18)), (), np.array([0, 0, 1, 1, 4, 4])
    )
    sums = by_block(data, np.arange(6.0))
    assert_allclose(sums, [1.0, 5.0, 9.0])
    drawn = resampled(sums, np.random.default_rng(0), draws=4000)
    assert drawn.mean() == pytest.approx(15.0, rel=0.02)
    assert drawn.std() == pytest.approx(np.sqrt(3 * np.var(sums)), rel=0.05)
