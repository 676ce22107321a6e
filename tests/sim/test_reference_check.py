"""A reference is checked before it is used: frames, jumps, held samples, its noise by the IMU; what
does not move as the IMU does is left out."""

import numpy as np
import pandas as pd
import pytest
from motions import attitude, motion, position
from scipy.spatial.transform import Rotation

import surefoot.sim.importing.reference_check as reference_check_module
from studies.measured import measured_folder
from surefoot.scenarios.cli.main import main
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.importing.reference import interpolate_reference
from surefoot.sim.importing.reference_check import (
    _closed,
    _transition,
    check_reference,
    contradicted,
    jumps,
    miscounts,
    reference_noise,
    without_jumps,
)
from surefoot.sim.importing.report import reference_lines
from surefoot.sim.log import Log, Meta
from surefoot.sim.log.reference import Poses, reference_poses

FRAME = 1 / 120
RECORDING = measured_folder() / "go1_square"


def poses(t, stamps=None, noise=0.0, rng=None):
    """Samples of a known motion at t (K,), said to be at `stamps`."""
    p = position(t)
    if rng is not None:
        p = p + rng.normal(0.0, noise, p.shape)
    return Poses(
        t if stamps is None else stamps, p, quaternion_from_matrix(attitude(t).as_matrix())
    )


T = 0.01 * np.arange(1000)


def aside(x, t=T):
    """Poses of the motion at t (K,), moved by x (K,) [m] along x."""
    true = poses(t)
    return Poses(t, true.p + np.outer(x, [1.0, 0.0, 0.0]), true.q)


def straight(t, x):
    """Poses of a body that goes along x (K,) [m] and does not turn."""
    return Poses(t, np.outer(x, [1.0, 0.0, 0.0]), np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)))


def dropped_frames(rng, seconds=18.0):
    """Frames at 120 Hz, a third of them dropped: how many there are from one sample to the next."""
    frames = np.flatnonzero(rng.random(round(seconds / FRAME)) > 0.33)
    return frames[0], np.diff(frames)


def doubtful(seen):
    """Share of the steps at a steady speed whose stamps are off by a frame."""
    off, judged = miscounts(seen)
    return off.sum() / judged.sum()


def test_frames_that_were_miscounted_are_found():
    rng = np.random.default_rng(0)
    first, steps = dropped_frames(rng)
    t = 0.5 + FRAME * np.cumsum([first, *steps])
    assert doubtful(poses(t)) < 0.005
    assert check_reference(poses(t)).faults == ()
    even = poses(0.5 + FRAME * np.arange(600))
    assert (doubtful(even), check_reference(even).faults) == (0.0, ())
    wrong = rng.random(len(steps)) < 0.2
    counted = np.where(wrong, np.where(steps == 1, 2, steps - 1), steps)
    found = poses(t, 0.5 + FRAME * np.cumsum([first, *counted]))
    # Steps of four frames and more, taken for one less, are no longer told from speed.
    assert 0.1 < doubtful(found) < 0.25
    (fault,) = check_reference(found).faults
    assert f"{100 * doubtful(found):.1f} % of stamps doubtful" in fault


def test_errors_of_stamps_are_told_from_those_of_positions():
    """Positions are good to 0.2 mm, and 3 ms at 0.5 m/s are 1.5 mm."""
    rng = np.random.default_rng(6)
    walk = motion(1.5, 400.0)
    t = np.arange(0.01, 1.45, 1 / 90)
    delay = rng.normal(0.0, 3e-3, len(t))
    seen = poses(t + delay, t, 2e-4, rng)
    found = reference_noise(walk.t, walk.gyro, walk.accel, seen)
    assert found is not None
    assert found.stamp == pytest.approx(np.std(delay), rel=0.2)


def test_the_search_for_the_noise_of_a_reference_without_any_ends(monkeypatch):
    """Its likelihood has no maximum: it grows as the sizes tend to zero."""
    calls, unlikely = [], reference_check_module._unlikely

    def counted(*arguments):
        calls.append(arguments)
        return unlikely(*arguments)

    monkeypatch.setattr(reference_check_module, "_unlikely", counted)
    walk = motion(8.0, 400.0)
    found = reference_noise(walk.t, walk.gyro, walk.accel, poses(walk.t[5:-5:5]))
    assert found is not None
    assert found.position < 1e-4
    assert len(calls) < 300


