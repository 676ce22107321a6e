"""One call a sample gives the numbers of the compiled loop, bit for bit, on logs with holes.

Samples come unevenly, with a gap of 80 ms; measurements pause for a second and are wild at times;
bounds and covariances change with every measurement.
"""

from itertools import pairwise

import numpy as np
import pytest
from motions import feet, motion
from numpy.testing import assert_array_equal
from whole_runs import run_coverage, run_imu, run_leg, run_velocity

from surefoot.estimator.filter import InvariantFilter
from surefoot.estimator.leg import LegFilter
from surefoot.estimator.updates.bias_states import PersistentError

RADIUS, STRIDE = 0.03, 7
LASTING = PersistentError(1e-3 * np.eye(3), 60.0, 4, np.full(3, 0.4))


@pytest.fixture(scope="module")
def walk():
    """Rows of a walk of 4 s: every row stays with probability 0.8, none between 1.5 and 1.58 s."""
    whole = motion(4.0, 500.0)
    keep = np.random.default_rng(2).random(len(whole.t)) < 0.8
    keep &= (whole.t < 1.5) | (whole.t > 1.58)
    keep[0] = True
    return whole, np.flatnonzero(keep)


@pytest.fixture(scope="module")
def log(walk):
    whole, kept = walk
    return whole.t[kept], whole.gyro[kept], whole.accel[kept]


@pytest.fixture(scope="module")
def measured(walk):
    """rows (M,), v_I (M, 3), epsilon (M, 3), cov (M, 3, 3): a pause of a second, and outliers."""
    whole, kept = walk
    rng = np.random.default_rng(3)
    rows = np.flatnonzero(rng.random(len(kept)) < 0.2)
    rows = rows[(whole.t[kept[rows]] < 2.0) | (whole.t[kept[rows]] > 3.0)]
    v_I = whole.v_I[kept[rows]] + 0.03 * rng.normal(size=(len(rows), 3))
    v_I[::29] += 2.0
    A = 0.03 * rng.normal(size=(len(rows), 3, 3))
    cov = A @ np.swapaxes(A, 1, 2) + 1e-4 * np.eye(3)
    return rows, v_I, rng.uniform(0.03, 0.2, (len(rows), 3)), cov


def assert_same(states, covariances, whole):
    assert len(states) == len(whole.t)
    for name in ("R_GI", "v_GI", "p_GI", "b_a", "b_g"):
        assert_array_equal([getattr(s, name) for s in states], getattr(whole, name))
    assert_array_equal(covariances, whole.covariance)


def stream(one, log, update=lambda k: None, rates=None):
    """Feed a log to a filter, each row to `update` too; states and covariances of every STRIDE-th
    row."""
    states, covariances = [], []
    for k, (t, gyro, accel) in enumerate(zip(*log, strict=True)):
        if k:
            one.predict(gyro, accel, t - log[0][k - 1], *([] if rates is None else [rates[k]]))
        update(k)
        if k % STRIDE == 0:
            states.append(one.state)
            covariances.append(one.covariance)
    return states, covariances


def check_coverage(walk, log, rows, v_I, epsilon, persistent, iterations=1):
    """The whole run, and pi of each call of the stream, which has the same numbers."""
    t, gyro, accel = log
    start, pi = walk[0].start(), []
    one = InvariantFilter(*start, persistent=persistent)

    def update(k):
        for m in np.flatnonzero(rows == k):
            pi.append(one.update_coverage(v_I[m], epsilon[m], 0.8, iterations))

    found = stream(one, log, update)
    whole = run_coverage(
        t, gyro, accel, rows, v_I, epsilon, 0.8, *start, stride=STRIDE, persistent=persistent,
        iterations=iterations,
    )  # fmt: skip
    assert_same(*found, whole)
    assert whole.updates is not None
    assert_array_equal(whole.updates.pi, [x for x in pi if np.isfinite(x)])
    return whole, np.array(pi)


@pytest.mark.parametrize("iterations", [1, 3])
@pytest.mark.parametrize("persistent", [None, LASTING], ids=["plain", "persistent"])
def test_coverage(walk, log, measured, persistent, iterations):
    rows, v_I, epsilon, _ = measured
    check_coverage(walk, log, rows, v_I, epsilon, persistent, iterations)


def test_coverage_without_outliers(walk, log, measured):
    """One is left out of its window, which then ends one measurement later."""
    rows, v_I, epsilon, _ = measured
    v_I = v_I.copy()
    v_I[10::40, 1] += 40.0
    whole, pi = check_coverage(walk, log, rows, v_I, epsilon, LASTING)
    number = np.arange(len(rows))
    keep = (number % 40 != 10) & (number % 29 != 0)
    assert np.isfinite(pi).sum() == keep.sum() // LASTING.window
    without, _ = check_coverage(walk, log, rows[keep], v_I[keep], epsilon[keep], LASTING)
    assert_array_equal(whole.p_GI, without.p_GI)


@pytest.mark.parametrize("persistent", [None, LASTING], ids=["plain", "persistent"])
def test_velocity(walk, log, measured, persistent):
    t, gyro, accel = log
    rows, v_I, _, cov = measured
    start = walk[0].start()
    one = InvariantFilter(*start, persistent=persistent)

    def update(k):
        for m in np.flatnonzero(rows == k):
            one.update_velocity(v_I[m], cov[m])

    found = stream(one, log, update)
    whole = run_velocity(
        t, gyro, accel, rows, v_I, cov, *start, stride=STRIDE, persistent=persistent
    )
    assert_same(*found, whole)


def test_imu(walk, log):
    t, gyro, accel = log
    start = walk[0].start()
    whole = run_imu(t, gyro, accel, *start, stride=STRIDE)
    assert_same(*stream(InvariantFilter(*start), log), whole)


@pytest.mark.parametrize("gate", [None, 16.27])
@pytest.mark.parametrize("radius", [0.0, RADIUS])
def test_leg(walk, log, measured, radius, gate):
    """Feet enter and leave, one slips, all fly for a while; velocities come in between."""
    motion_, kept = walk
    t, gyro, accel = log
    rows, v_I, _, v_cov = measured
    legs = feet(motion_, radius, slip=0.6)
    feet_I, contact, rates_I = legs.feet_I[kept], legs.contact[kept].copy(), legs.rates_I[kept]
    contact[(t > 0.7) & (t < 0.9)] = False
    assert contact.any(axis=0).all()
    assert {len(s) for s in (set(a) for a in pairwise(contact.sum(axis=1)))} == {1, 2}
    rng = np.random.default_rng(4)
    A = 1e-3 * rng.normal(size=(len(t), 4, 3, 3))
    cov = A @ np.swapaxes(A, 2, 3) + 1e-6 * np.eye(3)
    start = motion_.start()
    one = LegFilter(*start, foot_radius=radius, slip_gate=gate)

    def update(k):
        one.update_contacts(feet_I[k], contact[k], cov[k])
        assert set(one.contacts) <= set(np.flatnonzero(contact[k]))
        for m in np.flatnonzero(rows == k):
            one.update_velocity(v_I[m], v_cov[m])

    found = stream(one, log, update, rates_I)
    whole = run_leg(
        t, gyro, accel, feet_I, contact, cov, *start, foot_radius=radius, foot_rates_I=rates_I,
        slip_gate=gate, stride=STRIDE, rows=rows, v_I=v_I, v_cov=v_cov,
    )  # fmt: skip
    assert_same(*found, whole)
