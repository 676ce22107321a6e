"""A walk in pieces is the walk that is made whole, row by row and byte by byte."""

import hashlib
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from ground_course import whole_course

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import effect
from surefoot.sim.gait.course import course_pieces, stretches
from surefoot.sim.gait.options import GaitOptions
from surefoot.sim.ground.terrain import Ground, Strip
from surefoot.sim.log import LogError, LogWriter
from surefoot.sim.log import file as log_file
from surefoot.sim.physics.stepper import Fallen
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.streams import Sensors, rate_of
from surefoot.sim.walk import meta_of, plan, record, simulate_motion
from surefoot.sim.walking import long_walk
from surefoot.sim.walking.long_walk import needs_whole, walk_in_pieces

ROBOT = Robot.load("spot_class")
SENSORS = Sensors(contact_delay=0.007, contact_missed=0.01, imu_bandwidth=80.0, encoder_offset=0.01)
COURSE = Scenario("short", (Segment(3.0, 0.5, turn=0.3),), Ground(0.8), sensors=SENSORS, stand=0.4)
PAYLOAD = effect("payload", "all", 2.0)


@pytest.fixture(scope="module")
def made():
    return plan(COURSE, ROBOT, 3, [PAYLOAD])


@pytest.fixture(scope="module")
def whole(made):
    return record(made, simulate_motion(made.world, ROBOT, made.gait, made.course))


def pieces_of(made, ticks: int) -> list[pd.DataFrame]:
    return list(walk_in_pieces(made, ticks=ticks))


def test_its_rows_are_those_of_the_whole(made, whole):
    parts = pieces_of(made, 777)
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
        with pytest.raises(LogError, match="column t, row 100: time jumps back"):
            writer.write(whole.frame[50:60])


def test_a_course_in_pieces_is_the_course():
    way = [Segment(3.0, 1.0), Segment(2.0, 0.2, 0.1, -1.0)], 0.004, 0.5, 3, 0.2
    course, parts = whole_course(*way), list(course_pieces(stretches(*way), 0.004, 123))
    for name in ("t", "pose", "velocity"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(course, name))


@pytest.mark.parametrize("rows", [5, 6, 1000, 99_999])
def test_the_rate_is_that_of_all_stamps(rows):
    t = (np.arange(rows) + 1501) * 0.002 - 3.0
    assert long_walk._rate(1500, rows) == rate_of(t)


def test_a_fall_comes_behind_the_rows_before_it():
    cliff = Ground(0.8, (), 30.0, (Strip((-2.0, 0.0), (0.7, 0.0), 3.0, (1.5, 1.5)),))
    made = plan(replace(COURSE, ground=cliff, segments=(Segment(4.0, 0.5),)), ROBOT, 3)
    with pytest.raises(Fallen) as whole:
        simulate_motion(made.world, ROBOT, made.gait, made.course)
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
    made = plan(replace(COURSE, **change), ROBOT, 0, effects)
    assert words in needs_whole(made)
    with pytest.raises(SurefootError, match="cannot be walked in pieces"):
        next(walk_in_pieces(made))
