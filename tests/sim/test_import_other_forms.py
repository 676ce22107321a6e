"""Recordings as people bring them: forms that a draft reads or asks about, and refusals that name
the cause and the next step. One table for each kind."""

import json
import pickle
import re
import subprocess
import tomllib
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from refusals import refusal
from written import written

from surefoot.sim.importing.guessing.draft import Draft
from surefoot.sim.importing.guessing.guess import guess_map
from surefoot.sim.importing.recording import import_log
from surefoot.sim.log import JOINTS

N = 200
T = 0.01 * np.arange(1, N + 1)
UNIX = 1_700_000_000
GYRO = 0.3 * np.sin(2.0 * T[:, None] + np.arange(3))
ACCEL = np.column_stack([0.1 * np.sin(T), 0.1 * np.cos(T), 9.81 + 0.0 * T])
ANGLES = np.tile([0.0, 0.8, -1.5], 4) + 0.2 * np.sin(6.0 * T[:, None] + np.arange(12))
RNG = np.random.default_rng(0)
IMU = {f"gyro_{a}": GYRO[:, k] for k, a in enumerate("xyz")}
IMU |= {f"acc_{a}": ACCEL[:, k] for k, a in enumerate("xyz")}
NAMES = [f"{joint}_joint" for joint in reversed(JOINTS)]


def csv(folder: Path, columns) -> Path:
    pd.DataFrame(columns).to_csv(folder / "run.csv", index=False)
    return folder / "run.csv"


def text(folder: Path, lines) -> Path:
    (folder / "run.txt").write_text("\n".join(lines) + "\n")
    return folder / "run.txt"


def npz(folder: Path, **arrays) -> Path:
    np.savez(folder / "run.npz", **arrays)
    return folder / "run.npz"


def pickled(folder: Path, content: object) -> Path:
    (folder / "run.pkl").write_bytes(pickle.dumps(content))
    return folder / "run.pkl"


def json_lines(folder: Path) -> Path:
    kinds = [
        one
        for k in range(N)
        for one in (
            {"type": "imu", "t": T[k], "gyro": [*GYRO[k]], "acc": [*ACCEL[k]]},
            {"type": "joints", "t": T[k], "q": [*ANGLES[k]]},
        )
    ]
    (folder / "run.jsonl").write_text("".join(json.dumps(one) + "\n" for one in kinds))
    return folder / "run.jsonl"


def drafted(path: Path, robot: str | None = None) -> Draft:
    return guess_map([path], robot)


def entry(draft: Draft, name: str):
    return next(one for one in (*draft.main, *draft.reference) if one.name == name)


STAMPS = {
    # name of the stamps in the draft, the recording's columns of them
    "seconds and nanoseconds": (
        "header.stamp",
        {
            "header.stamp.secs": (UNIX + T).astype(int),
            "header.stamp.nsecs": np.round(T % 1.0 * 1e9).astype(int) % 10**9,
        },
    ),
    "dates": (
        "time",
        {"time": pd.to_datetime(UNIX + T, unit="s").strftime("%Y-%m-%d %H:%M:%S.%f")},
    ),
    "dates of ISO": ("time", {"time": [f"{x.isoformat()}Z" for x in pd.to_datetime(T, unit="s")]}),
    "times of day": ("time", {"time": pd.to_datetime(T, unit="s").strftime("%H:%M:%S.%f")}),
}


@pytest.mark.parametrize("case", STAMPS)
def test_stamps_that_are_split_or_written_are_seconds(tmp_path, case):
    name, columns = STAMPS[case]
    run = csv(tmp_path, columns | IMU)
    draft = drafted(run)
    assert entry(draft, "t").theirs == name
    log = import_log(run, written(tmp_path / "map.toml", draft.text))
    assert len(log.t) == N
    np.testing.assert_allclose(log.t - log.t[0], T - T[0], atol=2e-6)


ARRAYS = {
    "one robot of a vectorised simulator": {"q": ANGLES[:, None], "gyro": GYRO[:, None], "t": T},
    "fewer rows than joints": {"q": ANGLES[:9], "gyro": GYRO[:9], "kp": np.ones(12), "t": T[:9]},
    "times as dates": {
        "q": ANGLES, "t": (1e9 * T).astype("i8").astype("datetime64[ns]"), "gyro": GYRO,
    },
    "names in bytes": {"q": ANGLES[:, ::-1], "dof_names": np.array(NAMES, "S"), "t": T},
}  # fmt: skip


