"""Short walks: repeatable to the bit, true to their own reference, feet where they stand; in pieces
as in one."""

import hashlib
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from ground_course import whole_course
from perfect import PERFECT
from refusals import refused
from scipy.spatial.transform import Rotation
from turning import mean_rotation

from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.effects import effect
from surefoot.sim.gait.controller import gait_for
from surefoot.sim.gait.course import course_pieces, stretches
from surefoot.sim.gait.options import GaitOptions
from surefoot.sim.ground.terrain import Ground, Patch, Strip
from surefoot.sim.log import LogWriter
from surefoot.sim.log import file as log_file
from surefoot.sim.physics.scene import TIMESTEP, build_world
from surefoot.sim.physics.stepper import Fallen
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Ranges, Scenario, Segment
from surefoot.sim.sensors.streams import Sensors, ideal_streams, imu_motion
from surefoot.sim.walk import STEPS_PER_TICK, meta_of, plan, record, simulate_motion, walk
from surefoot.sim.walking.long_walk import needs_whole, walk_in_pieces

SPOT = Robot.load("spot_class")
TERRAIN = Ground(
    0.8,
    (Patch(2.0, 0.0, 0.8, 3.0, 0.2),),
    30.0,
    (
        Strip((0.8, 0.0), (1.6, 0.0), 3.0, (0.0, 0.1)),
        Strip((1.6, 0.0), (4.0, 0.0), 3.0, (0.1, 0.1)),
    ),
)
SCENARIO = Scenario(
    "short",
    (Segment(3.0, 0.7), Segment(1.5, 0.4, turn=0.5)),
    TERRAIN,
    ranges=Ranges(mu=(0.9, 1.1), speed=(0.9, 1.1), patch_shift=0.1),
)


@pytest.fixture(scope="module")
def log():
    return walk(SCENARIO, SPOT, 3)


@pytest.fixture(scope="module")
def perfect():
    return walk(Scenario("perfect", SCENARIO.segments, TERRAIN, sensors=PERFECT), SPOT, 3)


def test_the_controller_stands_on_the_feet_that_the_world_has():
    as_drawn, larger = (
        plan(SCENARIO, SPOT, 3, [effect("foot_rolling", "all", size)]).gait for size in (0.0, 0.012)
    )
    np.testing.assert_allclose(larger.foot_radius - as_drawn.foot_radius, 0.012, atol=1e-9)
    assert larger.height - as_drawn.height == pytest.approx(0.012)


def test_imu_rows_integrate_back_to_the_reference():
    """Row k carries the state of row k - 1 exactly to that of row k (Hartley et al. 2020)."""
    world = build_world(SPOT, TERRAIN)
    course = whole_course(SCENARIO.segments, TIMESTEP * STEPS_PER_TICK, 1.0)
    motion = simulate_motion(world, SPOT, gait_for(SPOT, 1.0), course)
    streams = ideal_streams(motion, SPOT)
    R_GI, p_GI, v_GI = imu_motion(motion, SPOT)
    R, v = R_GI[0], v_GI[0]
    for k in range(len(streams.t)):
        turn = streams.gyro[k] * TIMESTEP
        v = v + (R @ mean_rotation(turn[None])[0] @ streams.accel[k] + GRAVITY_G) * TIMESTEP
        R = R @ Rotation.from_rotvec(turn).as_matrix()
    # The whole walk, dead-reckoned: nothing but rounding is left.
    np.testing.assert_allclose(R, R_GI[-1], atol=1e-9)
    np.testing.assert_allclose(v, v_GI[-1], atol=1e-8)
    assert len(p_GI) == len(streams.t) + 1


def test_reference_velocity_integrates_to_the_reference_position(perfect):
    means = 0.5 * (perfect.ref_v[1:] + perfect.ref_v[:-1])
    moved = np.cumsum(means * np.diff(perfect.t)[:, None], axis=0)
    np.testing.assert_allclose(perfect.ref_p[0] + moved, perfect.ref_p[1:], atol=2e-5)


