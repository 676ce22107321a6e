"""Attribution on evidence with a known answer: sizes, intervals, masks, rivals and a placebo."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from known_evidence import BINS, KEYS, NOISE, WIDTH, evidence
from numpy.testing import assert_allclose

from surefoot.models.attribution.data import dead_contacts
from surefoot.models.attribution.fit import (
    design,
    fit,
    loss,
    normal_equations,
    overlap,
    total_normal_equations,
)
from surefoot.models.attribution.noise_floor import FloorWalk, NoiseFloor
from surefoot.models.attribution.refinement import contenders
from surefoot.models.attribution.robust_weights import robust_weights, slips
from surefoot.models.attribution.selection import (
    Candidate,
    SearchState,
    distinct,
    evaluate_candidates,
)
from surefoot.models.attribution.settings import DEFAULT
from surefoot.models.bootstrap import block_bootstrap_counts
from surefoot.models.residuals.jacobians import sparse
from surefoot.sim.effects import known_effects
from surefoot.sim.log import Log, Meta
from surefoot.sim.robot.limbs import QUADRUPED

NO_WALKS = NoiseFloor(NOISE, (), "none")


def dense(one):
    X = np.zeros((len(one.t), WIDTH, len(one.X)))
    for i, x in enumerate(one.X):
        X[:, x.columns, i] = x.values
    return X


def with_X(one, X):
    return replace(one, X=tuple(sparse(X[..., i], one.table) for i in range(X.shape[2])))


def whitened(one, floor=NOISE):
    data = design(one)
    believed = robust_weights(data, floor)
    split = np.floor(one.t / 4).astype(int) % 2
    return normal_equations(data, believed.sigma, believed.weight, split)


def judged(one, chosen=(), floor=NO_WALKS, explained=None):
    state = SearchState(chosen, explained or {})
    return evaluate_candidates(
        whitened(one), floor, state, one.layout.limbs, np.random.default_rng(0)
    )


def test_fit_recovers_sizes_and_biases_with_honest_errors():
    truth = np.array([0.01, -0.004, 0.02, 0.003, 1e-3, -2e-3, 1e-3, 0.02, 0.01, -0.02])
    pulls = []
    for seed in range(12):
        one = evidence(truth[:4], truth[4:], seed)
        found = fit(whitened(one), KEYS)
        pulls.append((found.sizes - truth[:4]) / np.sqrt(np.diag(found.covariance)))
        assert_allclose(-found.vector[5:], truth[4:], atol=3e-3)
    assert np.abs(pulls).max() < 5.5
    assert 0.7 < np.std(pulls) < 1.5


def test_a_column_without_excitation_has_no_size_and_no_bound():
    one = evidence()
    X = dense(one)
    X[..., 2] = 0.0
    dead = with_X(one, X)
    found = fit(whitened(dead), KEYS[2:3])
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
        X = dense(one)
        X[..., 1] = rng.normal(size=one.table.shape)
        with_placebo = with_X(one, X)
        best, *others = judged(with_placebo)
        assert best.key == KEYS[0]
        assert not any(c.earned for c in others)
        assert not any(c.earned for c in judged(with_placebo, [KEYS[0]]))


def test_a_few_near_the_best_are_tried_on_the_true_residual():
    one = evidence((3e-3, 0, 0.05, 0))
    found = judged(one)
    tried = contenders(whitened(one), found, ())
    assert tried[0] is found[0]
    assert len(tried) <= DEFAULT.contenders
    assert all(one.earned and one.gain > DEFAULT.near_best_share * tried[0].gain for one in tried)


def test_one_that_explains_more_is_tried_even_where_it_is_not_sure_of_itself():
    """The right one's size varies much on walks that lack it; another with half its pattern is."""
    one = evidence((0.01, 0, 0, 0))
    X = dense(one)
    X[..., 1] = 0.7 * X[..., 0] + 0.7 * X[..., 1]
    alike = with_X(one, X)
    right, other, *_ = sorted(judged(alike), key=lambda c: KEYS.index(c.key))
    unsure = (other, replace(right, earned=False, floor=0.003))
    data = whitened(alike)
    assert [c.key for c in contenders(data, unsure, ())] == [right.key, other.key]
    # No size of its own, no more of the gain, or something else that it explains: not tried.
    for kept in (
        (other, replace(unsure[1], floor=0.01)),
        (replace(other, gain=2 * right.gain), unsure[1]),
    ):
        assert contenders(data, kept, ()) == [kept[0]]
    apart = evidence((0.01, 0.006, 0, 0))
    right, other, *_ = sorted(judged(apart), key=lambda c: KEYS.index(c.key))
    assert right.interval[0] > other.gain
    other = replace(other, earned=True)
    assert contenders(whitened(apart), (other, replace(right, earned=False)), ()) == [other]


