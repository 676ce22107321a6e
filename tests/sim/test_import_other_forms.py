"""Recordings as people bring them: forms that a draft reads or asks about, and refusals that name
the cause and the next step. One table for each kind."""

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from recorded import POSE, UNIX, as_named, check_entries, csv, entries_of, imported, poses, saved
from refusals import refusal
from written import written

from surefoot.sim.importing.guessing.guess import guess_map
from surefoot.sim.log import JOINTS, LEGS

N = 200
T = 0.01 * np.arange(1, N + 1)
GYRO = 0.3 * np.sin(2.0 * T[:, None] + np.arange(3))
ACCEL = np.column_stack([0.1 * np.sin(T), 0.1 * np.cos(T), 9.81 + 0.0 * T])
ANGLES = np.tile([0.0, 0.8, -1.5], 4) + 0.2 * np.sin(6.0 * T[:, None] + np.arange(12))
RNG = np.random.default_rng(0)
IMU = {f"gyro_{a}": GYRO[:, k] for k, a in enumerate("xyz")}
IMU |= {f"acc_{a}": ACCEL[:, k] for k, a in enumerate("xyz")}
NAMES = [f"{joint}_joint" for joint in reversed(JOINTS)]


def text(folder: Path, lines) -> Path:
    return written(folder / "run.txt", "\n".join(lines) + "\n")


def npz(folder: Path, **arrays) -> Path:
    return saved(folder / "run.npz", arrays)


def h5(folder: Path, **arrays) -> Path:
    return saved(folder / "run.h5", arrays)


SECONDS, NANOSECONDS = (UNIX + T).astype(int), np.round(T % 1.0 * 1e9).astype(int) % 10**9
STAMPS = {
    # name of the stamps in the draft, the recording's columns of them
    "seconds and nanoseconds": ("stamp", {"stamp.secs": SECONDS, "stamp.nsecs": NANOSECONDS}),
    "dates": ("time", {"time": pd.to_datetime(UNIX + T, unit="s").strftime("%F %H:%M:%S.%f")}),
    "dates of ISO": ("time", {"time": [f"{x.isoformat()}Z" for x in pd.to_datetime(T, unit="s")]}),
    "times of day": ("time", {"time": pd.to_datetime(T, unit="s").strftime("%H:%M:%S.%f")}),
}


@pytest.mark.parametrize("case", STAMPS)
def test_stamps_that_are_split_or_written_are_seconds(tmp_path, case):
    name, columns = STAMPS[case]
    run = csv(tmp_path, columns | IMU)
    draft = guess_map([run])
    check_entries(draft, {"t": (name,)})
    log = imported(run, draft)
    assert len(log.t) == N
    np.testing.assert_allclose(log.t - log.t[0], T - T[0], atol=2e-6)


RIGHT_FIRST = ("FR", "FL", "RR", "RL")
JOINTS_OF_RIGHT_FIRST = {f"q_{leg}_{p}": T for leg in RIGHT_FIRST for p in ("hip", "thigh", "calf")}
LOST = np.arange(N) + 7 * (np.arange(N) > 100)
TWENTY = np.column_stack([ANGLES, np.zeros((N, 8))])
WHEELS = [*NAMES, *(f"{k}_wheel" for k in range(8))]
FEET = {f"footForce[{k}]": 100.0 + T for k in range(4)}
COUNTS = {n: 900.0 * x for n, x in IMU.items()}
COUNTS |= {f"gyro_{a}": RNG.normal(0.0, 200.0, N) for a in "xyz"}
FRAMES = poses(T, 0.1).rename(columns={"t": "Frame"}).assign(Frame=np.arange(N))
UNLISTED = "has {} names, not 12"
STANDS = (np.sin(9.0 * T[:, None] + np.arange(4)) > 0.0).astype(float)
GYM = {"time": T[None, :, None], "imu_gyro": GYRO[None], "contact_state": STANDS[None]}
GYM |= {"contact_forces": np.ones((1, N, 12))}
BENCH = {"time": T}
for k in (1, 2):
    q, dq = np.sin(k * T), k * np.cos(k * T)
    BENCH |= {f"pos_{of}{k}": q for of in ("meas", "filt", "des")}
    BENCH |= {f"vel_{of}{k}": dq for of in ("meas", "filt")}
    BENCH |= {f"tau_{of}{k}": dq for of in ("con", "fric", "meas", "des")}
