"""One recording in many forms gives one log: files, clocks, layouts and conventions."""

import json
import shutil
import tracemalloc
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from recorded import as_named, csv, imported, saved
from refusals import refused
from scipy.spatial.transform import Rotation
from written import written

import surefoot.sim.importing.readers.file as file_module
from studies.measured import measured_folder
from surefoot.sim.importing.guessing.guess import guess_map
from surefoot.sim.importing.guessing.recorded_file import recorded_files
from surefoot.sim.importing.readers.array_file import read_hdf5, read_mat, rows_first
from surefoot.sim.importing.readers.file import read_file
from surefoot.sim.importing.readers.json_file import read_json
from surefoot.sim.importing.readers.table import RecordedTable, column_readings
from surefoot.sim.importing.recording import import_log, read_recording
from surefoot.sim.importing.report import import_lines
from surefoot.sim.importing.sections import Source
from surefoot.sim.importing.streams import held_streams
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.catalog import robot_file, robot_of_log

MEASURED = measured_folder()
ROWS = 60
T = 0.01 * np.arange(ROWS)
READINGS = {
    "t": T,
    "gyro_x": np.sin(3.0 * T),
    "gyro_y": np.cos(2.0 * T),
    "gyro_z": 0.1 * T,
    "accel_x": 0.2 * T,
    "accel_y": -0.1 * T,
    "accel_z": 9.81 + 0.1 * np.sin(T),
    "q_knee": 0.5 + T,
}
PLAIN = as_named(READINGS)
LISTS = '[columns]\nt = "t"\nq_knee = "q[0]"\n' + "".join(
    f'{kind}_{axis} = "{kind}[{k}]"\n' for kind in ("gyro", "accel") for k, axis in enumerate("xyz")
)


def vectors(kind: str) -> np.ndarray:
    return np.column_stack([READINGS[f"{kind}_{axis}"] for axis in "xyz"])


def lists() -> dict[str, np.ndarray]:
    q = READINGS["q_knee"][:, None]
    return {"t": T, "gyro": vectors("gyro"), "accel": vectors("accel"), "q": q}


def long() -> pd.DataFrame:
    each = [pd.DataFrame({"t": T, "what": n, "value": v}) for n, v in READINGS.items() if n != "t"]
    return pd.concat(each).sort_values("t", kind="stable")


def matlab_7_3(folder: Path) -> Path:
    path = saved(folder / "run.h5", {n: np.atleast_2d(x.T) for n, x in lists().items()})
    with h5py.File(path, "a") as file:
        for one in file.values():
            one.attrs["MATLAB_class"] = np.bytes_("double")
    return path.rename(folder / "run.mat")


def parquet(folder: Path) -> Path:
    pd.DataFrame(READINGS).to_parquet(folder / "run.parquet")
    return folder / "run.parquet"