@pytest.mark.parametrize("case", ARRAYS)
@pytest.mark.filterwarnings("error")
def test_arrays_of_a_rollout_are_read_whatever_their_form(tmp_path, case):
    draft = drafted(npz(tmp_path, **ARRAYS[case]), "spot_class")
    assert entry(draft, "t").unit == "s"
    place = 11 if case == "names in bytes" else 0
    assert entry(draft, "q_FL_hip").theirs == f"q[{place}]"
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
    draft = drafted(npz(tmp_path, q=ANGLES, gyro=GYRO, **given))
    assert draft.rate == (pytest.approx(rate), list(given)[-1])
    (line,) = (line for line in draft.text.splitlines() if line.startswith("rate = "))
    assert list(given)[-1] in line.partition("# ?")[2]


def test_numbers_of_a_file_that_are_no_columns_are_listed(tmp_path):
    draft = drafted(npz(tmp_path, t=T, gyro=GYRO, dt=0.002, decimation=5))
    assert {"dt", "decimation"} == {n for names in draft.unused.values() for n in names}
    assert draft.rate is None


LOST = np.arange(N) + 7 * (np.arange(N) > 100)
COUNTED = {
    # column that counts rows
    "ticks": {"tick": np.arange(N)},
    "frames from 1": {"Frame": np.arange(1, N + 1)},
    "frames of a camera": {"frame_number": 15_234 + np.arange(N)},
    "sequence with lost rows": {"seq": LOST},
}


@pytest.mark.parametrize("case", COUNTED)
def test_a_count_of_rows_is_no_time_but_asks_for_the_rate(tmp_path, case):
    (name,) = COUNTED[case]
    draft = drafted(csv(tmp_path, COUNTED[case] | IMU))
    assert "t" not in {one.name for one in draft.main}
    assert any(name in note and "rate" in note for note in draft.notes)


@pytest.mark.parametrize("stamps", [{"time_ms": np.arange(N)}, {"t": UNIX * 1e3 + np.arange(N)}])
def test_stamps_of_a_kilohertz_are_times_by_their_unit_or_epoch(tmp_path, stamps):
    assert entry(drafted(csv(tmp_path, stamps | IMU)), "t").unit == "ms"


def test_frames_of_a_reference_are_its_times_after_a_gain_that_is_asked(tmp_path):
    frame = poses(T).rename(columns={"t": "Frame"})
    frame.assign(Frame=np.arange(N)).to_csv(tmp_path / "mocap.csv", index=False)
    draft = guess_map([csv(tmp_path, {"t": T} | IMU), tmp_path / "mocap.csv"])
    t = next(one for one in draft.reference if one.name == "t")
    assert (t.theirs, t.unit) == ("Frame", None)
    assert "gain = 1 / rate" in t.doubt


LISTED = {
    "more names than joints": {"dof_names": [*NAMES, "arm_joint"]},
    "a root first": {"body_names": ["base", *NAMES]},
}


@pytest.mark.parametrize("case", LISTED)
@pytest.mark.parametrize("robot", [None, "spot_class"])
def test_names_of_another_number_than_the_joints_are_mentioned(tmp_path, case, robot):
    ((name, names),) = LISTED[case].items()
    draft = drafted(npz(tmp_path, q=ANGLES, t=T, **LISTED[case]), robot)
    assert f"{name} has {len(names)} names, not 12" in entry(draft, "q_FL_hip").doubt


@pytest.mark.parametrize("names", [None, [*NAMES, *(f"{k}_wheel" for k in range(8))]])
def test_places_of_a_list_without_a_motor_are_no_joints(tmp_path, names):
    """As the last eight of a Go2's twenty; but if the file names them, they are its joints."""
    q = np.column_stack([ANGLES, np.zeros((N, 8))])
    arrays = {"motor_q": q, "motor_dq": 0.0 * q, "t": T} | ({"dof_names": names} if names else {})
    draft = drafted(npz(tmp_path, **arrays), "spot_class")
    found = [one for one in draft.main if one.name.startswith("q_")]
    assert len(found) == (20 if names else 12)
    assert all(("dof_names" in one.doubt) == bool(names) for one in found)


def test_names_in_a_file_of_hdf5_are_the_order_of_its_joints(tmp_path):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["t"], file["q"] = T, ANGLES[:, ::-1]
        file["joint_names"] = NAMES
    found = entry(drafted(tmp_path / "run.h5", "spot_class"), "q_FL_hip")
    assert (found.theirs, "joint_names" in found.doubt) == ("q[11]", True)


def test_numbers_beside_the_arrays_of_a_further_file_do_not_rename_it(tmp_path):
    np.savez(tmp_path / "legs.npz", t=T, q=ANGLES, dt=0.01)
    draft = guess_map([csv(tmp_path, {"t": T} | IMU), tmp_path / "legs.npz"])
    assert list(draft.sources) == ["legs"]


