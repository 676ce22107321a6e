"""Streams that are late, tried on the true residual of a walk: the legs say which of two it is."""

from dataclasses import replace

import numpy as np
import pytest

from surefoot.models.attribution.evidence import all_keys, linearise, log_under_model
from surefoot.models.attribution.fit import design
from surefoot.models.attribution.noise_floor import noise_floor
from surefoot.models.attribution.refinement import RefinementData, interpolation_weights, rerank
from surefoot.models.attribution.robust_weights import robust_weights
from surefoot.models.attribution.selection import Candidate
from surefoot.models.attribution.split import FIT, SELECT
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

SPOT = Robot.load("spot_class")
SCENARIO = Scenario("short", (Segment(12.0, 0.6, 0.1, 0.3),), Ground(0.8))


def case_with(*effects):
    return log_under_model(walk(SCENARIO, SPOT, 3, effects, declared=False), SPOT)


@pytest.fixture(scope="module")
def floor():
    return noise_floor([case_with()])


def data_of(case, floor):
    whole = design(linearise([case], (), all_keys(case)))
    evidence = whole.evidence
    part = np.where(np.floor(evidence.t / 4).astype(int) % 2 == 0, FIT, SELECT)
    return RefinementData([case], floor, evidence, (), robust_weights(whole, floor.sigma), part)


def candidate(name, target, size):
    return Candidate((name, target), size, 1e-6, 1e-6, 1e4, (9e3, 1.1e4), 0.9, False, True)


BOTH_WAYS = pytest.mark.parametrize(("late", "other"), [
    ("imu_delay", "reference_delay"), ("reference_delay", "imu_delay"),
])  # fmt: skip


def of_two_streams(floor, late, other, delay):
    """The effects, and what leaves more, once the stream that is late was named."""
    data = data_of(case_with(effect(late, "all", delay)), floor)
    right, wrong = candidate(late, "all", delay), candidate(other, "all", -delay)
    best, effects, worse = rerank(data, [wrong, right])
    assert best is right
    return effects, worse


# Half a step between two rows: there most is lost by moving a stream.
@BOTH_WAYS
def test_of_two_streams_the_late_one_is_named(floor, late, other):
    effects, _ = of_two_streams(floor, late, other, 0.001)
    # Interpolation draws a delay towards whole rows: here by a tenth of one at most.
    assert effects[0].value == pytest.approx(0.001, abs=2e-4)


@BOTH_WAYS
def test_the_other_stream_is_no_rival_where_it_leaves_more(floor, late, other):
    _, worse = of_two_streams(floor, late, other, 0.01)
    assert worse == ((other, "all"),)


@pytest.mark.parametrize("time", [0.001, 0.004])
def test_a_filtered_imu_is_no_late_one(floor, time):
    """Filtered rates are late in the legs' velocities too, which know of the filter."""
    data = data_of(case_with(effect("imu_lowpass", "all", time)), floor)
    filtered, late = candidate("imu_lowpass", "all", time), candidate("imu_delay", "all", time)
    best, effects, _ = rerank(data, [late, filtered])
    assert best is filtered
    assert effects[0].value == pytest.approx(time, rel=0.15)


def test_shocks_of_the_imu_and_of_torques_lose_weight_and_nothing_else_does(floor):
    data = data_of(case_with(), floor)
    weight, command = interpolation_weights(data), data.evidence.layout.of("command")
    others = np.setdiff1d(np.arange(6, weight.shape[1]), command)
    assert np.all(weight[:, others] == 1.0)
    # The robot stands before it walks.
    assert weight[:10, command].min() > 0.9
    assert weight[:, command].min() < 0.1
    case = data.cases[0]
    quiet = (case.motion.standing.all(axis=1)).astype(float)
    bins = np.add.reduceat(quiet, case.motion.first) == case.motion.count
    assert np.median(weight[bins, :6]) > 0.4
    assert weight[:, 3:6].min() < 0.02
    still = replace(data, cases=[replace(case, fixed=True)])
    assert np.all(interpolation_weights(still)[:, :6] == 1.0)
