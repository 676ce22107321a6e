"""Slerp, recursions and derivatives against scipy and exact values."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from surefoot.sim.common.quaternion import slerp
from surefoot.sim.common.series import recursion, white_noise
from surefoot.sim.log import (
    Log,
    Meta,
    joint_velocity,
    reference_velocity,
    with_velocities,
)
from surefoot.sim.log.derived import derivative


@pytest.mark.parametrize("turn", [0.0, 1e-9, 1e-4, 0.3, 2.5])
def test_slerp_turns_evenly_the_short_way_round(turn):
    rng = np.random.default_rng(1)
    steps = Rotation.from_rotvec(turn * rng.uniform(-0.7, 0.7, (200, 3)))
    attitudes = [Rotation.identity()]
    for step in steps:
        attitudes.append(attitudes[-1] * step)
    rotations = Rotation.concatenate(attitudes)
    t = np.cumsum(rng.uniform(0.5, 2.0, len(rotations)))
    # Signs as a recording may have them, and rows themselves among the times.
    q = rotations.as_quat(scalar_first=True) * rng.choice([-1.0, 1.0], (len(t), 1))
    share = np.append(rng.uniform(size=198), [0.0, 1.0])
    found = slerp(t, q, t[:-1] + share * np.diff(t))
    wanted = rotations[:-1] * Rotation.from_rotvec(share[:, None] * steps.as_rotvec())
    apart = wanted.inv() * Rotation.from_quat(found, scalar_first=True)
    assert_allclose(apart.magnitude(), 0.0, atol=1e-13)
    assert np.all(found[:, 0] >= 0.0)


def test_a_recursion_in_two_pieces_is_that_of_scipy():
    x = np.random.default_rng(0).normal(size=(50, 3))
    expected = lfilter([0.3], [1.0, -0.7], x, axis=0)
    first, state = recursion(x[:20], 0.3, 0.7, np.zeros(3))
    second, _ = recursion(x[20:], 0.3, 0.7, state)
    assert_array_equal(np.concatenate([first, second]), expected)


def test_white_noise_is_told_from_slow_motion():
    rng = np.random.default_rng(7)
    t = np.arange(20_000) / 500.0
    noise = rng.normal(0.0, [0.01, 0.2], (len(t), 2))
    found = white_noise(np.sin(2.0 * t)[:, None] + noise)
    assert_allclose(found, [0.01, 0.2], rtol=0.03)


def uneven(rng: np.random.Generator, n: int) -> np.ndarray:
    return 1e3 + np.cumsum(rng.uniform(0.001, 0.004, n))


@pytest.mark.parametrize("causal", [False, True])
def test_quadratics_are_exact_on_uneven_stamps(causal):
    rng = np.random.default_rng(0)
    t = uneven(rng, 200)
    a, b, c = rng.normal(size=(3, 5))
    s = (t - t[0])[:, None]
    found = derivative(t, a + b * s + c * s**2, 0.025, causal)
    first = 2 if causal else 0  # a quadratic needs three rows of past
    np.testing.assert_allclose(found[first:], (b + 2 * c * s)[first:], atol=1e-8)


def test_a_causal_derivative_does_not_look_ahead():
    rng = np.random.default_rng(1)
    t = uneven(rng, 100)
    x = rng.normal(size=(100, 2))
    changed = x.copy()
    changed[60:] += 1.0
    now = derivative(t, x, 0.025, causal=True)
    np.testing.assert_array_equal(now[:60], derivative(t, changed, 0.025, causal=True)[:60])
    assert np.abs(now[60:] - derivative(t, changed, 0.025, causal=True)[60:]).max() > 1.0
    assert (now[0] == 0.0).all()


def test_the_symmetric_derivative_has_no_phase():
    t = np.arange(2000) / 500.0
    x = np.sin(2 * np.pi * 5.0 * t)[:, None]
    found = derivative(t, x, 0.025, causal=False)[100:-100, 0]
    true = np.cos(2 * np.pi * 5.0 * t)[100:-100]
    quadrature = np.sin(2 * np.pi * 5.0 * t)[100:-100]
    assert abs(found @ quadrature) < 1e-9 * (found @ true)
    gain = (found @ true) / (true @ true) / (2 * np.pi * 5.0)
    assert 0.97 < gain < 1.0


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize("causal", [False, True])
def test_short_logs_are_finite(n, causal):
    found = derivative(np.arange(n) / 100.0, np.ones((n, 1)), 0.025, causal)
    np.testing.assert_allclose(found, 0.0, atol=1e-9)


@pytest.mark.parametrize("causal", [False, True])
def test_a_day_without_rows_is_no_division_by_zero(causal):
    t = np.arange(40) / 500.0
    x = np.sin(7.0 * t)[:, None]
    found = derivative(t + 8.6e4 * (t > 0.04), x, 0.025, causal)
    assert np.abs(found).max() < 7.1


def test_velocities_are_logged_ones_first_and_marked_when_derived():
    t = np.arange(100) / 400.0
    columns = {"t": t, "q_knee": t**2}
    columns |= {f"ref_p_{axis}": 2.0 * t for axis in "xyz"}
    columns |= {f"ref_q_{axis}": np.full(100, float(axis == "w")) for axis in "wxyz"}
    log = Log(pd.DataFrame(columns), Meta(400.0))
    np.testing.assert_allclose(joint_velocity(log)[:, 0], 2 * t, atol=1e-9)
    np.testing.assert_allclose(reference_velocity(log), 2.0, atol=1e-9)
    filled = with_velocities(log, causal=True)
    assert filled.meta.derived == ("dq (causal)", "ref_v (causal)")
    assert filled.has("dq")
    assert filled.has("ref_v")
    assert with_velocities(filled).meta == filled.meta
    measured = Log(log.frame.assign(dq_knee=7.0), log.meta)
    np.testing.assert_array_equal(joint_velocity(measured), 7.0)
    refused("lacks reference", reference_velocity, Log(pd.DataFrame({"t": t}), log.meta))
