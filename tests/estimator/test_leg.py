"""The leg filter: known truth, Jacobians, consistency, contacts that come and go, slip."""

import numpy as np
import pytest
from lie_group import differences, error, retracted, so3_exp
from motions import feet, motion
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from whole_runs import run_leg

from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.leg import LegFilter, LegNoise, encoder_covariance
from surefoot.estimator.metrics import evaluate, nees
from surefoot.estimator.updates.contact import (
    ContactModel,
    _slips,
    contact_memory,
    contact_output,
    propagate_contacts,
    update_contacts,
)
from surefoot.sim.common.errors import SurefootError

RADIUS = 0.03


@pytest.fixture(scope="module")
def walk():
    return motion(10.0, 500.0)


@pytest.fixture(scope="module")
def rolling(walk):
    return feet(walk, RADIUS)


def covariances(legs, std=1e-3):
    return np.broadcast_to(np.eye(3) * std**2, (*legs.contact.shape, 3, 3))


def run(walk, legs, radius, **options):
    return run_leg(
        walk.t, walk.gyro, walk.accel, legs.feet_I, legs.contact, covariances(legs), *walk.start(),
        foot_radius=radius, foot_rates_I=legs.rates_I, **options,
    )  # fmt: skip


@pytest.mark.parametrize("radius", [0.0, RADIUS])
def test_perfect_data_gives_the_truth(walk, radius):
    result = evaluate(walk.reference(), run(walk, feet(walk, radius), radius))
    assert result.ape_trans < 1e-3
    assert result.ape_rot < 0.01
    assert result.velocity < 1e-3


def test_ignoring_that_feet_roll_costs_a_scale_error(walk, rolling):
    """What the rolling model is for: point feet on the same data drift hundreds of times more."""
    right = evaluate(walk.reference(), run(walk, rolling, RADIUS))
    wrong = evaluate(walk.reference(), run(walk, rolling, 0.0))
    assert wrong.ape_trans > 100 * right.ape_trans


@pytest.fixture
def contacts():
    rng = np.random.default_rng(4)
    state = NavState(so3_exp(rng.normal(size=3)), rng.normal(size=3), rng.normal(size=3))
    mean = state.pack(2)
    mean[7:] = rng.normal(size=(2, 3))
    return mean, rng


def test_contact_jacobian(contacts):
    mean, rng = contacts
    A = rng.normal(size=(21, 21))
    P = A @ A.T
    PHt, S, residual = np.empty((21, 3)), np.empty((3, 3)), np.empty(3)
    foot = mean[:3].T @ (mean[8] - mean[4])
    contact_output(mean, P, 1, foot, PHt, S, residual)
    assert_allclose(residual, 0, atol=1e-14)

    def measured(delta):
        other = retracted(mean, delta, 2)
        return other[:3].T @ (other[8] - other[4])

    H = differences(measured, 21)
    assert_allclose(PHt, P @ H.T, atol=1e-7)
    assert_allclose(S, H @ P @ H.T, atol=1e-7)


def test_transition_of_rolling_contacts(contacts):
    """Phi of the contact points, rotation and gyro bias included, against differences."""
    mean, rng = contacts
    gyro, accel, rates, dt = rng.normal(size=3), rng.normal(size=3), rng.normal(size=(2, 3)), 1e-3
    model = ContactModel(np.zeros((4, 3)), np.zeros(3), 0.0, np.full(2, 0.5), np.inf)

    def step(m, P):
        memory = contact_memory(m, P)
        memory.standing[:] = True
        propagate_contacts(memory, model, gyro, accel, dt, rates)
        return m

    after = step(mean.copy(), np.eye(21))

    def moved(delta):
        return error(after, step(retracted(mean, delta, 2), np.eye(21)))

    Phi = differences(moved, 21, 1e-5)
    A = rng.normal(size=(21, 21))
    P = A @ A.T
    step(mean.copy(), P)
    # The feet's rates turn with the mean attitude of the step: an O(dt^2) term is left out.
    assert_allclose(P, Phi @ A @ A.T @ Phi.T, atol=1e-4)


def test_contacts_enter_and_leave(walk, rolling):
    leg = LegFilter(*walk.start(), foot_radius=RADIUS)
    cov = covariances(rolling)[0]
    leg.update_contacts(rolling.feet_I[0], np.array([1, 0, 0, 1]), cov)
    assert set(leg.contacts) == {0, 3}
    assert_allclose(leg.contacts[0], walk.p[0] + walk.R[0] @ rolling.feet_I[0, 0], atol=1e-12)
    leg.update_contacts(rolling.feet_I[0], np.array([0, 0, 0, 1]), cov)
    assert set(leg.contacts) == {3}
    before = leg.covariance
    leg.update_contacts(rolling.feet_I[0], np.zeros(4), cov)
    assert leg.contacts == {}
    assert_array_equal(leg.covariance, before)


def test_a_foot_entering_tells_nothing_new(walk, rolling):
    leg = LegFilter(*walk.start(), foot_radius=RADIUS)
    before = leg.covariance
    leg.update_contacts(rolling.feet_I[0], np.ones(4), covariances(rolling)[0])
    assert_array_equal(leg.covariance, before)


