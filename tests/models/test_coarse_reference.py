"""A measured reference: when its samples were, and how much they err."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from surefoot.models.attribution.coarse_reference import Coarse, as_coarse, coarseness
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk


@pytest.fixture(scope="module")
def log():
    course = (Segment(5.0, 0.5), Segment(5.0, 0.4, turn=0.5))
    return walk(Scenario("seen", course, Ground(0.8)), Robot.load("spot_class"), 4)


def test_a_reference_with_a_sample_a_row_is_not_coarse(log):
    assert coarseness(log) is None


def test_samples_and_their_noise_are_found_again(log):
    rng = np.random.default_rng(0)
    intervals = tuple(rng.choice([0.0083, 0.0167, 0.025], 1000))
    true = Coarse(intervals, 0.8e-3, 1.5e-3)
    found = coarseness(as_coarse(log, true, rng))
    assert found is not None
    # Whole rows of 2 ms say when a sample was to half of one, and two may share a bend.
    seen = np.sum(np.cumsum(intervals) < log.t[-1] - log.t[0])
    assert len(found.intervals) == pytest.approx(seen, rel=0.03)
    assert_allclose(np.median(found.intervals), np.median(intervals), atol=1.1e-3)
    assert found.angle == pytest.approx(true.angle, rel=0.25)
    assert found.position == pytest.approx(true.position, rel=0.25)


def test_without_an_imu_only_the_samples_are_known(log):
    rng = np.random.default_rng(1)
    coarse = as_coarse(log, Coarse((0.02,) * 50, 1e-3, 1e-3), rng)
    names = [n for n in coarse.frame if str(n).startswith(("gyro_", "accel_"))]
    bare = type(coarse)(coarse.frame.drop(columns=names), coarse.meta, coarse.name)
    found = coarseness(bare)
    assert found is not None
    assert (found.position, found.angle) == (0.0, 0.0)


def test_a_reference_without_error_keeps_the_motion(log):
    seen = as_coarse(log, Coarse((0.01,), 0.0, 0.0), np.random.default_rng(2))
    assert_allclose(seen.ref_p, log.ref_p, atol=5e-4)
    assert_allclose(seen.ref_R_GI, log.ref_R_GI, atol=4e-3)
