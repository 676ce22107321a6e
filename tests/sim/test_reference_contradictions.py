"""Samples of a reference that do not move as the IMU does are left out of a log."""

import numpy as np
import pytest
from motions import attitude, motion, position

from studies.measured import measured_folder
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.importing.recording import read_recording
from surefoot.sim.importing.reference_check import _closed, contradicted
from surefoot.sim.importing.report import import_lines
from surefoot.sim.log.reference import Poses

RECORDING = measured_folder() / "go1_square"
WALK = motion(12.0, 400.0)


def poses(t, stamps=None, noise=3e-4):
    """Samples of the motion at t (K,), of a point beside the IMU, said to be at `stamps`."""
    R = attitude(t).as_matrix()
    p = position(t) + R @ [0.03, 0.05, 0.1]
    p = p + np.random.default_rng(0).normal(0.0, noise, p.shape)
    return Poses(t if stamps is None else stamps, p, quaternion_from_matrix(R))


def found(these):
    return contradicted(WALK.t, WALK.gyro, WALK.accel, these)


def test_a_reference_that_moves_with_the_imu_is_kept():
    t = np.arange(-0.2, 12.2, 1 / 90)
    assert not found(poses(t)).any()
    # Late by half a second all along: a clock, which is solved and not cut out.
    assert not found(poses(t, t + 0.5)).any()


def test_stamps_that_are_far_off_at_an_end_are_left_out_with_what_comes_before():
    t = np.arange(-0.2, 12.2, 1 / 90)
    # Frames were lost without being counted: what was before them comes too late by 0.3 s.
    stamps = np.where(t < 0.5, t + 0.3, t)
    keep = np.r_[True, np.diff(np.maximum.accumulate(stamps)) > 0]
    out = found(poses(t[keep], stamps[keep]))
    dropped = stamps[keep][out]
    assert out[0]
    assert np.all(np.diff(np.flatnonzero(out)) == 1)
    assert 0.75 < dropped[-1] < 0.95


def test_a_jump_between_is_left_out_with_its_surroundings():
    t = np.arange(0.0, 12.0, 1 / 90)
    these = poses(t)
    moved = these.p + np.where(t[:, None] > 6.0, [0.1, 0.0, 0.0], 0.0)
    dropped = t[found(Poses(t, moved, these.q))]
    assert 5.85 < dropped[0] < 6.0 < dropped[-1] < 6.15


def test_a_last_sample_between_the_last_two_rows_of_the_imu_counts_too():
    """A tracker that leaps with its last frame, a millisecond before the recording ends."""
    t = np.append(np.arange(0.0, 11.985, 1 / 90), 11.999)
    these = poses(t)
    these.p[-1] += [0.1, 0.0, 0.0]
    dropped = t[found(these)]
    assert dropped[-1] == 11.999
    assert dropped[0] > 11.85


@pytest.mark.skipif(not RECORDING.is_dir(), reason=f"no measured logs at {RECORDING}")
def test_the_go1_stands_up_slower_than_its_stamps_say():
    recording = read_recording((RECORDING,), "go1_square")
    known, wrong = recording.reference()
    assert known is not None
    assert wrong is not None
    assert wrong.sum() < 0.06 * len(wrong)
    assert known.t[wrong][-1] - known.t[0] < 0.7
    log = recording.log()
    assert log.t[0] > known.t[wrong][-1]
    assert any("accelerometer contradicts them" in line for line in import_lines(log, known, wrong))


def test_good_sections_of_less_than_a_second_are_bad():
    """Between bad ones, and none at either end that is bad itself."""
    t = 0.1 * np.arange(60)
    bad = np.zeros(60, dtype=bool)
    bad[[0, 5, 30, 59]] = True
    wanted = bad.copy()
    wanted[1:5] = True
    assert _closed(t, bad).tolist() == wanted.tolist()
    assert _closed(t, ~bad).tolist() == np.ones(60, dtype=bool).tolist()