def test_slip_gate_finds_the_slipping_foot(walk):
    """FL slides at 0.6 m/s in every third stance: the gate must name it and save the estimate."""
    legs = feet(walk, RADIUS, slip=0.6)
    trusting = evaluate(walk.reference(), run(walk, legs, RADIUS))
    gated = evaluate(walk.reference(), run(walk, legs, RADIUS, slip_gate=16.27))
    assert gated.ape_trans < 0.5 * trusting.ape_trans
    leg = LegFilter(*walk.start(), foot_radius=RADIUS, slip_gate=16.27)
    cov = covariances(legs)
    named = np.zeros(4, dtype=int)
    for k in range(400):
        if k:
            leg.predict(walk.gyro[k], walk.accel[k], walk.t[k] - walk.t[k - 1], legs.rates_I[k])
        named += leg.update_contacts(legs.feet_I[k], legs.contact[k], cov[k])
    assert named[0] > 0
    assert named[1:].sum() == 0


def test_the_gate_is_on_the_mahalanobis_distance():
    """r^T (S + R)^-1 r, whatever its axes have in common."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        A, r = rng.normal(size=(3, 3)), rng.normal(size=3)
        S, R = A @ A.T, np.diag(rng.uniform(0.01, 0.1, size=3))
        distance = r @ np.linalg.solve(S + R, r)
        for gate, beyond in ((0.999 * distance, True), (1.001 * distance, False)):
            assert _slips(S, R, r, gate, 0.0, np.zeros(3)) == beyond


def test_nees_is_within_its_chi_square_bounds(walk, rolling):
    """Noise drawn as declared: the mean NEES over runs lies where a consistent filter's does."""
    rng, runs, std = np.random.default_rng(8), 12, 2e-3
    noise = LegNoise(FilterNoise(2e-3, 1e-2, 1e-4, 1e-3), contact=1e-2, rolling=0.0)
    values = {"position": [], "velocity": [], "attitude": []}
    walk, short = walk.part(2500), slice(2500)
    cov = covariances(rolling, std)[short]
    for _ in range(runs):
        (state, P), (gyro, accel) = walk.drawn_start(rng), walk.sensed(rng, noise.imu)
        measured = rolling.sensed(walk, rng, noise.contact, std)
        estimate = run_leg(
            walk.t, gyro, accel, measured, rolling.contact[short], cov, state, P, noise, RADIUS,
            rolling.rates_I[short],
        )  # fmt: skip
        found = nees(walk.reference().rows(slice(None, None, 5)), estimate)
        for name, series in values.items():
            series.append(getattr(found, name)[[100, 300, -1]])
    for name, series in values.items():
        # Samples of one run are correlated: count runs, not samples. 3 +- 3 sqrt(6 / runs).
        mean = np.mean(series)
        assert abs(mean - 3.0) < 3 * np.sqrt(6 / runs), (name, mean)


def test_feet_are_points_unless_they_are_said_to_be_round():
    """Points do not roll, so that no one needs to know how they turn."""
    state, gyro, accel = NavState(), np.array([0.1, 0.2, -0.1]), np.array([0.0, 1.0, 9.0])
    plain, point = LegFilter(state, np.eye(15)), LegFilter(state, np.eye(15), foot_radius=0.0)
    plain.predict(gyro, accel, 0.01)
    point.predict(gyro, accel, 0.01, np.ones((4, 3)))
    assert_array_equal(plain.covariance, point.covariance)
    assert_array_equal(plain.state.pack(), point.state.pack())


def test_encoder_covariance():
    J = np.random.default_rng(0).normal(size=(5, 4, 3, 3))
    out = encoder_covariance(J, 0.01, 0.002)
    assert_allclose(out[2, 1], J[2, 1] @ J[2, 1].T * 1e-4 + np.eye(3) * 4e-6)


def test_bad_input_is_one_clear_line(walk, rolling):
    state, P = walk.start()
    with pytest.raises(SurefootError, match="foot_rates_I: needed"):
        LegFilter(state, P, foot_radius=0.02).predict(np.zeros(3), np.zeros(3), 0.01)
    refused("slip_gate", LegFilter, state, P, slip_gate=-1.0)
    refused("foot_radius", LegFilter, state, P, foot_radius=np.array([0.1, 0.2]))
    leg = LegFilter(state, P)
    with pytest.raises(SurefootError, match="foot_positions_I: shape"):
        leg.update_contacts(np.zeros((3, 3)), np.ones(4), np.zeros((4, 3, 3)))
    with pytest.raises(SurefootError, match="covariance of foot 0"):
        leg.update_contacts(np.zeros((4, 3)), np.ones(4), np.zeros((4, 3, 3)))


def standing_foot():
    """Memory of a filter at rest with one foot on the ground, 0.3 m below, and the foot (1, 3)."""
    foot = np.array([[0.1, 0.0, -0.3]])
    memory = contact_memory(NavState().pack(1), np.diag(np.r_[np.full(15, 0.01), np.zeros(3)]))
    seen_again(memory, foot)
    return memory, foot


def seen_again(memory, foot, contact=True, since=0.1):
    """The foot is measured after some time, without an IMU sample between; sums of this (1, 10)."""
    memory.clock[0], sums = since, np.zeros((1, 10))
    update_contacts(memory, 1e9, foot, np.array([contact]), 1e-4 * np.eye(3)[None], sums)
    return sums


def test_of_innovations_far_apart_only_the_last_counts():
    """Their running mean is then the last one, whitened: its square is the squared distance."""
    memory, foot = standing_foot()
    for off in (0.02, -0.01, 0.03):
        distance = seen_again(memory, foot + off)[0, 2]
        assert_allclose(memory.drift[0] @ memory.drift[0], distance, rtol=1e-9)


def test_a_foot_that_lands_anew_has_not_drifted():
    memory, foot = standing_foot()
    seen_again(memory, foot + 0.02, since=0.005)
    assert memory.drift[0].any()
    seen_again(memory, foot, contact=False)
    seen_again(memory, foot)
    assert memory.standing[0]
    assert not memory.drift[0].any()
