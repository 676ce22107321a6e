"""Drafts by the names that people use: what a column is, what it only looks like, and what is asked
or listed where names do not say it.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from recorded import drafted, saved

from surefoot.sim.importing.guessing.draft import Draft
from surefoot.sim.importing.guessing.guess import guess_map
from surefoot.sim.importing.guessing.names import by_their_lists, read_name
from surefoot.sim.log import JOINTS, LEGS

N = 400
T = 0.01 * np.arange(N)
HOME = np.tile([0.0, 0.8, -1.5], 4)
ANGLES = HOME + 0.2 * np.sin(6.0 * T[:, None] + np.arange(12))
RATES = 1.2 * np.cos(6.0 * T[:, None] + np.arange(12))
GYRO = 0.3 * np.sin(2.0 * T[:, None] + np.arange(3))
ACCEL = np.column_stack([0.1 * np.sin(T), 0.1 * np.cos(T), 9.81 + 0.0 * T])
TRIPLE = np.sin(3.0 * T[:, None] + np.arange(3))
FORCES = np.maximum(100.0 * np.sin(6.0 * T[:, None] + np.arange(4)), 0.0)
BY_HINGE = np.arange(12).reshape(4, 3).T.ravel()
"""Isaac Lab's order of joints: all hips, all thighs, all calves."""


def table(**arrays: np.ndarray) -> pd.DataFrame:
    """Columns of a CSV: those of an array (N, K) are name_0, name_1, ..."""
    columns = {}
    for name, values in arrays.items():
        each = values[:, None] if values.ndim == 1 else values
        names = [name] if values.ndim == 1 else [f"{name}_{k}" for k in range(each.shape[1])]
        columns |= dict(zip(names, each.T, strict=True))
    return pd.DataFrame(columns)


def drafted_table(folder: Path, robot: str | None = None, /, **arrays: np.ndarray) -> Draft:
    return drafted(folder, table(**arrays), robot)


def drafted_arrays(folder: Path, robot: str | None = None, /, **arrays: np.ndarray) -> Draft:
    return guess_map([saved(folder / "run.npz", arrays)], robot)


def theirs(draft: Draft) -> dict[str, str]:
    return {e.name: e.theirs for e in (*draft.main, *draft.reference)}


def listed(draft: Draft) -> str:
    """The lines of what is not used."""
    return "\n".join(line for line in draft.text.splitlines() if line.startswith("# not used"))