def test_positions_are_those_of_the_rates_own_times():
    """MuJoCo's own positions are half a step ahead: the later rate alone leads to them."""
    made = plan(SCENARIO, SPOT, 3)
    motion = simulate_motion(made.world, SPOT, made.gait, made.course)
    for position, rate in ((motion.p_GB, motion.v_GB), (motion.q, motion.dq)):
        means = 0.5 * (rate[1:] + rate[:-1])
        np.testing.assert_allclose(np.diff(position, axis=0), TIMESTEP * means, atol=1e-12)
    gyro = ideal_streams(motion, SPOT).gyro @ SPOT.R_BI.T
    means = 0.5 * (motion.w_B[1:] + motion.w_B[:-1])
    later = motion.w_B[1:]
    assert np.abs(gyro - means).max() < 0.01 * np.abs(gyro - later).max()


def test_feet_stand_still_on_dry_ground(log):
    standing = (log.slip > 0) & (log.mu > 0.5)
    assert np.median(log.slip[standing]) < 1e-3
    assert (log.slip[standing] > 0.05).mean() < 0.01


@pytest.mark.parametrize(
    "one", [effect("link_length", "FL_calf", 0.02), effect("foot_rolling", "all", 0.01)]
)
def test_feet_stand_still_in_the_truth_of_an_altered_body(one):
    """The truth is that of the legs that walked, not of the declared ones."""
    course = Scenario("plain", (Segment(3.0, 0.6, turn=0.2),), Ground(0.8))
    log = walk(course, SPOT, 0, [one])
    for leg in range(4):
        assert np.median(log.slip[log.contact[:, leg], leg]) < 1e-3


def test_friction_of_the_patch_is_in_the_truth(log):
    assert ((log.mu < 0.3) & (log.slip > 0)).any()
    assert set(np.unique((log.mu / log.mu.max()).round(6))) == {0.25, 1.0}


def test_the_robot_starts_standing_still_and_follows_its_course(log):
    assert np.linalg.norm(log.ref_v[:450], axis=1).max() < 0.05
    forward = np.einsum("nj,nj->n", log.ref_R_GI[:, :, 0], log.ref_v)
    assert 0.5 < forward[1000:2000].mean() < 0.9


def test_a_course_that_leaves_the_floor_is_refused():
    far = Scenario("far", (Segment(9.0, 1.0),), Ground(0.8, half_size=5.0))
    refused("half_size", walk, far, SPOT, 0)


def test_payload_presses_harder_on_the_ground():
    weights = []
    for m in (0.0, 5.0):
        ranges = Ranges(payload=(m, m))
        still = Scenario("s", (Segment(1.0),), Ground(0.8), ranges=ranges, sensors=PERFECT)
        weights.append(walk(still, SPOT, 0).force[200:450].sum(axis=1).mean())
    assert weights[1] - weights[0] == pytest.approx(5.0 * 9.81, rel=0.1)


def test_what_a_robots_file_says_of_other_geoms_does_not_move_the_ground(tmp_path):
    """A margin lets soles hover, a floor of its own hides the ice, too little memory is fatal."""
    plain = SPOT.file.read_text()
    odd = plain.replace("<default>", '<default>\n<geom margin="0.002"/>', 1).replace(
        "<worldbody>", '<worldbody><geom type="plane" size="0 0 1" pos="0 0 -0.01"/>', 1
    )
    odd = odd.replace("<option ", '<size memory="20K"/><option gravity="0 0 -1" ', 1)
    odd = odd.replace(
        "</mujoco>", '<sensor><jointpos joint="FL_hip" name="touch_FL"/></sensor></mujoco>'
    )
    (tmp_path / "odd.xml").write_text(odd)
    course = Scenario("s", (Segment(1.5, 0.6),), Ground(0.8, (Patch(0.5, 0, 0.6, 3.0, 0.2),)))
    ours, theirs = (walk(course, robot, 0) for robot in (SPOT, Robot.load(tmp_path / "odd.xml")))
    assert ours.frame.equals(theirs.frame)


