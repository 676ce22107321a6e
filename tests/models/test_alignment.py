"""Clock, place and rotation of a tracked body: planted, and found within their intervals."""

import tomllib
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from studies.measured import measured_folder
from surefoot.models.alignment.alignment import align, aligned_log
from surefoot.models.alignment.least_squares import Placement, Readings, placement_residual
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.effects.base import with_columns
from surefoot.sim.importing.recording import read_recording
from surefoot.sim.log.reference import Poses, reference_poses

GYRO = [f"gyro_{axis}" for axis in "xyz"]
SCALER = measured_folder() / "scaler_trot"
P_IM = np.array([0.04, 0.06, 0.11])
R_IM = Rotation.from_euler("zyx", [0.5, -0.2, 0.1])


def tracked(log, offset, wobble=0.0, seed=0):
    """Poses of a body that is somewhere on the robot, at 90 Hz with dropped samples and noise, on a
    clock that is behind by `offset` [s]."""
    rng = np.random.default_rng(seed)
    t = np.arange(log.t[0] + 0.01, log.t[-1] - 0.01, 1 / 90)
    t = t[rng.random(len(t)) > 0.1]
    R_GI = Slerp(log.t, Rotation.from_matrix(log.ref_R_GI))(t)
    p = CubicSpline(log.t, log.ref_p)(t) + R_GI.apply(P_IM) + rng.normal(0.0, 2e-4, (len(t), 3))
    R_GM = R_GI * R_IM * Rotation.from_rotvec(rng.normal(0.0, 1e-3, (len(t), 3)))
    if wobble:
        beats = np.sin(np.outer(t, [7.0, 9.0, 11.0]) + rng.uniform(0, 6, 3))
        R_GM = R_GM * Rotation.from_rotvec(wobble * beats)
    return Poses(t - offset, p, quaternion_from_matrix(R_GM.as_matrix()))


@pytest.mark.parametrize("offset", [3.7, 0.004, -9.6, -1.7e9, 3600.0])
def test_what_was_planted_is_found_within_its_interval(log, offset):
    found = align(log, tracked(log, offset))
    assert found.offset == pytest.approx(offset, abs=max(found.offset_half_width, 2e-4))
    assert found.offset_half_width < 2e-3
    np.testing.assert_allclose(found.halves, offset, atol=2e-3)
    # Three coordinates of a place: now and then one is just outside its interval.
    assert np.all(np.abs(found.p_IM - P_IM) < 1.5 * found.p_IM_half_width)
    assert np.all(found.p_IM_half_width < 0.02)
    turned = (Rotation.from_matrix(found.R_IM).inv() * R_IM).as_rotvec()
    assert np.all(np.abs(turned) < 1.5 * found.R_IM_half_width)
    assert found.faults == ()
    assert tomllib.loads("\n".join(found.map_lines()))["reference"]["offset"] == pytest.approx(
        found.offset, abs=1e-5
    )


WORLDS = {"y up": ("x", -90), "y down": ("x", 90), "x up": ("y", 90), "z down": ("x", 180)}


@pytest.mark.parametrize("seed", range(3))
def test_a_clock_that_is_off_by_strides_is_right_or_said_to_be_one_of_several(log, seed):
    """Straight ahead, where strides look alike, and a reference of a part of it."""
    rng = np.random.default_rng(seed)
    steady = log.rows((log.t > 1.5) & (log.t < 5.5))
    poses = tracked(steady, offset=float(rng.uniform(-3.0, 3.0)), seed=seed)
    first = poses.t[0]
    truth = steady.t[0] + 0.01 - first
    part = (poses.t - first > 0.2) & (poses.t - first < 3.8)
    found = align(steady, poses.rows(part))
    every = np.append(found.others, found.offset)
    assert np.abs(every - truth).min() < 5e-3
    assert (len(found.others) > 0) == bool(found.faults)
    assert abs(found.offset - truth) < found.offset_half_width + 5e-3