def test_text_beside_a_file_that_names_no_joints_is_not_mentioned(tmp_path):
    (tmp_path / "notes.txt").write_text("a walk to the left and to the right\n")
    assert "notes" not in entry(drafted(npz(tmp_path, q=ANGLES, t=T)), "q_FL_hip").doubt


def test_feet_without_names_are_in_the_order_of_the_legs_of_the_joints(tmp_path):
    legs = ("FR", "FL", "RR", "RL")
    joints = {f"q_{leg}_{part}": T for leg in legs for part in ("hip", "thigh", "calf")}
    forces = {f"footForce[{k}]": 100.0 + T for k in range(4)}
    draft = drafted(csv(tmp_path, {"t": T} | joints | forces))
    assert [entry(draft, f"force_{leg}").theirs for leg in legs] == [*forces]


def test_a_gyro_in_counts_is_asked_about(tmp_path):
    columns = {n: 900.0 * x for n, x in IMU.items()}
    columns |= {f"gyro_{a}": RNG.normal(0.0, 200.0, N) for a in "xyz"}
    assert "counts" in entry(drafted(csv(tmp_path, {"t": T} | columns)), "gyro_x").doubt


def test_a_dash_is_an_empty_cell_of_its_column(tmp_path):
    forces = {f"force_{leg}": 100.0 + 0.0 * T for leg in ("FL", "FR", "RL", "RR")}
    frame = pd.DataFrame({"t": T} | IMU | forces).astype({"force_RL": object})
    frame.loc[5:8, "force_RL"] = "-"
    draft = drafted(csv(tmp_path, frame))
    assert entry(draft, "force_RL").theirs == "force_RL"
    assert len(import_log(tmp_path / "run.csv", written(tmp_path / "map.toml", draft.text)).t) == N


def test_a_row_of_units_is_no_row(tmp_path):
    lines = csv(tmp_path, {"t": 1e3 * T} | IMU).read_text().splitlines()
    run = text(tmp_path, [lines[0], "ms" + ",SI" * 6, *lines[1:]])
    draft = drafted(run)
    (tmp_path / "map.toml").write_text(draft.text)
    np.testing.assert_allclose(import_log(run, tmp_path / "map.toml").gyro, GYRO, atol=1e-9)


def test_records_of_two_kinds_with_one_clock_are_drafted(tmp_path):
    draft = drafted(json_lines(tmp_path), "spot_class")
    assert {"t", "gyro_x", "accel_z", "q_FL_hip"} <= {one.name for one in draft.main}
    log = import_log(tmp_path / "run.jsonl", written(tmp_path / "map.toml", draft.text))
    np.testing.assert_allclose(log.q, ANGLES, atol=1e-9)


def two_kinds() -> list[str]:
    return [
        line for t in T for line in (f"$IMU,{t:.3f},1,2,3", f"$LEG,{t:.3f},1,2,3,4")
    ]  # fmt: skip


def lines_of(**columns: np.ndarray) -> list[str]:
    return pd.DataFrame(columns).to_csv(index=False).splitlines()


GYROS = {f"gyro_{a}": GYRO[:, k] for k, a in enumerate("xyz")}
HINGES = {f"q_{joint}": ANGLES[:, k] for k, joint in enumerate(JOINTS)}
CUT = {
    "tables of two kinds": [*lines_of(t=T, **GYROS), "", *lines_of(t=T, **HINGES)],
    "tables of one width": [*lines_of(t=T, **GYROS), "# second", *lines_of(t=T, **GYROS)],
    "titles above each": ["IMU", "100", *lines_of(t=T, **GYROS), "", "Joints", "100",
                          *lines_of(t=T, **HINGES)],
    "a header in the middle": [*lines_of(t=T, **GYROS), *lines_of(t=T + T[-1], **GYROS)],
    "values after their names": [f"t={t:.3f} gyro_x={x:.4f} gyro_y=0.1 gyro_z=0 mode=walk"
                                 for t, x in zip(T, GYRO[:, 0], strict=True)],
    "names with colons": [f"t: {t:.3f}, gyro_x: {x:.4f}, gyro_y: 0.1, gyro_z: -1e-3"
                          for t, x in zip(T, GYRO[:, 0], strict=True)],
}  # fmt: skip