DRIVE = {"q": "pos_meas", "dq": "vel_meas", "tau": "tau_meas", "q_des": "pos_des"}
DRIVE |= {"tau_ff": "tau_con"}
DRAFTED = {
    # files, robot, entries by the log's column, words of the notes
    "one robot of a vectorised simulator": (
        lambda d: npz(d, q=ANGLES[:, None], gyro=GYRO[:, None], t=T), "spot_class",
        {"t": ("t", "s"), "q_FL_hip": ("q[0]",)}, ""),
    "fewer rows than joints": (
        lambda d: npz(d, q=ANGLES[:9], gyro=GYRO[:9], kp=np.ones(12), t=T[:9]), "spot_class",
        {"t": ("t", "s"), "q_FL_hip": ("q[0]",)}, ""),
    "times as dates": (
        lambda d: npz(d, q=ANGLES, t=(1e9 * T).astype("i8").astype("datetime64[ns]"), gyro=GYRO),
        "spot_class", {"t": ("t", "s"), "q_FL_hip": ("q[0]",)}, ""),
    "names in bytes": (
        lambda d: npz(d, q=ANGLES[:, ::-1], dof_names=np.array(NAMES, "S"), t=T), "spot_class",
        {"t": ("t", "s"), "q_FL_hip": ("q[11]",)}, ""),
    "names in HDF5": (
        lambda d: h5(d, t=T, q=ANGLES[:, ::-1], joint_names=NAMES), "spot_class",
        {"q_FL_hip": ("q[11]", "rad", "joint_names")}, ""),
    "more names than joints": (
        lambda d: npz(d, q=ANGLES, t=T, dof_names=[*NAMES, "arm_joint"]), None,
        {"q_FL_hip": ("q[0]", "rad", f"dof_names {UNLISTED.format(13)}")}, ""),
    "places without a motor, as the last eight of a Go2": (
        lambda d: npz(d, motor_q=TWENTY, motor_dq=0.0 * TWENTY, t=T), "spot_class",
        {"q_RR_calf": ("motor_q[11]",), "q_joint12": ()}, ""),
    "twenty joints that are named": (
        lambda d: npz(d, motor_q=TWENTY, motor_dq=0.0 * TWENTY, t=T, dof_names=WHEELS),
        "spot_class",
        {"q_FL_hip": ("motor_q[11]", "rad", "dof_names"), "q_7_wheel": ("motor_q[19]",)}, ""),
    "ticks": (lambda d: csv(d, {"tick": np.arange(N)} | IMU), None, {"t": ()}, "tick counts rows"),
    "frames of a camera": (
        lambda d: csv(d, {"frame_number": 15_234 + np.arange(N)} | IMU), None, {"t": ()},
        "frame_number counts rows: which [source] rate"),
    "sequence with lost rows": (
        lambda d: csv(d, {"seq": LOST} | IMU), None, {"t": ()}, "seq counts rows"),
    "milliseconds by their epoch": (
        lambda d: csv(d, {"t": UNIX * 1e3 + np.arange(N)} | IMU), None, {"t": ("t", "ms")}, ""),
    "frames of a reference": (
        lambda d: (csv(d, {"t": T} | IMU), csv(d, FRAMES, "mocap.csv")), None,
        {"reference t": ("Frame", None, "gain = 1 / rate")}, ""),
    "feet without names, in the order of the joints' legs": (
        lambda d: csv(d, {"t": T} | JOINTS_OF_RIGHT_FIRST | FEET), None,
        {f"force_{leg}": (f"footForce[{k}]",) for k, leg in enumerate(RIGHT_FIRST)}, ""),
    "a gyro in counts": (
        lambda d: csv(d, {"t": T} | COUNTS), None, {"gyro_x": ("gyro_x", "deg/s", "counts")}, ""),
    "parameters above a table": (
        lambda d: text(d, ["name,value", "mass,0", "kp,1", "kd,2", "", *lines_of(t=T, **IMU)]),
        None, {"accel_z": ("acc_z",)}, ""),
    "counted feet, in the order of their numbers": (
        lambda d: csv(d, {"t": T} | {f"contact_{k}": STANDS[:, k] for k in (2, 0, 3, 1)}), None,
        {f"contact_{leg}": (f"contact_{k}",) for k, leg in enumerate(LEGS)}, ""),
    "counted contacts of a group, as gym-quadruped writes them": (
        lambda d: h5(d, **{f"recordings/{name}": x for name, x in GYM.items()}), None,
        {f"contact_{leg}": (f"recordings/contact_state[{k}]", None, "feet")
         for k, leg in enumerate(LEGS)}, ""),
    "angles without a name beside those that have one": (
        lambda d: csv(d, {"t": T} | HINGES | {"angle": T}), None,
        {f"q_{joint}": (f"q_{joint}",) for joint in JOINTS}, ""),
    "a text without a header": (
        lambda d: csv(d, {"a": T, "b": np.sin(T)}, header=False), None,
        {"t": ("0", "s", "is this the time"), "x_1": ()}, "no name says what a column is"),
    "readings, filtered ones, targets and what a drive compensates": (
        lambda d: csv(d, BENCH), None,
        {f"{ours}_joint{k}": (f"{of}{k + 1}",) for k in (0, 1) for ours, of in DRIVE.items()}
        | {"tau_ff_joint0": ("tau_con1", "N m", "this, or tau_des1?")}, ""),
}  # fmt: skip