@pytest.mark.parametrize(("stamped", "covered"), [(1, 2), (2, 1), (2, 3), (3, 2)])
def test_a_step_that_counts_a_frame_too_many_or_too_few_is_found(stamped, covered):
    """In one of twenty samples of a body that moves evenly."""
    frames = np.ones(400, dtype=int)
    frames[10::20] = stamped
    moved = np.where(frames == 1, 1, covered)
    if stamped == 1:
        moved[10::20] = covered
    t, x = (0.01 * np.concatenate([[0], np.cumsum(n)]) for n in (frames, moved))
    assert miscounts(straight(t, x))[0].sum() == 20


@pytest.mark.parametrize("share", [0.5, 1.5])
def test_a_body_that_moves_in_jerks_has_no_miscounted_frames(share):
    """Servos that are told where to go at 25 Hz: of four frames, one is covered at another speed,
    and the stamps are right."""
    speeds = np.tile([1.0, 1.0, share, 1.0], 250) * 0.15
    t = 0.01 * np.arange(len(speeds) + 1)
    off, judged = miscounts(straight(t, np.append(0.0, 0.01 * np.cumsum(speeds))))
    assert (judged.sum() > 900, off.sum()) == (True, 0)


def test_jumps_and_held_samples_and_gaps_are_counted():
    seen = aside(0.03 * (np.arange(1000) >= 300))
    seen.q[600:604] = quaternion_from_matrix(attitude(T[600:604] + 9.0).as_matrix())
    seen.p[800], seen.q[800] = seen.p[799], seen.q[799]
    found = check_reference(seen.rows(np.abs(T - 9.0) > 0.04))
    assert "longest gap 90 ms, 1 over 50 ms" in found.samples
    assert "3 jumps of position or attitude, at 2.99, 5.99, 6.03 s" in "".join(found.faults)
    assert "1 samples repeat the one before while the body moves" in "".join(found.faults)
    np.testing.assert_array_equal(np.flatnonzero(jumps(seen)), [299, 599, 603])
    np.testing.assert_array_equal(np.setdiff1d(T, without_jumps(seen).t), T[600:604])


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (lambda t: t + 60.0 * (t > 4.0), "clock that was set"),
        (lambda t: t + 0.5 * (t > 4.0), "leap from 4 to 4.51 s"),
        (lambda t: 100.0 * t, "of frames"),
    ],
)
def test_stamps_that_leap_while_the_body_goes_on_and_frames_are_named(stamps, said):
    (fault,) = check_reference(poses(T, stamps(T).round(6))).faults
    assert said in fault


def test_a_body_that_was_lost_for_a_while_is_no_clock():
    assert check_reference(poses(T[(T < 4.0) | (T > 5.3)])).faults == ()


def test_poses_between_two_excursions_are_kept_and_those_of_a_chain_of_them_removed():
    x = np.zeros(1000)
    x[np.r_[300:304, 310:315, 600:603]] = 0.1
    x[603:607] = 0.3
    left = without_jumps(aside(x))
    np.testing.assert_array_equal(np.setdiff1d(T, left.t), T[x > 0.0])


@pytest.mark.parametrize("first", [1, 2, 5, 990, 998])
def test_a_jump_near_an_end_is_told_too(first):
    (said,) = check_reference(aside(0.1 * (np.arange(1000) >= first))).faults
    assert f"1 jumps of position or attitude, at {T[first - 1]:.2f} s" in said


def test_a_jump_of_a_body_that_speeds_up_is_told_too():
    """The usual speed is that of as many steps before as after, even where there are no more."""
    t = 0.01 * np.arange(40)
    (said,) = check_reference(straight(t, 10.0 * t**2 + 0.1 * (np.arange(40) > 4))).faults
    assert "1 jumps of position or attitude, at 0.04 s" in said


def test_a_blow_is_no_jump_at_any_rate():
    t = 0.002 * np.arange(1000)
    assert not jumps(aside((t > 1.0) * (t - 1.0), t)).any()
    assert jumps(aside(0.03 * (t > 1.0), t)).sum() == 1


