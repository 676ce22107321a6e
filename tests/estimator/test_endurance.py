"""A million steps of every filter, with outliers, dropouts and 40-sigma measurements."""

import numpy as np
import pytest

from surefoot.estimator.core.propagation import propagate
from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.updates.bias_states import (
    EXTRAS,
    PersistentError,
    propagate_bias,
)
from surefoot.estimator.updates.contact import (
    ContactModel,
    contact_memory,
    propagate_contacts,
    update_contacts,
)
from surefoot.estimator.updates.coverage import update_coverage
from surefoot.estimator.updates.velocity import (
    update_velocity,
    velocity_memory,
)
from surefoot.sim.common.kernels import kernel

KINDS = (
    "coverage", "velocity", "coverage_persistent", "velocity_persistent", "leg", "leg_slip",
    "coverage_without_outliers",
)  # fmt: skip
NOISE = FilterNoise(3e-4, 1e-2, 1e-5, 1e-4).packed()
FEET = np.array([[0.3, 0.2, -0.5], [0.3, -0.2, -0.5], [-0.3, 0.2, -0.5], [-0.3, -0.2, -0.5]])


@kernel
def march(kind, steps, seed, memory, measured, persistent, contacts, noise, feet_I, check):
    """Walk in circles at 500 Hz; `check` (M, n, n) receives P at even intervals."""
    np.random.seed(seed)
    mean, P, columns, rotation = (
        memory.mean,
        memory.covariance,
        memory.columns,
        memory.rotation_columns,
    )
    rates, sums = np.zeros((4, 3)), np.zeros((4, 10))
    contact, cov = np.zeros(4, dtype=np.bool_), np.zeros((4, 3, 3))
    R, epsilon = np.eye(3) * 4e-4, np.array([0.05, 0.2, 0.05])
    every = steps // check.shape[0]
    for i in range(4):
        cov[i] = np.eye(3) * 4e-6
    for k in range(steps):
        gyro = np.array([0.2 * np.sin(0.02 * k), 0.1, 0.3]) + 0.01 * np.random.randn(3)
        accel = mean[:3].T.copy() @ np.array([0.0, 0.0, 9.81]) + 0.5 * np.random.randn(3)
        if kind < 4 or kind == 6:
            propagate(mean, P, gyro, accel, 0.002, noise, columns, rotation)
        else:
            propagate_contacts(memory, contacts, gyro, accel, 0.002, rates)
        if kind == 2 or kind == 3:
            propagate_bias(mean, P, persistent, 20.0, 0.002)
        if k % every == every - 1:
            check[k // every] = P
        if k % 5000 >= 4500:
            continue
        wild = 40.0 if np.random.rand() < 0.01 else 1.0
        if (kind < 4 or kind == 6) and k % 5 == 0:
            # Where wild, 40 deviations: of the filter's own, but the measurement's where nothing is
            # left out.
            size = 0.03 * wild
            if wild > 1.0 and kind > 0:
                size = wild * np.sqrt(P[3, 3] + P[4, 4] + P[5, 5])
            v = size * np.random.randn(3)
            if kind == 1 or kind == 3:
                update_velocity(mean, P, 0, v, R, measured)
            else:
                update_coverage(mean, P, v, epsilon, 0.8, 1, measured)
        elif kind == 4 or kind == 5:
            for i in range(4):
                contact[i] = (k // 150 + i // 2 + i) % 2 == 0
            seen = feet_I + wild * 2e-3 * np.random.randn(4, 3)
            gate = np.inf if kind == 4 else 16.27
            update_contacts(memory, gate, seen, contact, cov, sums)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("steps", [20_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_the_covariance_stays_definite_and_nothing_diverges(kind, steps):
    place = KINDS.index(kind)
    start = np.diag(np.repeat([4e-4, 2.5e-3, 1e-6, 1e-2, 2.5e-5], 3))
    lasting = PersistentError(np.diag([2e-3, 1e-3, 5e-4]), 20.0, 12, np.full(3, 0.5))
    if kind.startswith("leg"):
        mean, P = NavState().pack(4), np.zeros((27, 27))
        P[:15, :15] = start
    elif kind.endswith("persistent"):
        mean, P = NavState().pack(EXTRAS), lasting.enter(start)
    else:
        mean, P = NavState().pack(), start
    check = np.full((40, *P.shape), np.nan)
    contacts = ContactModel(NOISE, np.full(3, 4e-4), 0.01, np.full(4, 0.02), np.inf)
    rejecting = kind.endswith(("persistent", "outliers"))
    measured = velocity_memory(lasting.max_error, 12) if rejecting else velocity_memory()
    memories = contact_memory(mean, P), measured
    march(place, steps, 1, *memories, lasting.covariance, contacts, NOISE, FEET, check)
    assert np.isfinite(check).all()
    assert np.isfinite(P).all()
    assert np.isfinite(mean).all()
    assert np.abs(mean[:3] @ mean[:3].T - np.eye(3)).max() < 1e-9
    for each in (*check, P):
        # In units of its own deviations, as metres and radians do not compare.
        scale = np.sqrt(np.diag(each)[:15])
        assert np.linalg.eigvalsh(each[:15, :15] / np.outer(scale, scale))[0] > 0
        assert np.abs(each - each.T).max() <= 1e-12 * np.abs(each).max()
    assert np.abs(mean[3]).max() < 50.0