def test_what_stands_out_is_worth_its_place_beside_a_far_larger_one():
    small = evidence((5e-3, 0, 0, 0))
    least = judged(small)[0].gain
    shows_in = known_effects()[KEYS[0][0]].channels_of(KEYS[0][1])
    beside = dict.fromkeys(shows_in, 200.0 * least)
    (best, *_) = judged(small, explained=beside)
    assert best.key == KEYS[0]
    assert best.earned
    assert not judged(evidence((8e-4, 0, 0, 0)), explained=beside)[0].earned
    elsewhere = {"joint_rate": 200.0 * least}
    assert judged(evidence((8e-4, 0, 0, 0)), explained=elsewhere)[0].earned


def test_what_the_declared_model_fakes_is_taken_off():
    """Walks without the effect that show it at 2 mrad: 2 mrad are nothing, 10 mrad are 8."""
    walks = []
    for k in (1, 2, 3):
        data = design(evidence((0.002, 0, 0, 0), seed=k))
        believed = robust_weights(data, NOISE)
        sums = total_normal_equations(data, NOISE, believed.weight)
        walks.append(FloorWalk(data.evidence, believed, sums))
    floor = NoiseFloor(NOISE, tuple(walks), "three walks")
    assert not any(c.earned for c in judged(evidence((0.002, 0, 0, 0), seed=7), floor=floor))
    best = judged(evidence((0.010, 0, 0, 0), seed=7), floor=floor)[0]
    assert best.key == KEYS[0]
    assert best.earned
    assert best.size == pytest.approx(0.008, rel=0.1)


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
    masked = robust_weights(design(replace(one, table=table)), NOISE).masked
    assert masked[first, 1].all()
    assert masked.sum() == len(first)
    brief = one.table.copy()
    brief[first[5:7], 9] += 0.05
    slid = design(replace(one, table=brief))
    assert robust_weights(slid, NOISE).masked[first, 1].all(), "a slide of 40 ms in a longer stance"
    biased = one.table.copy()
    biased[:, 9] += 0.2
    assert not robust_weights(design(replace(one, table=biased)), NOISE).masked.any()