def test_the_noise_of_samples_is_found_by_imu_and_poses():
    """Position, stamp and attitude, of a point that is not the IMU."""
    walk = motion(12.0, 400.0)
    rng = np.random.default_rng(1)
    t = np.arange(0.01, 11.9, 1 / 90)
    true = t + rng.normal(0.0, 1.5e-3, len(t))
    R = attitude(true).as_matrix()
    p = position(true) + R @ [0.1, -0.05, 0.12] + rng.normal(0.0, 0.4e-3, (len(t), 3))
    turned = attitude(true) * Rotation.from_rotvec(rng.normal(0.0, 2e-3, (len(t), 3)))
    accel = walk.accel + np.array([0.05, -0.1, 0.08]) + rng.normal(0.0, 0.03, walk.accel.shape)
    gyro = walk.gyro + 0.003 + rng.normal(0.0, 0.01, walk.gyro.shape)
    seen = Poses(t, p, quaternion_from_matrix(turned.as_matrix()))
    found = reference_noise(walk.t, gyro, accel, seen)
    assert found is not None
    assert found.position == pytest.approx(0.4e-3, rel=0.3)
    assert found.stamp == pytest.approx(1.5e-3, rel=0.2)
    assert found.angle == pytest.approx(2e-3, rel=0.2)
    assert reference_noise(walk.t, gyro, accel, seen.rows(slice(50))) is None


def test_the_filters_noise_adds_up_over_steps():
    """White force over two steps is that of the first, carried on, and of the second."""
    once, twice = (_transition(dt, 3.0)[1] - _transition(dt, 0.0)[1] for dt in (0.02, 0.04))
    F, _ = _transition(0.02, 3.0)
    np.testing.assert_allclose(twice, F @ once @ F.T + once, rtol=1e-12)


def test_where_no_step_can_be_judged_no_stamp_is_doubtful():
    t = np.arange(0.0, 4.0, 0.01)
    assert check_reference(straight(t, 0.0 * t)).faults == ()


def log_of(walk, seen):
    """A log of a motion, its reference interpolated between samples."""
    inside = (walk.t >= seen.t[0]) & (walk.t <= seen.t[-1])
    at, ok = interpolate_reference(walk.t[inside], seen)
    columns = {"t": walk.t[inside], "ref_ok": ok.astype(float)}
    for i, axis in enumerate("xyz"):
        columns |= {f"gyro_{axis}": walk.gyro[inside, i], f"accel_{axis}": walk.accel[inside, i]}
        columns[f"ref_p_{axis}"] = at.p[:, i]
    columns |= {f"ref_q_{axis}": at.q[:, i] for i, axis in enumerate("wxyz")}
    return Log(pd.DataFrame(columns), Meta(400.0))


@pytest.mark.parametrize("frame", [FRAME, 1 / 200, 1 / 190], ids=["120 Hz", "half", "190 Hz"])
def test_samples_are_found_again_in_a_log_to_the_last_digits(frame):
    """Of a reference with dropped frames, and up to half as fast as the log."""
    rng = np.random.default_rng(2)
    walk = motion(12.0, 400.0)
    _, steps = dropped_frames(rng, 11.5)
    seen = poses(0.1013 + frame * np.cumsum(steps), noise=2e-4, rng=rng)
    found = reference_poses(log_of(walk, seen))
    # The path ends at the first and the last, so that it bends at neither.
    inner = seen.rows(slice(1, -1))
    assert len(found.t) == pytest.approx(len(inner.t), abs=2)
    row = np.abs(found.t[:, None] - inner.t).argmin(axis=1)
    np.testing.assert_allclose(found.t[1:-1], inner.t[row][1:-1], atol=1e-9)
    np.testing.assert_allclose(found.p[1:-1], inner.p[row][1:-1], atol=1e-9)
    np.testing.assert_allclose(np.abs(np.sum(found.q * inner.q[row], axis=1)), 1.0, atol=1e-9)


def test_a_sample_a_row_stays_so_where_the_body_rests_first():
    """At rest no path bends: that makes no slower reference of it."""
    walk = motion(8.0, 400.0)
    moves = poses(walk.t)
    rests = np.maximum(np.arange(len(walk.t)) - 1200, 0)  # its first pose for three seconds
    log = log_of(walk, Poses(walk.t, moves.p[rests], moves.q[rests]))
    found = reference_poses(log)
    np.testing.assert_array_equal(found.t, log.t[log.ref_ok])
    np.testing.assert_array_equal(found.p, log.ref_p[log.ref_ok])


def test_a_reference_that_turns_otherwise_is_said_to():
    walk = motion(12.0, 400.0)
    t = np.arange(0.1, 11.9, 0.01)
    assert "reference compared with the IMU" in reference_lines(log_of(walk, poses(t)))[-1]
    elsewhere = poses(t, t + 0.25)
    elsewhere = elsewhere.rows(elsewhere.t < 11.9)
    assert "does not turn as the IMU does" in reference_lines(log_of(walk, elsewhere))[-1]