KNOWN = {  # what names say: kind and source
    ("gyro", ""): (
        "ang_vel_0", "root_ang_vel_b[0]", "imu_state.gyroscope[2]", "body_rate_z",
        "Imu/AngVel.X (dps)", "gyro_vel_x"),
    ("gyro", "filtered"): ("omega_filtered_x",),
    ("gyro", "bias"): ("gyro_bias_x", "est_gyro_bias_x"),
    ("gyro", "estimate"): ("/odom:twist.twist.angular.x",),
    ("gyro", "command"): ("/cmd_vel:angular.z",),
    ("ref_v", ""): ("root_ang_vel_w[0]", "base_lin_vel_x", "velocity_x"),
    ("other", ""): (
        "angular_acceleration_x", "projected_gravity_0", "gyro_temperature", "FL_foot_vel_x",
        "dof_acc_3"),
    ("accel", ""): ("lin_acc_x", "spec_force_x [g]", "imu_accel_x_mg"),
    ("q", ""): ("dof_pos_3", "joint_pos[3]"),
    ("q", "parameter"): ("default_dof_pos_3",),
    ("q", "command"): ("joint_pos_target[3]", "q_ref_3", "/lowcmd:motor_cmd[3].q"),
    ("q", "error"): ("dof_pos_error_3",),
    ("dq", ""): ("dof_vel_3", "FL_hip_omega", "spd_luff [rpm]"),
    ("tau", ""): ("applied_torque[3]", "elbow_Nm", "FL_knee_load"),
    ("tau", "estimate"): ("motor_state[3].tau_est",),
    ("force", ""): ("contact_forces_z_FL", "/FL_foot_force:wrench.force.z"),
    ("force", "estimate"): ("foot_force_est[0]",),
    ("contact", ""): ("feet_contact[0]",),
    ("ref_p", "reference"): ("vicon_pos_x", "opti_y [mm]"),
    ("ref_q", ""): ("quat_wxyz_0",),
    ("ref_q", "reference"): ("opti_qw",),
    ("t", ""): ("imu_timestamp", "contact_time_FL"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("said", "name"), [(k, name) for k, names in KNOWN.items() for name in names]
)
def test_the_words_of_a_name_say_quantity_and_source(said, name):
    found = read_name(name)
    assert (found.kind, found.source) == said


def test_the_state_of_a_body_in_one_list_is_a_pose():
    read = by_their_lists({f"root_states[{k}]": read_name(f"root_states[{k}]") for k in range(13)})
    assert [one.kind for one in read.values()] == ["ref_p"] * 3 + ["ref_q"] * 4 + ["ref_v"] * 6


IMUS = {
    "an odometry beside it": ({"imu_ang_vel": GYRO, "odom_ang_vel": TRIPLE}, "imu_ang_vel_0"),
    "an estimate beside it": ({"gyro": GYRO, "gyro_ekf": TRIPLE}, "gyro_0"),
    "a bias beside it": ({"gyro_bias": TRIPLE, "gyro": GYRO}, "gyro_0"),
    "a set point beside it": ({"ang_vel_cmd": TRIPLE, "ang_vel": GYRO}, "ang_vel_0"),
    "axes of the world beside it": ({"ang_vel_w": TRIPLE, "ang_vel_b": GYRO}, "ang_vel_b_0"),
    "joints beside it": ({"ang_vel": GYRO, "dof_vel": RATES, "dof_pos": ANGLES}, "ang_vel_0"),
    "a filtered copy": ({"gyro_lpf": TRIPLE, "gyro_raw": GYRO}, "gyro_raw_0"),
}


@pytest.mark.parametrize("case", IMUS)
def test_the_gyro_is_the_sensor_whatever_is_beside_it(tmp_path, case):
    arrays, gyro = IMUS[case]
    draft = drafted_table(tmp_path, time=T, acc=ACCEL, **arrays)
    assert theirs(draft)["gyro_x"] == gyro
    assert not [e for e in draft.main if e.name.startswith("gyro") and e.doubt]
    rest = {n.rpartition("_")[0] for n in table(**arrays)} - {gyro[:-2], "dof_pos", "dof_vel"}
    assert all(f"{name}_0" in listed(draft) for name in rest)


@pytest.mark.parametrize("name", ["ekf_omega", "channel", "commanded_ang_vel", "root_ang_vel_w"])
def test_half_an_imu_is_asked_about(tmp_path, name):
    draft = drafted_table(tmp_path, time=T, acc=ACCEL, **{name: GYRO})
    assert "gyro_x" not in theirs(draft)
    assert any("gyro" in note for note in draft.notes)
    assert f"{name}_0" in listed(draft)


def test_two_imus_are_drafted_with_a_question(tmp_path):
    draft = drafted_table(tmp_path, time=T, imu_acc=ACCEL, imu_gyro=GYRO, camera_gyro=TRIPLE)
    found = {e.name: (e.theirs, e.doubt) for e in draft.main}
    assert found["gyro_x"][0] == "imu_gyro_0"
    assert "camera_gyro_0" in found["gyro_x"][1]


@pytest.mark.parametrize("robot", [None, "spot_class"])
@pytest.mark.parametrize("name", ["{leg}_{part}", "{leg}_{part}_joint", "joints/{leg}_{part}"])
def test_bare_names_of_joints_are_angles_and_asked_about(tmp_path, robot, name):
    names = [name.format(leg=joint[:2], part=joint[3:]) for joint in JOINTS]
    draft = drafted_table(tmp_path, robot, t=T, **dict(zip(names, ANGLES.T, strict=True)))
    found = {e.name: (e.theirs, bool(e.doubt)) for e in draft.main}
    assert found == {"t": ("t", False)} | {
        f"q_{joint}": (n, True) for joint, n in zip(JOINTS, names, strict=True)
    }
    assert any("contacts" in note for note in draft.notes)


ROLLOUTS = {
    "legged_gym": ("dof_pos", "dof_vel", "torques", {"default_dof_pos": HOME, "p_gains": HOME}),
    "isaac lab": ("joint_pos", "joint_vel", "applied_torque", {"default_joint_pos": HOME[None]}),
    "plain": ("q", "dq", "tau", {"kp": np.full(12, 20.0), "kd": np.ones(12), "g": np.ones(3)}),
    "limits": ("dof_pos", "dof_vel", "dof_torque", {"dof_pos_limits": np.ones((12, 2))}),
}


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("case", ROLLOUTS)
def test_a_rollout_of_arrays_has_the_rows_that_they_share(tmp_path, case, turned):
    q, dq, tau, more = ROLLOUTS[case]
    arrays = {q: ANGLES, dq: RATES, tau: RATES, "base_ang_vel": GYRO}
    arrays = {name: one.T if turned else one for name, one in arrays.items()} | more
    draft = drafted_arrays(tmp_path, "spot_class", **arrays)
    found = theirs(draft)
    for kind, name in (("q", q), ("dq", dq), ("tau", tau)):
        expected = {f"{kind}_{joint}": f"{name}[{k}]" for k, joint in enumerate(JOINTS)}
        assert {n: c for n, c in found.items() if n in expected} == expected
    assert draft.rate is not None
    assert all(name in listed(draft) for name in more)
    assert len(listed(draft).splitlines()) <= 10


@pytest.mark.parametrize("names", ["{}_joint", "{}", None])
def test_the_joints_of_a_list_or_of_their_limits_are_the_robots(tmp_path, names):
    """Columns hinge by hinge: by a list of names, or else because only so they fit the limits."""
    joints = [JOINTS[k] for k in BY_HINGE]
    more = {"dof_names": np.array([names.format(j) for j in joints])} if names else {}
    draft = drafted_arrays(tmp_path, "spot_class", t=T, dof_pos=ANGLES[:, BY_HINGE], **more)
    found = theirs(draft)
    assert {f"q_{j}": f"dof_pos[{k}]" for k, j in enumerate(joints)}.items() <= found.items()
    assert all(e.doubt for e in draft.main if e.name != "t")


def test_angles_beyond_the_limits_are_asked_about(tmp_path):
    named = {f"q_{joint}": ANGLES[:, k] for k, joint in enumerate(JOINTS)}
    named["q_FL_calf"] = 2.0 + 0.1 * np.sin(T)
    notes = drafted_table(tmp_path, "spot_class", t=T, **named).notes
    assert [note for note in notes if "FL_calf" in note and "limits" in note]
    named["q_FL_calf"] = ANGLES[:, 2]
    notes = drafted_table(tmp_path, "spot_class", t=T, **named).notes
    assert not [note for note in notes if "limits" in note]


def test_names_that_the_robot_has_not_are_asked_about(tmp_path):
    named = {f"q_{joint.replace('hip', 'spin')}": ANGLES[:, k] for k, joint in enumerate(JOINTS)}
    draft = drafted_table(tmp_path, "spot_class", t=T, **named)
    doubts = {e.theirs: e.doubt for e in draft.main}
    assert "spot_class" in doubts["q_FL_spin"]
    assert not doubts["q_FL_thigh"]


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("contact_forces", "contact_forces[{}][2]"),
        ("foot_force", "foot_force[{}]"),
        ("contact_forces_z", "contact_forces_z[{}]"),
    ],
)
def test_forces_of_the_feet_are_understood_along_z(tmp_path, name, place):
    vectors = name == "contact_forces"
    forces = FORCES[:, :, None] * [0.0, 0.0, 1.0] if vectors else FORCES
    draft = drafted_arrays(tmp_path, t=T, dof_pos=ANGLES, **{name: forces})
    expected = {f"force_{leg}": place.format(k) for k, leg in enumerate(LEGS)}
    assert expected.items() <= theirs(draft).items()
    assert draft.contact is not None
    assert all(e.doubt for e in draft.main if e.name.startswith("force"))
    assert ("contact_forces[0][0]" in listed(draft)) == vectors


