"""What stances say of legs, against a slow version, and how noise of real legs counts."""

from dataclasses import replace

import numpy as np
import pytest
from known_evidence import QUADRUPED
from numpy.testing import assert_allclose

from surefoot.models.attribution.weights import correlated_entries
from surefoot.models.residuals.binning import BIN, at_rows, reference_motion
from surefoot.models.residuals.feet import (
    FEWEST_STANCE_BINS,
    stance_displacement,
    stance_means,
    unevenness,
)
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.stances import stances

ROBOT = Robot.load("spot_class")


def test_a_mean_stands_in_the_middle_of_its_stance():
    rng = np.random.default_rng(0)
    t = BIN * np.arange(40.0)
    there = np.zeros((40, 2), dtype=bool)
    there[3:10, 0] = there[20:29, 0] = there[12 : 12 + FEWEST_STANCE_BINS - 1, 1] = True
    t[20:] += 1.0
    values = np.where(there[..., None], rng.standard_normal((40, 2, 3)), np.nan)
    means = stance_means(t, values, there)
    assert np.flatnonzero(np.isfinite(means[:, 0, 0])).tolist() == [6, 24]
    assert_allclose(means[6, 0], values[3:10, 0].mean(axis=0))
    assert_allclose(means[24, 0], values[20:29, 0].mean(axis=0))
    assert np.isnan(means[:, 1]).all(), "a stance of too few bins says nothing"


def test_feet_that_roll_move_over_the_ground_of_a_model_that_lacks_it(log):
    """Against a sum over the rows of every stance, in each row's own heading."""
    frame = reference_motion(log, ROBOT.limbs)
    points = replace(ROBOT, foot_radius=np.zeros(4))
    omega = at_rows(log.gyro)
    v = points.feet.imu_velocity(log.q, log.dq, omega, frame.up_I, log.contact) - frame.v_I[:, None]
    found = stance_displacement(log, points.feet, frame)
    rolling = stance_displacement(log, ROBOT.feet, frame)
    for leg in range(4):
        wanted = []
        for first, end in zip(*stances(log.contact[:, leg]), strict=True):
            if first == 0 or end == len(log.t) or end - first < 60:
                continue
            moved = np.zeros(2)
            for row in range(first, end):
                ahead = frame.R_GI[row, :2, 0] / np.linalg.norm(frame.R_GI[row, :2, 0])
                v_G = frame.R_GI[row] @ v[row, leg]
                moved += (
                    np.array([ahead @ v_G[:2], ahead[0] * v_G[1] - ahead[1] * v_G[0]]) / log.rate
                )
            wanted.append(moved)
        columns = found[:, 2 * leg : 2 * leg + 2]
        assert_allclose(columns[np.isfinite(columns[:, 0])], wanted, atol=1e-5)
        typical = [np.nanmedian(np.abs(one[:, 2 * leg])) for one in (found, rolling)]
        assert typical[0] > 0.004 > 4 * typical[1]


def test_a_displacement_stands_in_the_middle_of_its_contact(log):
    frame = reference_motion(log, ROBOT.limbs)
    found = stance_displacement(log, ROBOT.feet, frame)
    for leg in range(4):
        first, end = stances(log.contact[:, leg])
        steps = (end - first >= 60) & (first > 0) & (end < len(log.t))
        middle = 0.5 * (log.t[first] + log.t[end - 1])[steps]
        there = frame.t[np.isfinite(found[:, 2 * leg])]
        assert_allclose(there, middle, atol=0.6 * BIN)


def test_contacts_known_to_end_late_are_that_much_shorter(log):
    """A foot that is taken for standing 2 ms too long moves that much less."""
    frame = reference_motion(log, ROBOT.limbs)
    points = replace(ROBOT, foot_radius=np.zeros(4))
    before = stance_displacement(log, points.feet, frame)
    after = stance_displacement(log, points.feet, frame, liftoff_late=0.002)
    omega = at_rows(log.gyro)
    v = points.feet.imu_velocity(log.q, log.dq, omega, frame.up_I, log.contact) - frame.v_I[:, None]
    first, end = stances(log.contact[:, 0])
    steps = end[(end - first >= 60) & (first > 0) & (end < len(log.t))]
    use = np.isfinite(before[:, 0])
    last = np.linalg.norm(v[steps - 1, 0, :2], axis=1)
    change = np.linalg.norm((after - before)[use, :2], axis=1)
    assert_allclose(change, 0.002 * last, rtol=0.2, atol=2e-5)


@pytest.mark.parametrize(("share", "worth"), [(0.0, 1.0), (0.5, 3.0)])
def test_entries_that_resemble_their_neighbours_are_worth_fewer(share, worth):
    rng = np.random.default_rng(3)
    z = rng.standard_normal((6000, QUADRUPED.width))
    for k in range(1, len(z)):
        z[k] = share * z[k - 1] + np.sqrt(1 - share**2) * z[k]
    assert_allclose(correlated_entries(QUADRUPED, z), worth, rtol=0.2)


def footholds(seed, rough):
    rng = np.random.default_rng(seed)
    leg = np.tile(np.arange(4), 100)
    xy = np.column_stack(
        [np.repeat(0.05 * np.arange(100), 4), 0.2 * (leg % 2) + 0.02 * rng.normal(size=400)]
    )
    z = 0.2 * xy[:, 0] - 0.1 * xy[:, 1] + rough * rng.normal(size=400)
    return np.column_stack([xy, z]), leg


@pytest.mark.parametrize("rough", [0.002, 0.01])
def test_the_deviation_is_found_on_a_slope(rough):
    holds, leg = footholds(0, rough)
    assert unevenness(holds, leg) == pytest.approx(rough, rel=0.15)


def test_constants_of_legs_and_a_step_are_no_rough_ground():
    holds, leg = footholds(1, 0.0)
    holds[:, 2] += 0.01 * (leg == 2) + 0.1 * (holds[:, 0] > 2.5)
    assert unevenness(holds, leg) < 0.002


def test_too_few_footholds_show_nothing():
    holds, leg = footholds(2, 0.01)
    assert unevenness(holds[:3], leg[:3]) == 0.0