SENSORS = Sensors(contact_delay=0.007, contact_missed=0.01, imu_bandwidth=80.0, encoder_offset=0.01)
COURSE = Scenario("short", (Segment(3.0, 0.5, turn=0.3),), Ground(0.8), sensors=SENSORS, stand=0.4)
PAYLOAD = effect("payload", "all", 2.0)


@pytest.fixture(scope="module")
def made():
    return plan(COURSE, SPOT, 3, [PAYLOAD])


@pytest.fixture(scope="module")
def whole(made):
    return record(made, simulate_motion(made.world, SPOT, made.gait, made.course))


def test_its_rows_are_those_of_the_whole(made, whole):
    parts = list(walk_in_pieces(made, ticks=777))
    assert len(parts) > 2
    pd.testing.assert_frame_equal(
        pd.concat(parts, ignore_index=True), whole.frame, check_exact=True
    )


def test_its_file_is_that_of_the_whole(made, whole, tmp_path, monkeypatch):
    monkeypatch.setattr(log_file, "ROW_GROUP", 512)
    whole.write(tmp_path / "whole.parquet")
    with LogWriter(tmp_path / "pieces.parquet", meta_of(made)) as writer:
        for first in range(0, len(whole.frame), 777):
            writer.write(whole.frame[first : first + 777])
    digests = {hashlib.sha256(f.read_bytes()).digest() for f in tmp_path.iterdir()}
    assert len(digests) == 1


def test_a_writer_refuses_a_piece_that_does_not_follow(whole, made, tmp_path):
    with LogWriter(tmp_path / "log.parquet", meta_of(made)) as writer:
        writer.write(whole.frame[:100])
        refused("column t, row 100: time jumps back", writer.write, whole.frame[50:60])


def test_a_course_in_pieces_is_the_course():
    way = [Segment(3.0, 1.0), Segment(2.0, 0.2, 0.1, -1.0)], 0.004, 0.5, 3, 0.2
    course, parts = whole_course(*way), list(course_pieces(stretches(*way), 0.004, 123))
    for name in ("t", "pose", "velocity"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(course, name))


def test_a_fall_comes_behind_the_rows_before_it():
    cliff = Ground(0.8, (), 30.0, (Strip((-2.0, 0.0), (0.7, 0.0), 3.0, (1.5, 1.5)),))
    made = plan(replace(COURSE, ground=cliff, segments=(Segment(4.0, 0.5),)), SPOT, 3)
    with pytest.raises(Fallen) as whole:
        simulate_motion(made.world, SPOT, made.gait, made.course)
    rows: list[pd.DataFrame] = []
    with pytest.raises(Fallen) as fall:
        rows.extend(walk_in_pieces(made, ticks=800))
    assert (fall.value.time, fall.value.how) == (whole.value.time, whole.value.how)
    assert whole.value.motion is not None
    until, found = record(made, whole.value.motion).frame, pd.concat(rows, ignore_index=True)
    for name in ("t", "ref_p_x", "ref_q_w", "slip_FL"):  # noise is drawn for rows to come as well
        np.testing.assert_array_equal(found[name], until[name])


@pytest.mark.parametrize(
    ("change", "effects", "words"),
    [
        ({}, [effect("joint_delay", "all", 0.004)], "joint_delay alters whole streams"),
        ({}, [effect("reference_delay", "all", 0.004)], "reference_delay alters"),
        ({"sensors": Sensors(rate=200.0)}, [], "rate"),
        ({"gait": GaitOptions(velocity_noise=0.01)}, [], "estimate"),
    ],
)
def test_what_takes_a_whole_walk_is_said(change, effects, words):
    made = plan(replace(COURSE, **change), SPOT, 0, effects)
    assert words in needs_whole(made)
    refused("cannot be walked in pieces", next, walk_in_pieces(made))