@pytest.mark.parametrize("case", DRAFTED)
@pytest.mark.filterwarnings("error")
def test_a_form_is_drafted_or_asked_about(tmp_path, case):
    make, robot, entries, noted = DRAFTED[case]
    files = make(tmp_path)
    draft = guess_map(files if isinstance(files, tuple) else [files], robot)
    check_entries(draft, entries)
    assert noted in " ".join(draft.notes)
    assert not any("what are its columns" in note for note in draft.notes)


STATED = {
    # rate in the draft, where it is stated
    "step of a simulator": (100.0, {"step_dt": 0.01}),
    "step in an array": (100.0, {"dt": np.array([0.01])}),
    "rate": (250.0, {"sampleRate": 250.0}),
    "step of the simulation and of the policy": (50.0, {"sim_dt": 0.005, "step_dt": 0.02}),
    "step in each row": (100.0, {"dt": np.full(N, 0.01)}),
}


@pytest.mark.parametrize("case", STATED)
def test_a_rate_that_the_file_states_is_drafted_and_asked(tmp_path, case):
    rate, given = STATED[case]
    draft = guess_map([npz(tmp_path, q=ANGLES, gyro=GYRO, **given)])
    assert draft.rate == (pytest.approx(rate), list(given)[-1])
    (line,) = (line for line in draft.text.splitlines() if line.startswith("rate = "))
    assert list(given)[-1] in line.partition("# ?")[2]


def test_numbers_and_texts_beside_the_arrays_are_no_columns_and_rename_nothing(tmp_path):
    """They are listed as parameters; a text without names of joints is not mentioned."""
    (tmp_path / "notes.txt").write_text("a walk to the left and to the right\n")
    draft = guess_map([npz(tmp_path, t=T, gyro=GYRO, q=ANGLES, dt=0.002, decimation=5)])
    assert {"dt", "decimation"} == {n for names in draft.unused.values() for n in names}
    assert draft.rate is None
    assert "notes" not in entries_of(draft)["q_FL_hip"].doubt
    np.savez(tmp_path / "legs.npz", t=T, q=ANGLES, dt=0.01)
    draft = guess_map([csv(tmp_path, {"t": T} | IMU), tmp_path / "legs.npz"])
    assert list(draft.sources) == ["legs"]


def test_a_dash_is_an_empty_cell_and_a_row_of_units_no_row(tmp_path):
    forces = {f"force_{leg}": 100.0 + 0.0 * T for leg in ("FL", "FR", "RL", "RR")}
    frame = pd.DataFrame({"t": 1e3 * T} | IMU | forces).astype({"force_RL": object})
    frame.loc[5:8, "force_RL"] = "-"
    lines = csv(tmp_path, frame).read_text().splitlines()
    run = text(tmp_path, [lines[0], "ms" + ",SI" * 6 + ",N" * 4, *lines[1:]])
    draft = guess_map([run])
    check_entries(draft, {"force_RL": ("force_RL",), "t": ("t", "ms")})
    np.testing.assert_allclose(imported(run, draft).gyro, GYRO, atol=1e-9)


def test_records_of_two_kinds_with_one_clock_are_drafted(tmp_path):
    records = []
    for t, gyro, accel, q in zip(T, GYRO.tolist(), ACCEL.tolist(), ANGLES.tolist(), strict=True):
        records.append(json.dumps({"type": "imu", "t": t, "gyro": gyro, "acc": accel}))
        records.append(json.dumps({"type": "joints", "t": t, "q": q}))
    run = written(tmp_path / "run.jsonl", "\n".join(records))
    draft = guess_map([run], "spot_class")
    assert {"t", "gyro_x", "accel_z", "q_FL_hip"} <= {one.name for one in draft.main}
    np.testing.assert_allclose(imported(run, draft).q, ANGLES, atol=1e-9)