def test_a_stance_on_something_else_than_the_others_is_masked_by_its_height():
    one, rng = evidence(), np.random.default_rng(1)
    table = one.table.copy()
    standing = np.isfinite(table[:, 6:18:3])
    heights = one.layout.of("foot_height")
    table[:, heights] = np.where(standing, rng.normal(0.0, 1e-4, standing.shape), np.nan)
    first = np.flatnonzero(standing[:, 1])[:12]
    table[first, heights[1]] += 0.003
    assert not robust_weights(design(replace(one, table=one.table)), NOISE).masked.any()
    masked = robust_weights(design(replace(one, table=table)), NOISE).masked
    assert masked[first, 1].all()
    assert masked.sum() == len(first)
    uneven = table + 0.003 * np.sin(np.arange(BINS) // 12)[:, None] * (np.arange(WIDTH) >= 18)
    assert not robust_weights(design(replace(one, table=uneven)), NOISE).masked.any()


def test_few_stances_are_no_bulk_to_stand_out_from():
    data = design(evidence())
    left = np.full_like(data.evidence.table, np.nan)
    left[:60] = data.evidence.table[:60]
    left[:12, 6] = 1.0
    assert not slips(data, left).any()


def test_overlap_is_the_cosine_of_what_biases_leave():
    one = evidence()
    X = dense(one)
    X[..., 1] = -2.0 * X[..., 0]
    data = whitened(with_X(one, X))
    assert overlap(data, KEYS[0], KEYS[1], ()) == pytest.approx(1.0)
    assert overlap(data, KEYS[0], KEYS[2], ()) < 1e-4


def test_losses_from_block_sums_are_those_of_the_bins():
    """The sums of products give what taking the sizes off bin by bin gives."""
    one = evidence((0.01, 0, 0.02, 0), (1e-3, 0, 0, 0, 0.1, 0))
    data = design(one)
    believed = robust_weights(data, NOISE)
    sums = normal_equations(data, believed.sigma, believed.weight)
    vector = fit(sums, KEYS[:1]).vector
    left = (data.y - data.explained(-vector[1:])) / believed.sigma
    by_bin = np.sum(believed.weight * np.where(data.there, left, 0.0) ** 2, axis=1)
    block = np.floor((one.t - one.t.min()) / 2.0).astype(int)
    assert_allclose(loss(sums, vector), np.bincount(block, by_bin), rtol=1e-9)


def test_a_bias_stays_within_what_is_declared():
    """Beyond its limit a bias is not free: what is left of it is for an effect to explain."""
    one = replace(evidence(bias=(0.02, 0, 0, 0, 0, 0)), limits=np.full(6, 5e-3))
    sums = whitened(one)
    vector = fit(sums, ()).vector
    assert -vector[5] == pytest.approx(5e-3)
    assert loss(sums, vector).sum() > 50 * loss(whitened(evidence()), fit(sums, ()).vector).min()


def test_the_block_bootstrap_has_the_spread_of_block_sums():
    sums = np.array([1.0, 5.0, 9.0])
    drawn = block_bootstrap_counts(3, np.random.default_rng(0), 4000) @ sums
    assert drawn.mean() == pytest.approx(15.0, rel=0.02)
    assert drawn.std() == pytest.approx(np.sqrt(3 * np.var(sums)), rel=0.05)


def test_a_group_and_its_members_are_one_candidate():
    """Of candidates that share parts the one that gains more stays; where the data do not tell them
    apart, the one that says less. Others stay as they are."""
    data, nothing = whitened(evidence()), (0.0, 0.0)

    def candidate(name, target, gain):
        return Candidate((name, target), 1.0, 0.1, 0.1, gain, nothing, 0.5, False, True)

    def kept(*candidates):
        ranked = sorted(candidates, key=lambda c: -c.gain)
        return [c.key for c in distinct(data, ranked, QUADRUPED)]

    friction = [candidate("viscous_friction", t, g) for t, g in (("thigh", 400), ("all", 250))]
    singles = [candidate("viscous_friction", t, 99) for t in ("FL_thigh", "RR_thigh", "RR_calf")]
    other = candidate("armature", "FL_thigh", 300)
    assert kept(*friction, *singles, other) == [
        ("viscous_friction", "thigh"),
        ("armature", "FL_thigh"),
        ("viscous_friction", "RR_calf"),
    ]
    # Only one of the thighs moved: nothing says that the others have it too.
    assert kept(*friction, replace(singles[0], gain=399.5))[0] == ("viscous_friction", "FL_thigh")
    assert kept(*friction, replace(singles[0], gain=500.0))[0] == ("viscous_friction", "FL_thigh")


def test_a_candidate_that_the_data_do_not_show_is_one_candidate():
    """A fixed base whose first axis is vertical: gravity does not show that angle's zero, and the
    size that is fitted to rounding errors is so improbable that a parameter's price is nothing to
    it."""
    unseen = Candidate(
        ("encoder_offset", "FL_hip"), -4e8, 2e8, 0.0, -4e3, (-9e3, 8e2), 0.0, True, False, 2e20
    )
    assert distinct(whitened(evidence()), [unseen], QUADRUPED) == (unseen,)


def test_wheels_that_never_lift_are_no_dead_contacts():
    t = 0.01 * np.arange(500)
    columns = {"t": t, "contact_left": 1.0 + 0.0 * t, "contact_right": 1.0 + 0.0 * t}
    columns |= {f"ref_p_{axis}": goes * t for axis, goes in (("x", 0.5), ("y", 0.0), ("z", 0.0))}
    columns |= {f"ref_q_{axis}": float(axis == "w") + 0.0 * t for axis in "wxyz"}
    for turns, dead in ((0.5, True), (8.0, False)):
        wheels = {f"q_{side}_wheel": turns * t / t[-1] for side in ("left", "right")}
        log = Log(pd.DataFrame(columns | wheels), Meta(100.0), "rolls")
        assert bool(dead_contacts(log)) == dead
