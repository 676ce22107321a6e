"""Error of a model as unchanged runs show it: recovered from draws, and against an obvious form."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pendulum import swung

from surefoot.models.attribution.diagnose import logs_under_model
from surefoot.models.attribution.evidence import all_keys, linearise, log_under_model
from surefoot.models.attribution.model_error import (
    MEAN_WINDOW,
    ModelError,
    RunSums,
    against_unchanged,
    at_middles,
    evidence_of,
    model_error,
    model_error_as_dict,
    model_error_from_dict,
    own_precision,
    run_sums,
    window_weights,
)
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.effects import effect
from surefoot.sim.effects.base import with_columns
from surefoot.sim.robot.machine import load_machine

PENDULUM = load_machine("ak80_pendulum")
LIMBS = PENDULUM.limbs
KEYS = (("armature", "shoulder"), ("viscous_friction", "shoulder"), ("encoder_offset", "shoulder"))
GROUPS = (("joint_torque", "one"), ("joint_torque", "two"))


def rows_of(rng, deviation, noise, rows=40):
    """Rows (G, N, 1 + P) of a run whose sizes differ from (0.5, -0.2) by a deviation."""
    X = rng.normal(size=(2, rows, 3)) * (1.0, 3.0, 2.0)
    sizes = np.array([0.5, -0.2, 0.0]) + np.append(rng.normal(size=2) * deviation, 0.02)
    y = X @ sizes + rng.normal(size=(2, rows)) * np.array(noise)[:, None]
    return np.concatenate([y[..., None], X], axis=2)


def sums_of(rows, keys=KEYS):
    return RunSums(
        keys=keys,
        groups=GROUPS,
        sums=np.stack([A.T @ A for A in rows]),
        count=np.array([len(A) for A in rows], float),
        nuisance=np.zeros(0),
        rates={"shoulder": 0.1},
    )


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(0)
    return [rows_of(rng, (0.1, 0.1 / 3.0), (0.3, 0.05)) for _ in range(30)]


@pytest.fixture(scope="module")
def known(drawn):
    found = model_error([sums_of(rows) for rows in drawn], LIMBS)
    assert found is not None
    return found


def test_sizes_noise_and_their_spread_between_runs_are_recovered(known):
    assert known.keys == KEYS[:2]
    assert known.mean == pytest.approx([0.5, -0.2], abs=0.05)
    assert np.sqrt(np.diag(known.covariance)) == pytest.approx([0.1, 0.1 / 3.0], rel=0.25)
    assert list(known.noise.values()) == pytest.approx([0.3, 0.05], rel=0.05)


def test_what_differs_between_runs_in_one_channel_does_not_in_another():
    """Sizes that torques show differ by 0.1 from run to run; those that commands show are alike."""
    rng, runs = np.random.default_rng(2), []
    for _ in range(30):
        X = np.zeros((2, 40, 2))
        X[0, :, 0], X[1, :, 1] = rng.normal(size=(2, 40))
        y = X @ [0.5 + 0.1 * rng.normal(), -0.2] + rng.normal(size=(2, 40)) * [[0.3], [0.05]]
        rows = np.concatenate([y[..., None], X], axis=2)
        groups = (("joint_torque", "one"), ("command", "one"))
        runs.append(replace(sums_of(rows, KEYS[:2]), groups=groups))
    found = model_error(runs, LIMBS)
    assert found is not None
    differs, alike = np.sqrt(np.diag(found.covariance))
    assert differs == pytest.approx(0.1, rel=0.25)
    # By noise, thirty runs tell a common size to 0.0015.
    assert alike < 0.005


def test_a_new_run_is_compared_with_the_covariance_of_an_unchanged_one(drawn, known):
    """The same from the covariance of all rows, which is never formed."""
    rows, run = drawn[0], sums_of(drawn[0])
    noise = np.concatenate(
        [np.full(len(A), known.noise[g]) for A, g in zip(rows, GROUPS, strict=True)]
    )
    A = np.vstack(rows)
    y, X, Z = A[:, 0], A[:, 1:3], A[:, 3:]
    V = np.diag(noise**2) + X @ known.covariance @ X.T + Z @ Z.T / own_precision(run, LIMBS)
    columns = np.column_stack([y - X @ known.mean, A[:, 1:]])
    expected = columns.T @ np.linalg.solve(V, columns)
    assert against_unchanged(run, known, LIMBS) == pytest.approx(expected, rel=1e-8)


def test_sizes_of_a_new_run_are_as_uncertain_as_said(known):
    rng = np.random.default_rng(1)
    z = []
    for _ in range(300):
        S = against_unchanged(sums_of(rows_of(rng, (0.1, 0.1 / 3.0), (0.3, 0.05))), known, LIMBS)
        z.append(S[0, 1:3] / np.sqrt(np.diag(S)[1:3]))
    # 300 draws of unit variance have one within 0.82 to 1.18 with 95 %.
    assert np.mean(np.square(z), axis=0) == pytest.approx([1.0, 1.0], abs=0.25)


@pytest.mark.parametrize("name", ["clock_scale", "reference_delay"])
def test_a_run_has_clocks_of_its_own_as_it_has_zeros(drawn, known, name):
    """They differ from run to run, and are neither an error of the model nor a change."""
    keys = (*KEYS[:2], (name, "imu"))
    found = model_error([sums_of(rows, keys) for rows in drawn], LIMBS)
    assert found is not None
    assert found.keys == known.keys
    assert found.mean == pytest.approx(known.mean, abs=0.02)


def test_few_runs_and_different_candidates_have_no_error_of_the_model(drawn):
    runs = [sums_of(rows) for rows in drawn[:4]]
    assert model_error(runs[:2], LIMBS) is None
    assert model_error([*runs[:3], replace(runs[3], keys=KEYS[::-1])], LIMBS) is None
    assert model_error([*runs[:3], runs[3].of_groups(())], LIMBS) is None


def test_runs_are_compared_by_the_columns_that_all_of_them_have(drawn):
    """One of several runs may lack a column: the heights of feet on a walk that was not level."""
    runs = [sums_of(rows) for rows in drawn[:6]]
    cases = {
        "whole": runs,
        "turned": [*runs[:5], runs[5].of_groups(GROUPS[::-1])],
        "lacking": [*runs[:5], runs[5].of_groups(GROUPS[1:])],
        "reduced": [one.of_groups(GROUPS[1:]) for one in runs],
    }
    found = {name: model_error(each, LIMBS) for name, each in cases.items()}
    means = {name: one.mean for name, one in found.items() if one is not None}
    np.testing.assert_array_equal(means["turned"], means["whole"])
    np.testing.assert_array_equal(means["lacking"], means["reduced"])


def test_it_is_the_same_after_json(known):
    said = json.loads(json.dumps(model_error_as_dict(known)))
    again = model_error_from_dict(said)
    assert isinstance(again, ModelError)
    assert again.keys == known.keys
    assert np.array_equal(again.covariance, known.covariance)
    assert (again.noise, again.rates) == (known.noise, known.rates)
    for damage in ({"covariance": [[-1.0], [0.0, 1.0]]}, {"noise": [{}]}, {"terms": 3}):
        with pytest.raises((KeyError, TypeError, ValueError)):
            model_error_from_dict(said | damage)


def test_windows_are_zero_at_their_ends_and_none_is_over_a_gap():
    t = np.arange(0.0, 4.0, 0.02)
    whole = window_weights(t)
    assert whole.sum(axis=1) == pytest.approx(np.ones(len(whole)))
    middles = whole @ t
    assert np.diff(middles) == pytest.approx(np.full(len(middles) - 1, 0.5 * MEAN_WINDOW), abs=2e-3)
    assert not whole[:, 0].any()
    assert not whole[:, -1].any()
    gap = t[(t < 1.5) | (t > 2.0)]
    over = window_weights(gap)
    assert all(
        np.ptp(gap[w > 0.0]) < MEAN_WINDOW and np.diff(gap[w > 0.0]).max() < 0.03 for w in over
    )


def test_means_over_windows_hardly_depend_on_noise_of_the_angles():
    """It is that of accelerations, and so of the torques of single bins."""
    plain = swung(seed=1, seconds=8.0)
    noise = np.random.default_rng(0).normal(0.0, 0.005, len(plain.t))
    noisy = with_columns(plain, {"q_shoulder": plain.q[:, 0] + noise})
    bins, windows = [], []
    for log in (plain, noisy):
        case = log_under_model(log, PENDULUM)
        table = linearise([case], (), ()).table
        bins.append(table[:, layout_for(LIMBS).of("joint_torque")[0]])
        windows.append(evidence_of([case])[0].table[:, layout_for(LIMBS).of("joint_torque")[0]])
    of_bins, of_windows = (np.nanstd(b - a) for a, b in (bins, windows))
    assert of_windows < 0.1 * of_bins


def test_a_runs_sums_have_the_rows_of_its_torques_alone():
    run = run_sums(log_under_model(swung(seed=1, seconds=8.0), PENDULUM))
    assert {channel for channel, _ in run.groups} == {"joint_torque"}
    assert run.rates["shoulder"] < 0.1
    assert run.sums.shape == (len(run.groups), *((1 + len(run.keys)),) * 2)


def test_a_joint_without_a_drive_has_no_torque_that_errs_and_may_have_friction():
    log = swung(seconds=3.0)
    passive = with_columns(log, {"tau_shoulder": 0.0 * log.t})
    friction = effect("coulomb_friction", "shoulder", 0.2)
    for declared in ((), (friction,)):
        (case,) = logs_under_model([passive], PENDULUM, declared)
        assert case.undriven == ("shoulder",)
        assert not {("torque_bias", "shoulder"), ("leg_compliance", "shoulder")} & {*all_keys(case)}
        assert ("angle_error", "shoulder drift") in evidence_of([case])[0].keys
    (driven,) = logs_under_model([log], PENDULUM, ())
    assert ("torque_bias", "shoulder") in all_keys(driven)


def test_means_over_windows_stand_at_their_middles():
    """Of each log, over the values that a column has."""
    cases = [log_under_model(swung(seed=k, seconds=3.0), PENDULUM) for k in range(2)]
    known = linearise(cases, (), KEYS)
    known.table[20:25, 0] = np.nan
    placed = at_middles(known)
    for log in range(2):
        own = known.log == log
        weights = window_weights(known.t[own])
        here = np.flatnonzero(own & np.isfinite(placed.table).any(axis=1))
        assert np.abs(known.t[here] - weights @ known.t[own]).max() < 0.021
        values = [known.table[own, 0], *(one.values[own, 0] for one in known.X)]
        means = [placed.table[here, 0], *(one.values[here, 0] for one in placed.X)]
        there = np.isfinite(values[0])
        for x, mean in zip(values, means, strict=True):
            each = [np.average(x[there], weights=w[there]) for w in weights]
            np.testing.assert_allclose(mean, each, rtol=1e-12)
        for one in placed.X:
            assert not np.delete(one.values[own], here - np.flatnonzero(own)[0], axis=0).any()


def test_runs_without_torques_tell_no_error():
    runs = []
    for k in range(3):
        log = swung(seed=k, seconds=3.0)
        frame = log.frame.drop(columns="tau_shoulder")
        runs.append(run_sums(log_under_model(replace(log, frame=frame), PENDULUM)))
    assert model_error(runs, LIMBS) is None