def lines_of(**columns: np.ndarray) -> list[str]:
    return pd.DataFrame(columns).to_csv(index=False).splitlines()


LONG = np.linspace(0.0, 60.0, 6001)
GYROS = {f"gyro_{a}": GYRO[:, k] for k, a in enumerate("xyz")}
HINGES = {f"q_{joint}": ANGLES[:, k] for k, joint in enumerate(JOINTS)}
NO_TABLE = {
    # lines, and the one that is named
    "tables of two kinds": ([*lines_of(t=T, **GYROS), "", *lines_of(t=T, **HINGES)], 2),
    "tables of one width": (
        [*lines_of(t=T, **GYROS), "# second", *lines_of(t=T, **GYROS)], 202),
    "titles above each": (
        ["IMU", "100", *lines_of(t=T, **GYROS), "", "Joints", "100", *lines_of(t=T, **HINGES)],
        2),
    "a header in the middle": ([*lines_of(t=T, **GYROS), *lines_of(t=T + T[-1], **GYROS)], 202),
    "a header far below": (
        [*lines_of(t=LONG, gyro_x=LONG, gyro_y=LONG), "", *lines_of(t=LONG, q=LONG)], 6004),
    "values after their names": (
        [f"t={t:.3f} gyro_x={x:.4f} mode=walk" for t, x in zip(T, GYRO[:, 0], strict=True)], 2),
    "names with colons": (
        [f"t: {t:.3f}, gyro_x: {x:.4f}" for t, x in zip(T, GYRO[:, 0], strict=True)], 2),
    "kinds that differ in length": (
        [line for t in T for line in (f"$IMU,{t:.3f},1,2,3", f"$LEG,{t:.3f},1,2,3,4")], 2),
    "JSON": ([json.dumps({"t": t, "gyro": [0.1, 0.2]}) for t in T], 2),
    "kinds after comments": (["# a log", *["IMU 1 2 3", "LEG 1 2"] * 20], 3),
    "kinds after the time": (["0.1 imu 1 2 3", "0.1 foot 1"] * 20, 2),
    "YAML": ([line for t in T for line in ("header:", f"  sec: {t}", "x: 0.1", "---")], 4),
    "YAML with lists": (["name:", "- a", "- b", "position: ", "  - 1.0", "---"] * 20, 4),
}  # fmt: skip


@pytest.mark.parametrize("case", NO_TABLE)
def test_a_text_that_is_no_single_table_is_refused_with_file_and_line(tmp_path, case):
    lines, number = NO_TABLE[case]
    message = refusal(guess_map, [text(tmp_path, lines)])
    assert "run.txt" in message
    assert re.search(rf"line {number}\b", message), message


MAP = "[columns]\nt = 't'\nx_speed = 'speed'\n[reference]\nfile = 'mocap.csv'\n"
MAP += as_named(("t", *POSE), "reference.columns")


def with_mocap(folder: Path, robot: np.ndarray, mocap: pd.DataFrame):
    csv(folder, mocap, "mocap.csv")
    run = csv(folder, {"t": robot, "speed": np.sin(robot)})
    return imported(run, MAP)


def test_stamps_in_another_unit_than_the_reference_are_named(tmp_path):
    assert "unit" in refusal(with_mocap, tmp_path, 1e3 * T + 1e4, poses(T, 0.1))


def test_a_tracker_that_lost_the_body_leaves_a_gap(tmp_path):
    frame = poses(T, 0.1)
    frame.loc[80:110, POSE] = 0.0
    log = with_mocap(tmp_path, T, frame)
    assert 0 < np.sum(log.frame["ref_ok"] == 0.0) < 40


@pytest.mark.parametrize("mark", ["\x1b[31m", "\x7f", "\x9b", "\u202e"])
def test_control_characters_of_names_do_not_reach_a_draft(tmp_path, mark):
    """They would reach a terminal, and TOML allows none of them; the file's columns are found."""
    columns = {f"gyro_{axis}{mark}": np.sin(k * T) for k, axis in enumerate("xyz", 1)}
    draft = guess_map([csv(tmp_path, {"t": T, **columns, f"odd{mark}": np.cos(9.0 * T)})])
    assert mark not in draft.text
    said = tomllib.loads(draft.text)
    assert said["columns"]["gyro_x"]["column"] == f"gyro_x{mark}"
    assert "odd" in draft.text
