"""When contacts are told to change, against when feet stop and start to move."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused
from synthetic import synthetic_walk

from surefoot.models.attribution.evidence import linearise, log_under_model, table_of
from surefoot.models.residuals.binning import reference_motion
from surefoot.models.residuals.channels import CHANNELS
from surefoot.models.residuals.contact_timing import (
    STANDING_SPEED,
    contact_timing,
    motion_changes,
)
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.effects import effect
from surefoot.sim.effects.base import with_columns
from surefoot.sim.ground.terrain import Ground, Patch
from surefoot.sim.log import JOINTS, LEGS
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import QUADRUPED
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.stances import changes, contact_from_force
from surefoot.sim.walk import walk

ROBOT = Robot.load("spot_class")
COURSE = (Segment(4.0, 0.5), Segment(4.0, 0.4, turn=0.4))
TIMING = layout_for(QUADRUPED).channels["contact_timing"]
MOVED = layout_for(QUADRUPED).channels["stance_displacement"]
TOUCHDOWN, LIFTOFF = (slice(TIMING.start + k, TIMING.start + k + 4) for k in (0, 4))


def case_with(*effects):
    scenario = Scenario("timing", COURSE, Ground(0.8))
    return log_under_model(walk(scenario, ROBOT, 4, effects, declared=False), ROBOT)


@pytest.fixture(scope="module")
def plain():
    return case_with()


def moments(t, stands, speed, nearing=None, bounce=25):
    """`motion_changes` of a foot that falls as fast as it moves, if nothing else is said."""
    nearing = speed if nearing is None else nearing
    return motion_changes(t, stands, speed, nearing, changes(stands), 40, bounce, 5)


def test_moments_are_those_at_which_a_foot_stops_and_starts():
    """A foot that moves from 0.103 to 0.397 s and is told to do so from 0.12 to 0.41 s."""
    t = 0.002 * np.arange(400)
    ramp = np.minimum(t - 0.103, 0.397 - t) * 20.0
    speed = np.clip(ramp, 0.0, 1.0) + 0.05
    stands = (t < 0.12) | (t > 0.41)
    at, when, lifts = moments(t, stands, speed)
    assert lifts.tolist() == [True, False]
    early = (STANDING_SPEED - 0.05) / 20.0
    assert_allclose(when, [0.103 + early, 0.397 - early], atol=1e-9)
    assert (np.abs(t[at] - when) <= 0.002).all()
    # Too slow ever to be seen to move, and one whose reference has a hole.
    for unseen in (np.full(400, 0.5 * STANDING_SPEED), np.full(400, np.nan)):
        _, when, _ = moments(t, stands, unseen)
        assert np.isnan(when).all()


def test_a_foot_that_slides_as_it_lands_does_not_show_when():
    """It touches the ground at 0.2 s, bounces, and slides until 0.22 s; one that lifts may begin
    with a slide."""
    t = 0.002 * np.arange(200)
    moves, in_air = (t > 0.1) & (t < 0.22), (t > 0.12) & (t < 0.2)
    bounces = 0.2 * (-1.0) ** np.arange(200)
    speed, nearing = np.where(moves, 1.0, 0.0), np.where(in_air, 0.6, np.where(moves, bounces, 0.0))
    stands = (t < 0.1) | (t >= 0.2)
    _, when, lifts = moments(t, stands, speed, nearing)
    assert np.isfinite(when).tolist() == lifts.tolist() == [True, False]
    _, when, _ = moments(t, stands, speed, np.where(moves, 0.6, 0.0))
    assert np.isfinite(when).all(), "else this tests nothing"


def test_on_ice_touchdowns_are_as_punctual_as_elsewhere():
    ice = Ground(0.7, (Patch(1.5, 0.0, 1.5, 2.0, 0.1),))
    log = walk(Scenario("ice", (Segment(6.0, 0.5),), ice), ROBOT, 4)
    late = contact_timing(log, ROBOT.feet, reference_motion(log, ROBOT.limbs), ROBOT.extras)[:, :4]
    assert np.sqrt(np.nanmean(late**2)) < 1e-3
    on_ice = np.column_stack([log.frame[f"mu_{leg}"] for leg in LEGS]) < 0.3
    assert on_ice.mean() > 0.05
    assert np.isfinite(late).sum() > 20


def timing_of_two_steps(before: float) -> np.ndarray:
    """Timing of a robot at rest whose FL foot starts to move at 0.123 and 0.563 s and stops at
    0.317 and 0.757 s; its contact ends `before` [s] it starts and begins as it stops."""
    log = synthetic_walk(0, 1.0, robot="spot_class")
    robot = replace(ROBOT, foot_radius=np.zeros(4))
    speed, stands = np.zeros(len(log.t)), np.ones(len(log.t), dtype=bool)
    for start, stop in ((0.123, 0.317), (0.563, 0.757)):
        ramp = STANDING_SPEED + 20.0 * np.minimum(log.t - start, stop - log.t)
        speed += np.clip(ramp, 0.0, 1.0)
        stands &= (log.t < start - before) | (log.t > stop)
    calf, q = JOINTS.index("FL_calf"), np.tile(robot.q_home, (len(log.t), 1))
    dq = np.outer(speed, np.eye(12)[calf])
    dq /= np.linalg.norm(robot.feet_jacobian_I(q[:1])[0, 0], axis=0)[2]
    columns = {f"q_{joint}": q[:, i] for i, joint in enumerate(JOINTS)}
    columns |= {f"dq_{joint}": dq[:, i] for i, joint in enumerate(JOINTS)}
    columns |= {f"contact_{leg}": np.where(leg == "FL", stands, 1.0) for leg in LEGS}
    still = {"ref_q_w": 1.0, "ref_q_x": 0.0, "ref_q_y": 0.0, "ref_q_z": 0.0}
    still |= {f"{what}_{axis}": 0.0 for what in ("gyro", "ref_p", "ref_v") for axis in "xyz"}
    columns |= {name: np.full(len(log.t), value) for name, value in still.items()}
    log = with_columns(log, columns)
    return contact_timing(log, robot.feet, reference_motion(log, robot.limbs), robot.extras)


def test_a_step_shows_in_the_bins_in_which_its_foot_starts_and_stops():
    late = timing_of_two_steps(0.018)
    rows, columns = np.nonzero(np.isfinite(late))
    assert list(zip(rows, columns, strict=True)) == [(6, 4), (15, 0), (28, 4), (37, 0)]
    sooner = timing_of_two_steps(0.026)[rows, columns]
    assert_allclose(late[rows, columns] - sooner, [0.008, 0.0, 0.008, 0.0], atol=1e-9)


@pytest.mark.parametrize("name", ["go1", "v60_class"])
def test_robots_whose_feet_move_soon_and_late_lift_as_usual_within_two_spreads(name):
    """From the end of a contact until the foot moves, go1 takes 7 ms and the V60 class 24 ms."""
    robot = Robot.load(name)
    log = walk(Scenario("timing", COURSE, Ground(0.8)), robot, 4)
    lifts = contact_timing(log, robot.feet, reference_motion(log, robot.limbs), robot.extras)[:, 4:]
    assert np.isfinite(lifts).sum() > 60
    assert abs(np.nanmean(lifts)) < 2.0 * CHANNELS["contact_timing"].level_spread["liftoff"]


@pytest.mark.parametrize(
    ("target", "off", "columns"),
    [("touchdown", 0.021, TOUCHDOWN), ("liftoff", 0.021, LIFTOFF), ("touchdown", -0.02, TOUCHDOWN)],
)
def test_a_late_or_early_contact_shows_by_its_delay_and_is_explained(plain, target, off, columns):
    one = effect("contact_delay", target, off)
    shifted = case_with(one)
    before = np.nanmedian(table_of(plain, ()), axis=0)
    seen = np.nanmedian(table_of(shifted, ()), axis=0) - before
    # Feet differ by their loads; the mean over all is what the effect says.
    assert np.mean(seen[columns]) == pytest.approx(off, abs=2e-3)  # a row
    left = np.nanmedian(table_of(shifted, [one]), axis=0) - before
    others = np.setdiff1d(np.r_[TIMING], np.r_[columns])
    assert_allclose(left[others], 0.0, atol=2e-3)
    assert np.mean(left[columns]) == pytest.approx(0.0, abs=2e-3)
    if off < 0.0:
        known, _ = one.compensate(shifted.log, ROBOT)
        assert (known.contact != plain.log.contact).mean() < 0.01


def test_contacts_do_not_end_before_a_foot_moves():
    refused("liftoff: value must lie between 0 and", effect, "contact_delay", "liftoff", -0.01)


def test_feet_that_already_move_are_not_asked_where_contacts_end_late(plain):
    """Rows in which a foot counts as standing are those of the log whose contacts are not late, and
    the residual of its velocity is as there."""
    late = case_with(effect("contact_delay", "liftoff", 0.04))
    rows = late.motion.standing
    # Each step is late by its own time.
    assert (rows & ~plain.motion.standing).sum() < 0.08 * rows.sum()
    assert rows.sum() > 0.9 * plain.motion.standing.sum()
    velocities = layout_for(QUADRUPED).channels["leg_velocity"]
    # A foot that lifts is faster by an order of magnitude.
    assert np.nanmax(np.abs(table_of(late, ())[:, velocities])) < 0.02


def test_a_foot_that_bounces_has_landed_once():
    """It stops at 0.2 s, is sensed 10 ms sooner for 4 ms, and again 2 ms after."""
    t = 0.002 * np.arange(200)
    speed = np.where((t > 0.1) & (t < 0.2), 1.0, 0.0)
    stands = (t < 0.095) | ((t > 0.189) & (t < 0.193)) | (t > 0.201)
    _, when, lifts = moments(t, stands, speed)
    assert np.isfinite(when[~lifts]).tolist() == [True, False]
    behind = t[changes(stands)[~lifts]][0] - when[~lifts][0]
    assert behind == pytest.approx(-0.01, abs=2e-3)
    _, when, lifts = moments(t, stands, speed, bounce=0)
    assert np.isfinite(when[~lifts]).all(), "else this tests nothing"


def test_late_touchdowns_leave_stances_as_they_were_sensed_and_swings_end_before(plain):
    """Each step is late by its own time: moved by the mean, some stances would begin in the air."""
    one = effect("contact_delay", "touchdown", 0.04)
    late = case_with(one)
    log, robot = one.compensate(late.log, ROBOT)
    assert (log.contact == late.log.contact).all()
    assert robot.extras.touchdown_late == one.value
    assert squared_drift(late, [one]) < 1.1 * squared_drift(late, []) + 1e-6
    # Legs carry before their contacts begin: these rows are of no swing.
    layout = layout_for(QUADRUPED)
    torques = [table_of(case, ())[:, layout.channels["joint_torque"]] for case in (plain, late)]
    assert np.nanstd(torques[1]) < 1.2 * np.nanstd(torques[0])


def squared_drift(case, known):
    """Square of how far feet seem to move while they stand, m^2."""
    return np.nansum(table_of(case, known)[:, MOVED]) ** 2


def test_a_contact_that_must_last_before_it_counts_is_not_late(plain):
    """A log says for how long, and the residual knows."""
    log = plain.log
    columns = {}
    for i, leg in enumerate(log.legs):
        force = np.where(log.contact[:, i], 1.0, 0.0)
        columns[f"contact_{leg}"] = contact_from_force(log.t, force, 0.5, 0.5, 0.04).astype(float)
    model = {**log.meta.model, "contact_debounce": 0.04}
    debounced = replace(with_columns(log, columns), meta=replace(log.meta, model=model))
    left = np.nanmedian(table_of(log_under_model(debounced, ROBOT), ()), axis=0)
    before = np.nanmedian(table_of(plain, ()), axis=0)
    # But for feet that bounce as they land.
    assert_allclose(left[TOUCHDOWN], before[TOUCHDOWN], atol=0.015)


def test_a_delay_adds_its_size_and_a_clock_the_time_that_it_is_off(plain):
    keys = [("contact_delay", "touchdown"), ("contact_delay", "liftoff"), ("clock_scale", "feet")]
    found = linearise([plain], (), keys)
    for one, columns in zip(found.X[:2], (TOUCHDOWN, LIFTOFF), strict=True):
        at = np.searchsorted(one.columns, np.r_[columns])
        there = np.isfinite(found.table[:, columns])
        assert set(one.columns) & set(np.r_[TIMING]) == set(np.r_[columns])
        assert_allclose(one.values[:, at], there.astype(float), atol=1e-6)
    clock = found.X[2]
    at = np.searchsorted(clock.columns, np.r_[TIMING])
    since = (found.t - plain.log.t[0])[:, None]
    there = np.isfinite(found.table[:, TIMING])
    # Contacts move by whole rows of 2 ms, with a step of a thousandth.
    off = np.abs(clock.values[:, at] + since)[there]
    assert np.quantile(off, 0.95) < 1.2