NUMBERED = "[columns]\n" + "".join(f'{name} = "{k}"\n' for k, name in enumerate(READINGS))
CELLS = {name: values.tolist() for name, values in lists().items()}
RECORDS = [dict(zip(CELLS, row, strict=True)) for row in zip(*CELLS.values(), strict=True)]
JSON_LINES = "\n".join(json.dumps({"robot": row}) for row in RECORDS)
FORMS = {
    "csv": (lambda d: csv(d, READINGS), PLAIN),
    "semicolons": (
        lambda d: csv(d, READINGS, sep=";", decimal=","), f'[source]\ndecimal = ","\n{PLAIN}'),
    "spaces": (lambda d: csv(d, READINGS, sep=" "), PLAIN),
    "no header": (
        lambda d: csv(d, READINGS, header=False), f"[source]\nheader = false\n{NUMBERED}"),
    "lists": (lambda d: csv(d, CELLS), LISTS),
    "long": (
        lambda d: csv(d, long()),
        f'[source]\nlong = {{ name = "what", value = "value" }}\n{PLAIN}'),
    "json lists": (lambda d: written(d / "run.json", json.dumps(CELLS)), LISTS),
    "json lines": (
        lambda d: written(d / "run.jsonl", JSON_LINES), LISTS.replace('= "', '= "robot.')),
    "npz": (lambda d: saved(d / "run.npz", lists()), LISTS),
    "mat": (
        lambda d: saved(d / "run.mat", {"log": {**lists(), "name": "walk"}, "version": 3}),
        LISTS.replace('= "', '= "log.')),
    "mat 7.3": (matlab_7_3, LISTS),
    "hdf5": (
        lambda d: saved(d / "run.h5", {f"robot/{name}": x for name, x in lists().items()}),
        LISTS.replace('= "', '= "robot/')),
    "parquet": (parquet, PLAIN),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_readings_that_went_in(tmp_path, form):
    write, rules = FORMS[form]
    log = imported(write(tmp_path), rules)
    for name, values in READINGS.items():
        np.testing.assert_allclose(log.frame[name], values, atol=1e-12)
    log.write(tmp_path / "log.parquet")
    pd.testing.assert_frame_equal(Log.read(tmp_path / "log.parquet").frame, log.frame)


def test_the_memory_for_a_text_is_that_of_its_worst_case(tmp_path, monkeypatch):
    """Empty records: 64 bytes each and 8 for its place, of 3 bytes of text, beside the text."""
    path = written(tmp_path / "run.json", "[" + 20_000 * "{}," + "{}]")
    tracemalloc.start()
    kept = json.loads(path.read_text())
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(kept) == 20_001
    monkeypatch.setenv("SUREFOOT_LIMITS", f"memory={1.06 * most}")
    refused("no records and no lists in it", read_json, path)
    monkeypatch.setenv("SUREFOOT_LIMITS", f"memory={0.94 * most}")
    refused("bytes in memory", read_json, path)


@pytest.mark.parametrize(
    ("seldom", "often"), [("q_knee", "gyro_x"), ("vicon_gyro_x", "vicon_p_x")], ids=["gyro", "none"]
)
def test_rows_with_empty_cells_are_those_of_the_gyro(tmp_path, seldom, often):
    """What is listed before it and read less often is interpolated. A tracked body's rates are no
    gyro: without one, the rows are those of what was read most often."""
    t = 0.01 * np.arange(200)
    few, many = np.arange(200) % 8 == 1, np.arange(200) % 2 == 1
    table = {"t": t, seldom: np.where(few, t, np.nan), often: np.where(many, -t, np.nan)}
    (found,) = recorded_files(csv(tmp_path, table), None)
    np.testing.assert_allclose(found.columns["t"], t[many])
    np.testing.assert_allclose(found.columns[often], -t[many])
    np.testing.assert_allclose(found.columns[seldom][:-3], t[many][:-3])


def test_the_stamps_in_the_messages_of_a_bag_are_its_times_and_rise(tmp_path, monkeypatch):
    """Also where the recorder received them at other times."""
    stamps = 5.0 + T
    received = np.sort(np.random.default_rng(0).uniform(0.0, 1.0, ROWS))
    cells = {"/legs:stamp": stamps, "/legs:knee": np.sin(T)}
    seen = RecordedTable(tmp_path / "run.bag", cells, "message", stamps={"/legs": received})
    monkeypatch.setattr(file_module, "read_bag", lambda path, columns: seen)
    rules = '[columns]\nt = "/legs:stamp"\nq_knee = "/legs:knee"\n'
    log = imported(tmp_path / "run.bag", rules)
    np.testing.assert_allclose(log.t, stamps)
    np.testing.assert_allclose(log.q[:, 0], np.sin(T))
    stamps[7:20] = stamps[6]
    refused(r"run.bag.*'/legs:stamp', message 8: repeats", imported, tmp_path / "run.bag", rules)


SEVERAL = """
[columns]
t = { column = "ms", unit = "ms" }
gyro_x = "imu:wx"
gyro_y = "imu:wx"
gyro_z = "imu:wx"
accel_x = "imu:wx"
accel_y = "imu:wx"
accel_z = { column = "imu:az", unit = "g" }
q_knee = { column = "counts", gain = 0.00153398078788564, wrap = 4096.0, offset = -0.5 }
contact_left = { column = "events:left", word = "down" }
contact_right = { column = "events:right", word = "down" }
[sources.imu]
file = "imu.txt"
t = { column = "stamp", unit = "us", offset = -100.0 }
[sources.events]
file = "events.csv"
t = "time"
long = { name = "foot", value = "state" }
"""


def test_files_of_other_rates_and_clocks_come_onto_the_rows_of_the_first(tmp_path):
    t = 0.01 * np.arange(500)
    angle = 3.0 * np.sin(2.0 * t)
    counts = np.round((angle + 0.5) / (2.0 * np.pi) * 4096.0) % 4096
    fast = np.arange(-0.1, 5.1, 0.0025)
    rate = np.cos(2.0 * np.pi * 5.0 * fast)
    csv(tmp_path, {"stamp": 1e6 * (fast + 100.0), "wx": rate, "az": 1.0}, "imu.txt", sep=" ")
    rows = "-1,left,down\n-1,right,up\n1.234,left,up\n1.234,right,down\n3.0,left,down\n"
    (tmp_path / "events.csv").write_text(f"time,foot,state\n{rows}")
    log = imported(csv(tmp_path, {"ms": 1e3 * t, "counts": counts}), SEVERAL)
    assert log.rate == 100.0
    # Jumps by a turn are undone: the angle passes half a turn on either side.
    np.testing.assert_allclose(log.q[:, 0], angle, atol=1e-3)
    np.testing.assert_allclose(log.accel[:, 2], 9.80665)
    # A faster IMU is averaged over the row, which is its integral from row to row.
    turned = np.diff(np.sin(2.0 * np.pi * 5.0 * t) / (2.0 * np.pi * 5.0)) / 0.01
    np.testing.assert_allclose(log.gyro[1:, 0], turned, atol=0.05)
    assert np.abs(log.gyro[1:, 0] - np.cos(2.0 * np.pi * 5.0 * t[1:])).max() > 0.1
    np.testing.assert_array_equal(log.contact[:, 0], (log.t < 1.234) | (log.t >= 3.0))
    np.testing.assert_array_equal(log.contact[:, 1], log.t >= 1.234)


def test_further_files_may_be_named_on_the_command_line_and_none_is_left_over(tmp_path):
    rules = SEVERAL.replace('file = "imu.txt"\n', "").replace('file = "events.csv"\n', "")
    files = [
        written(tmp_path / "a.csv", "ms,counts\n0,1\n10,2\n20,3\n"),
        written(tmp_path / "b.csv", "stamp,wx,az\n99e6,0,1\n101e6,0,1\n"),
        written(tmp_path / "c.csv", "time,foot,state\n-1,left,up\n-1,right,up\n"),
    ]
    assert len(imported(files, rules).t) == 3
    refused(r"sources.events\] has no file", imported, files[:2], rules)
    refused(r"c.csv: .* has no use for this file", imported, [*files, files[2]], rules)


def test_a_reference_may_be_angles_in_a_world_with_y_up_and_from_world_to_body(tmp_path):
    t = 0.01 * np.arange(100)
    angles = np.column_stack([0.3 * np.sin(t), 0.2 * np.cos(t), t])
    R_GM = Rotation.from_euler("ZYX", angles[:, ::-1])
    p_G = np.column_stack([t, 0.5 * t, 0.3 + 0.0 * t])
    R_GW = Rotation.from_quat([np.sqrt(0.5), np.sqrt(0.5), 0, 0], scalar_first=True)
    p_W = R_GW.inv().apply(p_G)
    np.testing.assert_allclose(p_W[:, 1], 0.3)  # y is up
    q_MW = (R_GW.inv() * R_GM).inv().as_quat(scalar_first=True)
    euler = ["ref_roll", "ref_pitch", "ref_yaw"]
    quaternion = [f"ref_q_{a}" for a in "wxyz"]
    world = "q_GW = [0.7071, 0.7071, 0.0, 0.0]\ninverse = true\n"
    for keys, p, names, attitude in (
        ("", p_G, euler, np.degrees(angles)),
        (world, p_W, quaternion, q_MW),
    ):
        names = [*(f"ref_p_{a}" for a in "xyz"), *names]
        columns = dict(zip(names, np.column_stack([p, attitude]).T, strict=True))
        rules = (
            f"[columns]\nt = 't'\nq_knee = 't'\n[reference]\n{keys}[reference.columns]\nt = 't'\n"
        )
        for name in names:
            unit = ", unit = 'deg'" if name in euler else ""
            rules += f"{name} = {{ column = '{name}'{unit} }}\n"
        log = imported(csv(tmp_path, {"t": t} | columns), rules)
        np.testing.assert_allclose(log.ref_p, p_G, atol=1e-12)
        np.testing.assert_allclose(log.ref_R_GI, R_GM.as_matrix(), atol=1e-12)


def test_uneven_stamps_and_held_readings_are_said_and_made_even_on_demand(tmp_path):
    rng = np.random.default_rng(0)
    t = np.sort(0.002 * np.arange(1500) + 3e-4 * rng.normal(size=1500))
    read = np.floor(t / 0.01) * 0.01  # the joint is read at 100 Hz and held
    run = csv(tmp_path, {"t": t, "knee": np.sin(4.0 * read), "flag": 1.0})
    rules = '[columns]\nt = "t"\nq_knee = "knee"\ncontact_left = "flag"\n'
    recording = read_recording(run, written(tmp_path / "map.toml", rules))
    said = "\n".join(import_lines(recording.log(), notes=recording.notes))
    assert "stamps: 2 ms apart, uneven by 0.4" in said
    assert [*held_streams(recording.log())["q"]] == ["q_knee"]
    log = imported(run, rules + '[even]\nheld = ["q"]\n')
    np.testing.assert_allclose(np.diff(log.t), 1.0 / log.rate, atol=1e-9)
    inner = slice(20, -20)
    assert np.abs(log.q[:, 0] - np.sin(4.0 * (log.t - 0.001)))[inner].max() < 0.01
    assert "q (between held readings)" in log.meta.derived
    assert log.contact.all()
    refused("no column of kind 'tau'", imported, run, rules + '[even]\nheld = ["tau"]\n')
    short = csv(tmp_path, {"t": t[:50], "knee": read[:50], "flag": 1.0})
    refused("longer than the recording", imported, short, rules + "[even]\nlate = { q = 0.9 }\n")


def test_without_a_radius_in_the_map_the_robots_own_counts_and_is_said(tmp_path):
    robot = Robot.load("spot_class")
    columns = {"t": 0.01 * np.arange(5)} | {f"q_{j}": np.zeros(5) for j in robot.limbs.joints}
    rules = as_named(columns) + '[robot]\nname = "spot_class"\n'
    for given, radius in (("", robot.foot_radius), ("foot_radius = 0.0\n", 0.0)):
        log = imported(csv(tmp_path, columns), rules + given)
        np.testing.assert_allclose(Robot.for_log(log).foot_radius, radius)
        said = "\n".join(import_lines(log))
        assert ("of the robot's file; the map has no [robot] foot_radius" in said) == (not given)


def test_a_given_robot_takes_the_place_of_the_maps(tmp_path):
    joints = Robot.load("spot_class").limbs.joints
    columns = {"t": 0.01 * np.arange(5)} | {f"q_{j}": np.zeros(5) for j in joints}
    text = as_named(columns) + '[robot]\nname = "not_installed"\n'
    rules = written(tmp_path / "map.toml", text)
    run = csv(tmp_path, columns)
    refused(r"map.toml: \[robot\] name: .*not_installed", import_log, run, rules)
    assert import_log(run, rules, "go1_class").meta.robot == "go1_class"
    copied = shutil.copy(robot_file("v60_class"), tmp_path / "ours.xml")
    log = import_log(run, rules, str(copied))
    assert Robot.for_log(log).file == robot_of_log(log) == copied
    refused("--robot.*not_there", import_log, run, rules, "not_there")


@pytest.mark.parametrize("of", ["torque", "kinematics"])
def test_contacts_follow_from_torques_and_from_kinematics(log, tmp_path, of):
    starts = ("t", "gyro", "accel", "q_", "tau_")
    kept = [c for c in log.frame if c.startswith(starts) and "_des" not in c and "_ff" not in c]
    sizes = {"torque": "on = 85\noff = 85", "kinematics": "on = 0.3\noff = 0.3"}[of]
    rule = f'[robot]\nname = "spot_class"\n[contact]\nof = "{of}"\n{sizes}\n'
    found = imported(csv(tmp_path, log.frame[kept]), as_named(kept) + rule)
    assert f"contact from {of}" in found.meta.derived
    assert found.legs == log.legs
    # Rules of thumb: an early swing is slow, and a leg that swings has torque of its own.
    assert np.mean(found.contact == log.contact) > {"torque": 0.85, "kinematics": 0.9}[of]


@pytest.mark.skipif(not MEASURED.is_dir(), reason=f"the measured logs are not here ({MEASURED})")
@pytest.mark.parametrize(
    ("recording", "rules", "rows", "joints"),
    [
        ("icub_biped/walking.mat", "icub_biped", 1188, 26),
        ("icub_biped/com_sinusoid.mat", "icub_biped", 2004, 26),
        ("so101/prbs_excitation", "so101", 6000, 6),
        ("ricmonk/swings/r06_s3.csv", "ricmonk_swing", None, 3),
        ("go2_in_air", "go2_in_air", None, 12),
        ("ak80_pendulum/pd_measured.csv", "ak80_pendulum", None, 1),
    ],
)
def test_measured_recordings_come_in_as_they_are(recording, rules, rows, joints):
    log = import_log(MEASURED / recording, rules)
    assert len(log.joints) == joints
    assert rows in (None, len(log.t))
    if log.has("imu"):
        assert np.linalg.norm(log.accel[:50].mean(axis=0)) == pytest.approx(9.8, abs=0.3)
        assert log.legs == ("left", "right")
        # A pelvis' IMU in its own axes: they turn with the pelvis that Vicon sees.
        up = np.einsum("nji,j->ni", log.ref_R_GI, [0.0, 0.0, 1.0])
        assert up[:50].mean(axis=0) @ log.accel[:50].mean(axis=0) > 9.6


def test_a_missing_list_is_an_empty_reading_of_each_of_its_places():
    cells = np.array([[0.1, 0.2], None, "", (0.5, 0.6)], dtype=object)
    table = RecordedTable(Path("run.json"), {"q": cells})
    rows, values = column_readings(table, "q[1]", Source(sparse=True))
    assert rows.tolist() == [0, 3]
    assert values.tolist() == [0.2, 0.6]
    refused("row 2", column_readings, table, "q[1]", Source())


@pytest.mark.parametrize("arrays", [1, 2])
def test_the_strings_of_a_matlab_file_are_read_where_there_is_one_array_of_them(tmp_path, arrays):
    """As MATLAB 7.3 writes ["FL" "thigh"]: where there are two, which is whose is not written."""
    letters = np.frombuffer("FLthigh\0".encode("utf-16-le"), np.uint64)
    words = np.concatenate([np.array([1, 2, 2, 1, 2, 5], np.uint64), letters])
    with h5py.File(tmp_path / "run.mat", "w") as file:
        file["x"] = np.zeros((1, 4))
        for k in range(arrays):
            file[f"names{k}"] = np.zeros((1, 6), np.uint32)
            file[f"names{k}"].attrs["MATLAB_class"] = np.bytes_("string")
            file[f"#refs#/{k}"] = words[:, None]
            file[f"#refs#/{k}"].attrs["MATLAB_class"] = np.bytes_("uint64")
    found = read_mat(tmp_path / "run.mat").cells
    assert [found[n].tolist() for n in found if found[n].dtype.kind == "U"] == (
        [["FL", "thigh"]] if arrays == 1 else []
    )


def test_the_only_episode_of_a_file_has_its_rows(tmp_path):
    """As gym-quadruped writes them: episodes, times, places."""
    gyro = np.arange(12.0).reshape(1, 4, 3)
    time = 0.01 * np.arange(4.0).reshape(1, 4, 1)
    arrays = {"time": time, "imu_gyro": gyro, "several": np.zeros((2, 4, 3))}
    table = read_hdf5(
        saved(tmp_path / "run.h5", {f"recordings/{name}": x for name, x in arrays.items()})
    )
    np.testing.assert_array_equal(table.cells["recordings/imu_gyro"], gyro[0])
    _, inner = column_readings(table, "recordings/several[1][2]", Source())
    np.testing.assert_array_equal(inner, np.zeros(4))
    (drafted,) = recorded_files(tmp_path / "run.h5", None)
    assert drafted.t is not None
    assert drafted.t.theirs == "recordings/time[0]"


@pytest.mark.parametrize("form", ["h5", "npz", "mat"])
@pytest.mark.parametrize("turned", [False, True])
def test_a_file_of_several_episodes_is_refused_in_one_line(tmp_path, form, turned):
    """A log is of one; which of them would be read is not guessed."""
    arrays = {"time": np.zeros((2, 9)), "gyro": np.zeros((2, 9, 3)), "q": np.zeros((2, 9, 12))}
    arrays = {name: x.swapaxes(0, 1) if turned else x for name, x in arrays.items()}
    run = saved(tmp_path / f"run.{form}", arrays)
    refused("gyro is of 2 episodes or robots of 9 rows", read_file, run, Source())


def test_objects_of_matlab_are_not_read(tmp_path):
    """A timeseries is six numbers that point to where MATLAB hides its arrays."""
    with h5py.File(tmp_path / "run.mat", "w") as file:
        kept = file.create_dataset("position", data=np.ones((1, 6), dtype=np.uint32))
        kept.attrs["MATLAB_class"] = np.bytes_("timeseries")
        kept.attrs["MATLAB_object_decode"] = np.int32(3)
    refused(r"run\.mat: no columns of numbers", guess_map, [tmp_path / "run.mat"])
    with h5py.File(tmp_path / "run.mat", "a") as file:
        file.create_dataset("t", data=np.arange(9.0)).attrs["MATLAB_class"] = np.bytes_("double")
    assert list(read_mat(tmp_path / "run.mat").cells) == ["t"]


@pytest.mark.parametrize(
    ("shapes", "rows", "parameters"),
    [
        ({"q": (9, 6)}, {"q": 9}, ()),
        ({"q": (6, 9)}, {"q": 9}, ()),
        ({"q": (99, 12), "limits": (12, 2), "kp": (1, 12)}, {"q": 99}, ("limits", "kp")),
        ({"imu": (500, 3), "q": (99, 12), "kd": (12,)}, {"imu": 500, "q": 99}, ("kd",)),
        ({"force": (99, 4, 3), "mass": (4,), "g": (3,)}, {"force": 99}, ("mass", "g")),
        ({"force": (4, 3, 99), "t": (99,)}, {"force": 99, "t": 99}, ()),
    ],
)
def test_rows_are_the_axis_that_the_arrays_share(shapes, rows, parameters):
    """An array as long as the rows of others are wide is a parameter, no recording."""
    found, left = rows_first({name: np.zeros(shape) for name, shape in shapes.items()})
    assert {name: len(found[name]) for name in rows} == rows
    assert left == parameters


def test_complex_numbers_are_refused_by_column(tmp_path):
    """Not read without their imaginary part."""
    run = saved(tmp_path / "run.npz", {"t": T, "turn": np.exp(1j * T)})
    rules = '[columns]\nt = "t"\nx_turn = "turn"\n'
    refused("run.npz: column 'turn' .*complex", imported, run, rules)