@pytest.mark.skipif(not RECORDING.is_dir(), reason="the measured logs are not here")
def test_import_reports_what_is_wrong_with_stamps(tmp_path, capsys):
    """The Go1's reference as it was first rebuilt, a fifth of its gaps off by a frame, and as
    recounted."""
    (tmp_path / "imu_joints.csv").symlink_to(RECORDING / "imu_joints.csv")
    (tmp_path / "reference_recounted.csv").symlink_to(RECORDING / "reference.csv")
    said = {}
    for name, folder in (("first", tmp_path), ("recounted", RECORDING)):
        main(f"import csv {folder} --map go1_square -o {tmp_path / name}.parquet".split())
        printed = capsys.readouterr()
        said[name] = printed.out
    assert float(said["first"].split(" % of stamps doubtful")[0].split()[-1]) > 12.0
    assert "doubtful" not in said["recounted"]
    assert "accel_x, accel_y, accel_z: a slower sensor" in printed.err


@pytest.mark.parametrize("rows", [0, 1, 2, 3])
def test_so_few_poses_that_none_has_neighbours_do_not_jump(rows):
    found = jumps(poses(FRAME * np.arange(rows)) if rows else poses(np.zeros(1)).rows(slice(0, 0)))
    assert len(found) == max(rows - 1, 0)
    assert not found.any()


WALK = motion(12.0, 400.0)


def beside(t, stamps=None, noise=3e-4):
    """Samples of the motion at t (K,), of a point beside the IMU, said to be at `stamps`."""
    R = attitude(t).as_matrix()
    p = position(t) + R @ [0.03, 0.05, 0.1]
    p = p + np.random.default_rng(0).normal(0.0, noise, p.shape)
    return Poses(t if stamps is None else stamps, p, quaternion_from_matrix(R))


def out_of(these):
    return contradicted(WALK.t, WALK.gyro, WALK.accel, these)


def test_a_reference_that_moves_with_the_imu_is_kept():
    t = np.arange(-0.2, 12.2, 1 / 90)
    assert not out_of(beside(t)).any()
    # Late by half a second all along: a clock, which is solved and not cut out.
    assert not out_of(beside(t, t + 0.5)).any()


def test_stamps_that_are_far_off_at_an_end_are_left_out_with_what_comes_before():
    t = np.arange(-0.2, 12.2, 1 / 90)
    # Frames were lost without being counted: what was before them comes too late by 0.3 s.
    stamps = np.where(t < 0.5, t + 0.3, t)
    keep = np.r_[True, np.diff(np.maximum.accumulate(stamps)) > 0]
    out = out_of(beside(t[keep], stamps[keep]))
    dropped = stamps[keep][out]
    assert out[0]
    assert np.all(np.diff(np.flatnonzero(out)) == 1)
    assert 0.75 < dropped[-1] < 0.95


def test_a_jump_between_is_left_out_with_its_surroundings():
    t = np.arange(0.0, 12.0, 1 / 90)
    these = beside(t)
    moved = these.p + np.where(t[:, None] > 6.0, [0.1, 0.0, 0.0], 0.0)
    dropped = t[out_of(Poses(t, moved, these.q))]
    assert 5.85 < dropped[0] < 6.0 < dropped[-1] < 6.15


def test_a_last_sample_between_the_last_two_rows_of_the_imu_counts_too():
    """A tracker that leaps with its last frame, a millisecond before the recording ends."""
    t = np.append(np.arange(0.0, 11.985, 1 / 90), 11.999)
    these = beside(t)
    these.p[-1] += [0.1, 0.0, 0.0]
    dropped = t[out_of(these)]
    assert dropped[-1] == 11.999
    assert dropped[0] > 11.85


def test_good_sections_of_less_than_a_second_are_bad():
    """Between bad ones, and none at either end that is bad itself."""
    t = 0.1 * np.arange(60)
    bad = np.zeros(60, dtype=bool)
    bad[[0, 5, 30, 59]] = True
    wanted = bad.copy()
    wanted[1:5] = True
    assert _closed(t, bad).tolist() == wanted.tolist()
    assert _closed(t, ~bad).tolist() == np.ones(60, dtype=bool).tolist()