@pytest.mark.parametrize("case", CUT)
def test_the_command_that_a_refusal_advises_makes_tables_that_are_drafted(tmp_path, case):
    message = refusal(drafted, text(tmp_path, CUT[case]).rename(tmp_path / "a run.txt"))
    command = re.split("make a (?:table|file of each): ", message)[1]
    subprocess.run(["sh", "-c", command], cwd=tmp_path, check=True)
    made = sorted(tmp_path.glob("*.csv"))
    assert len(made) == (1 if "names" in case else 2)
    drafts = [drafted(one) for one in made]
    assert entry(drafts[0], "gyro_x").theirs == "gyro_x"
    assert all(entry(one, "t").unit == "s" for one in drafts)


def test_parameters_above_a_table_are_no_table(tmp_path):
    above = ["name,value", *(f"{n},{k}" for k, n in enumerate(("mass", "kp", "kd"))), ""]
    draft = drafted(text(tmp_path, [*above, *lines_of(t=T, **IMU)]))
    assert entry(draft, "accel_z").theirs == "acc_z"


REFUSED = {
    "tags of the shell": (lambda d: text(d, two_kinds()), ("lines of several kinds", "'$IMU.txt'")),
    "JSON": (lambda d: text(d, [json.dumps({"t": t, "gyro": [0.1, 0.2]}) for t in T]), (".jsonl",)),
    "an object array": (
        lambda d: npz(d, t=T, info=np.array({"q": 1}, dtype=object)),
        ("Object", "np.savez"),
    ),
    "a pickle": (lambda d: pickled(d, {"q": ANGLES}), ("pickle", "np.savez")),
    "lists": (lambda d: text(d, [json.dumps([t, 0.1, -0.2]) for t in T]), (".jsonl",)),
    "many robots": (
        lambda d: npz(d, q=np.repeat(ANGLES[:, None], 8, 1), gyro=np.repeat(GYRO[:, None], 8, 1)),
        ("8 episodes or robots of 200 rows",),
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_refusal_names_cause_and_next_step(tmp_path, case):
    make, words = REFUSED[case]
    message = refusal(drafted, make(tmp_path))
    assert all(word in message for word in words), message


MAP = (
    "[columns]\nt = 't'\nx_speed = 'speed'\n[reference]\nfile = 'mocap.csv'\n[reference.columns]\n"
)
POSE = ["ref_p_x", "ref_p_y", "ref_p_z", "ref_q_w", "ref_q_x", "ref_q_y", "ref_q_z"]


def with_mocap(folder: Path, robot: np.ndarray, mocap: pd.DataFrame):
    csv(folder, {"t": robot, "speed": np.sin(robot)})
    mocap.to_csv(folder / "mocap.csv", index=False)
    (folder / "map.toml").write_text(MAP + "".join(f"{n} = '{n}'\n" for n in ("t", *POSE)))
    return import_log(folder / "run.csv", folder / "map.toml")


def poses(t) -> pd.DataFrame:
    frame = pd.DataFrame({"t": t} | dict.fromkeys(POSE, 0.0))
    return frame.assign(ref_p_x=0.1 * np.arange(len(t)), ref_q_w=1.0)


MISSED = {
    "a clock set back within its time": (
        np.concatenate([T[:100], T[50:150] + 0.003]), T, ("jumps back", "line 102"),
    ),
    "milliseconds": (1e3 * T + 1e4, T, ("unit",)),
}  # fmt: skip


@pytest.mark.parametrize("case", MISSED)
def test_clocks_that_do_not_fit_are_told_apart(tmp_path, case):
    robot, mocap, words = MISSED[case]
    message = refusal(with_mocap, tmp_path, robot, poses(mocap))
    assert all(word in message for word in words), message


def test_a_tracker_that_lost_the_body_leaves_a_gap(tmp_path):
    frame = poses(T)
    frame.loc[80:110, POSE] = 0.0
    log = with_mocap(tmp_path, T, frame)
    assert 0 < np.sum(log.frame["ref_ok"] == 0.0) < 40


@pytest.mark.parametrize("mark", ["\x1b[31m", "\x7f", "\x9b", "\u202e"])
def test_control_characters_of_names_do_not_reach_a_draft(tmp_path, mark):
    """They would reach a terminal, and TOML allows none of them; the file's columns are found."""
    columns = {f"gyro_{axis}{mark}": np.sin(k * T) for k, axis in enumerate("xyz", 1)}
    draft = drafted(csv(tmp_path, {"t": T, **columns, f"odd{mark}": np.cos(9.0 * T)}))
    assert mark not in draft.text
    said = tomllib.loads(draft.text)
    assert said["columns"]["gyro_x"]["column"] == f"gyro_x{mark}"
    assert "odd" in draft.text