@pytest.mark.parametrize(
    ("name", "step", "unit", "slow"),
    [
        ("time_s", 1.0, "s", True),
        ("time", 0.2, "s", True),
        ("time_ms", 200.0, "ms", True),
        ("t [us]", 5e3, "us", False),
        ("elapsed_s", 0.02, "s", False),
    ],
)
def test_the_unit_in_a_name_of_times_holds_and_slow_rows_are_said(tmp_path, name, step, unit, slow):
    draft = drafted_table(tmp_path, **{name: step * np.arange(N), "gyro": GYRO, "acc": ACCEL})
    times = draft.main[0]
    assert (times.name, times.theirs, times.unit) == ("t", name, unit)
    assert any("slow" in note for note in draft.notes) == slow


@pytest.mark.parametrize("header", [False, True])
@pytest.mark.parametrize("word", ["imu_link", "", "2"])
def test_a_text_without_header_may_have_words_in_it(tmp_path, header, word):
    frame = table(stamp=T, gyro=GYRO).assign(frame_id=word)
    frame.to_csv(tmp_path / "run.csv", index=False, header=header)
    draft = guess_map([tmp_path / "run.csv"])
    assert ("header = false" in draft.text) == (not header)
    assert {"0": "0", "stamp": "stamp"}["stamp" if header else "0"] == draft.main[0].theirs


def test_position_beside_a_quaternion_is_a_pose(tmp_path):
    half = 0.5 * np.linspace(2.6, 4.0, N)  # a marker that points backwards
    zero = np.zeros(N)
    q = np.column_stack([np.cos(half), zero, zero, np.sin(half)])
    pose = saved(tmp_path / "mocap.npz", {"t": T, "position": 1e3 * TRIPLE, "quaternion": q})
    read = {"t": T, "gyro": GYRO, "accel": ACCEL, "joint_pos": ANGLES, "joint_vel": RATES}
    draft = guess_map([saved(tmp_path / "run.npz", read), pose], "spot_class")
    found = theirs(draft)
    assert [found[f"ref_p_{axis}"] for axis in "xyz"] == [f"position[{k}]" for k in range(3)]
    assert [found[f"ref_q_{axis}"] for axis in "wxyz"] == [f"quaternion[{k}]" for k in range(4)]
    assert found["dq_RR_calf"] == "joint_vel[11]"