@pytest.mark.parametrize("world", WORLDS)
def test_gravity_along_another_axis_is_the_world_turned_and_no_offset(log, world):
    """Whatever the map's own q_GW, given as R_GW: the whole rotation is told, to be pasted."""
    R_WG = Rotation.from_euler(*WORLDS[world], degrees=True)
    at = tracked(log, 0.5)
    poses = replace(
        at,
        p=R_WG.apply(at.p),
        q=(R_WG * Rotation.from_quat(at.q, scalar_first=True)).as_quat(scalar_first=True),
    )
    found = align(log, poses, R_GW=Rotation.from_euler("z", 90, degrees=True).as_matrix())
    assert found.offset == pytest.approx(0.5, abs=1e-3)
    np.testing.assert_allclose(found.p_IM, P_IM, atol=0.02)
    np.testing.assert_array_equal(found.accel_offset, 0.0)
    assert ["world" in fault for fault in found.faults] == [True]
    advised = tomllib.loads("\n".join(found.map_lines()))["reference"]["q_GW"]
    up = Rotation.from_quat(advised, scalar_first=True).apply(R_WG.apply([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(up, [0.0, 0.0, 1.0], atol=1e-5)
    level = aligned_log(log, found, poses)
    np.testing.assert_allclose(
        np.diff(level.ref_p[:, 2]), np.diff(log.ref_p[:, 2])[: len(level.t) - 1], atol=0.05
    )


def test_swapped_axes_of_an_accelerometer_are_no_other_world_and_no_offsets(log):
    swapped = with_columns(log, {"accel_y": log.frame["accel_z"], "accel_z": log.frame["accel_y"]})
    found = align(swapped, tracked(log, 0.5))
    assert ["accel" in fault and "offset" not in fault for fault in found.faults] == [True]
    np.testing.assert_array_equal(found.q_GW, [1.0, 0.0, 0.0, 0.0])


def test_positions_in_mm_are_named_and_no_offset_of_the_accelerometer(log):
    at = tracked(log, 0.5)
    refused("in mm, not m", align, log, replace(at, p=1e3 * at.p))


def test_an_aligned_log_has_the_motion_of_the_imu(log):
    poses = tracked(log, 0.5)
    found = aligned_log(log, align(log, poses), poses)
    row = np.searchsorted(log.t, found.t)
    np.testing.assert_allclose(found.ref_p, log.ref_p[row], atol=0.012)
    turned = np.swapaxes(found.ref_R_GI, 1, 2) @ log.ref_R_GI[row]
    assert np.degrees(np.quantile(Rotation.from_matrix(turned).magnitude(), 0.95)) < 1.0
    assert found.meta.model["reference_alignment"]["offset"] == pytest.approx(0.5, abs=2e-3)
    assert not found.has("ref_v")
    again = align(found)
    assert abs(again.offset) < 1e-3
    np.testing.assert_allclose(again.p_IM, 0.0, atol=0.01)


@pytest.mark.long
def test_another_body_is_reported(log):
    found = align(log, tracked(log, 0.2, wobble=0.15))
    assert any("does not turn as the IMU does" in fault for fault in found.faults)


def test_an_accelerometer_of_another_convention_is_named_and_does_no_harm(log):
    """Gravity of the wrong sign, as one public recording has it, and an axis turned about."""
    odd = with_columns(
        log, {"accel_z": log.frame["accel_z"] - 19.62, "accel_y": -log.frame["accel_y"]}
    )
    found = align(odd, tracked(log, 0.3))
    np.testing.assert_array_equal(found.accel_sign, [1.0, -1.0, 1.0])
    assert found.accel_offset[2] == pytest.approx(19.62, abs=0.5)
    assert found.offset == pytest.approx(0.3, abs=1e-3)
    np.testing.assert_allclose(found.p_IM, P_IM, atol=0.01)
    assert sum("no specific force" in fault for fault in found.faults) == 2


def test_residuals_vanish_where_the_placement_is_right(log):
    """And their derivatives by the place are those of differences."""
    zero = np.zeros(3)
    at = Placement(0.2, R_IM.as_matrix(), zero, zero, P_IM, np.zeros(2))
    (readings,) = Readings(log.t, log.gyro, log.accel, tracked(log, 0.2)).sections(0.2)
    rows, lever, _ = placement_residual(readings, at)
    wrong, _, _ = placement_residual(readings, replace(at, p_IM=P_IM + np.array([0.0, 0.3, 0.0])))
    assert np.sum(rows[:, 3:] ** 2) < 0.5 * np.sum(wrong[:, 3:] ** 2)
    np.testing.assert_allclose(wrong[:, 3:] - rows[:, 3:], 0.3 * lever[:, :, 1], atol=1e-8)


TOO_LITTLE = {
    "two seconds": lambda log: (log.rows(slice(1000)), None),
    "a pose a second": lambda log: (log, reference_poses(log).rows(slice(None, None, 500))),
    "a gyro that never turns": lambda log: (
        with_columns(log, dict(zip(GYRO, 0.0 * log.gyro.T, strict=True))),
        None,
    ),
}


@pytest.mark.parametrize("case", TOO_LITTLE)
def test_too_little_in_common_is_one_line(log, case):
    message = f"{log.name}: IMU and reference share too little to be aligned"
    refused(message, align, *TOO_LITTLE[case](log))


def test_a_simulated_reference_is_that_of_the_imu(log):
    """A simulator whose positions are ahead of its rates has a clock offset and a lever arm."""
    found = align(log)
    assert abs(found.offset) < 1e-5
    assert np.all(np.abs(found.p_IM) < np.maximum(found.p_IM_half_width, 3e-4))


@pytest.mark.skipif(not SCALER.is_dir(), reason="the measured logs are not here")
@pytest.mark.parametrize(
    "name", ["10", *(pytest.param(name, marks=pytest.mark.long) for name in ("12", "17"))]
)
def test_clocks_that_were_started_apart_are_found(name):
    """Of three recording days, one with poses that are turned about for some frames."""
    recording = read_recording(SCALER / "logs" / f"scaler_{name}.csv", "scaler_trot")
    found = align(recording.without_reference().log(), recording.poses)
    assert 3.0 < -found.offset < 7.0
    assert abs(np.diff(found.halves)[0]) < 5e-3
    assert found.offset_half_width < 2e-3
    assert found.faults == ()


@pytest.mark.long
def test_a_gap_of_weeks_takes_no_memory(log):
    """Each half of the walk has its poses; the second is said to be weeks later."""
    poses = tracked(log, 3.7)
    middle, gap = 7.0, 2e6
    late = log.with_columns({"t": np.where(log.t < middle, log.t, log.t + gap)})
    t = np.where(poses.t + 3.7 < middle, poses.t, poses.t + gap)
    tracemalloc.start()
    found = align(late, replace(poses, t=t))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200e6  # a grid over the gap has 3 GB for each axis
    # Nothing is integrated across it: the same as without the gap.
    assert found.offset == pytest.approx(3.7, abs=found.offset_half_width)
    assert np.all(np.abs(found.p_IM - P_IM) < found.p_IM_half_width)
    assert found.offset_half_width < 1e-3
    assert found.faults == ()
