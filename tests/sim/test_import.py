"""Importing recordings: units, signs, cuts and gaps by construction; one clear line a fault."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recorded import as_named
from refusals import refusal, refused
from scipy.spatial.transform import Rotation
from written import written

from studies.measured import measured_folder
from surefoot.sim.importing.clock import usual_rate
from surefoot.sim.importing.columns import UNITS, ColumnEntry, Entries, read_columns
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.map_catalog import bundled_maps, map_file
from surefoot.sim.importing.readers.file import read_file
from surefoot.sim.importing.readers.table import column_readings
from surefoot.sim.importing.recording import import_log
from surefoot.sim.importing.sections import EVENNESS, Source
from surefoot.sim.log import JOINTS
from surefoot.sim.robot.catalog import robot_file
from surefoot.sim.sensors.stances import contact_from_force

MEASURED = measured_folder()
needs_measured = pytest.mark.skipif(
    not MEASURED.is_dir(), reason=f"the measured logs are not here ({MEASURED})"
)
FUZZ = settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

MAP = """
[source]
file = "robot.csv"
[columns]
t = { column = "ms", unit = "ms" }
gyro_x = { column = "wx", unit = "deg/s", sign = -1 }
gyro_y = "wy"
gyro_z = "wz"
accel_x = { column = "ax", unit = "g" }
accel_y = "ay"
accel_z = "az"
q_knee = { column = "knee", unit = "deg" }
q_des_knee = { column = "knee", unit = "deg" }
tau_knee = { column = "knee", unit = "mN m" }
force_FL = "f1"
force_FR = "f2"
force_RL = "f3"
force_RR = "f4"
x_battery = "volts"
[reference]
file = "mocap.csv"
frame = "base"
[reference.columns]
t = "time"
ref_p_x = { column = "x", unit = "mm" }
ref_p_y = "y"
ref_p_z = "z"
ref_q_w = "qw"
ref_q_x = "qx"
ref_q_y = "qy"
ref_q_z = "qz"
[robot]
name = "ak80_pendulum"
imu_position = [0.1, 0.0, 0.0]
imu_orientation = [0.0, 0.0, 0.0, 1.0]
foot_radius = 0.02
joint_sign = { knee = -1 }
joint_offset = { knee = 0.5 }
[contact]
offset = { FL = 10, FR = 0, RL = 0, RR = 0 }
on = 50
off = { FL = 30, FR = 30, RL = 30, RR = 50 }
debounce = 0.004
[motor_law]
kp = { knee = 20.0 }
kd = 0.5
"""


@pytest.fixture
def folder(tmp_path):
    """A recording at 500 Hz over 1 s; the reference covers 0.1 to 0.9 s, with one gap of 80 ms."""
    n = 500
    rng = np.random.default_rng(0)
    robot = pd.DataFrame({"ms": 2.0 * np.arange(n)})
    for name in ("wx", "wy", "wz", "ax", "ay", "az", "volts", "knee", "f2", "f3", "f4"):
        robot[name] = rng.normal(size=n)
    robot["f1"] = np.where(np.arange(n) % 100 < 50, 100.0, 10.0)
    robot["note"] = "walking"
    robot.to_csv(tmp_path / "robot.csv", index=False)
    time = np.round(np.arange(0.1, 0.9001, 0.02), 6)
    time = time[(time < 0.501) | (time > 0.579)]
    mocap = pd.DataFrame({"time": time, "x": 1000.0 * time, "y": 0.0, "z": 0.3})
    mocap["qw"], mocap["qx"], mocap["qy"] = np.cos(time / 2), 0.0, 0.0
    mocap["qz"] = np.sin(time / 2)
    mocap.to_csv(tmp_path / "mocap.csv", index=False)
    (tmp_path / "map.toml").write_text(MAP)
    return tmp_path


def edited(folder: Path, file: str, old: str, new: str) -> None:
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1))


PREFIXES = {"m": 1e-3, "c": 1e-2, "u": 1e-6, "n": 1e-9, "k": 1e3}
# By their definitions: a turn is 360 degrees or 2 pi radians, rpm turns a minute, g is standard.
DEFINED = {
    "rad": 1.0, "deg": 2.0 * np.pi / 360.0, "turn": 2.0 * np.pi, "rpm": 2.0 * np.pi / 60.0,
    "g": 9.80665, "s": 1.0, "m": 1.0, "N": 1.0,
}  # fmt: skip


@pytest.mark.parametrize(("kind", "unit"), [(kind, one) for kind in UNITS for one in UNITS[kind]])
def test_a_unit_has_the_factor_of_its_definition(kind, unit):
    factor = 1.0
    for part in unit.removesuffix("^2").removesuffix("/s").split():
        prefix, base = ("", part) if part in DEFINED else (part[0], part[1:])
        factor *= PREFIXES.get(prefix, 1.0) * DEFINED[base]
    name = {"t": "t", "force_xyz": "force_FL_x", "foot": "foot_FL_x"}.get(kind, f"{kind}_x")
    name = "ref_roll" if kind == "ref_euler" else name
    entries: Entries = {name: ColumnEntry("theirs", unit)}
    column = read_columns("columns", entries, ())[name]
    assert column.read(np.array([2.0])) == pytest.approx(2.0 * factor, rel=1e-12)


def test_a_robots_file_is_relative_to_the_map_and_must_exist(folder, tmp_path, monkeypatch):
    model = robot_file("spot_class").read_text()
    for place in ("maps", "shell"):
        (tmp_path / place).mkdir()
    named = MAP.replace('"ak80_pendulum"', '"bot.xml"')
    map_path = tmp_path / "maps" / "mine.toml"
    map_path.write_text(named)
    monkeypatch.chdir(tmp_path / "shell")
    refused(r"mine.toml: \[robot\] name: robot bot.xml", import_log, folder, map_path)
    unknown = named.replace("bot.xml", "spot_clas")
    (tmp_path / "maps" / "typo.toml").write_text(unknown)
    refused("spot_class", import_log, folder, tmp_path / "maps" / "typo.toml")
    for place in ("shell", "maps"):  # maps win over the current folder
        (tmp_path / place / "bot.xml").write_text(model)
        log = import_log(folder, map_path)
        assert log.meta.robot == "bot"
        assert log.meta.model["file"]["path"] == str(tmp_path / place / "bot.xml")


def test_units_signs_and_offsets(folder):
    log = import_log(folder, folder / "map.toml")
    raw = pd.read_csv(folder / "robot.csv").iloc[50:451].reset_index(drop=True)
    assert log.rate == 500.0
    np.testing.assert_allclose(log.t, 1e-3 * raw["ms"])
    np.testing.assert_allclose(log.gyro[:, 0], -np.radians(raw["wx"]))
    np.testing.assert_allclose(log.accel[:, 0], 9.80665 * raw["ax"])
    np.testing.assert_allclose(log.q[:, 0], 0.5 - np.radians(raw["knee"]))
    np.testing.assert_allclose(log.q_des[:, 0], 0.5 - np.radians(raw["knee"]))
    np.testing.assert_allclose(log.tau[:, 0], -1e-3 * raw["knee"])
    np.testing.assert_array_equal(log.frame["x_battery"], raw["volts"])
    assert log.meta.robot == "ak80_pendulum"
    assert log.meta.motor_law == {"kp": [20.0], "kd": [0.5]}
    assert log.meta.model["foot_radius"] == 0.02
    assert log.meta.model["ground_evenness"] == EVENNESS
    assert not log.has("dq")
    assert not log.has("ref_v")


def test_a_joint_without_a_drive_has_no_torque(folder):
    edited(folder, "map.toml", 'q_des_knee = { column = "knee", unit = "deg" }', 'q_hook = "knee"')
    edited(folder, "map.toml", "foot_radius", 'passive = ["hook"]\nfoot_radius')
    edited(folder, "map.toml", "[motor_law]\nkp = { knee = 20.0 }\nkd = 0.5\n", "")
    log = import_log(folder, folder / "map.toml")
    assert log.columns["tau_knee"].any()
    assert not log.columns["tau_hook"].any()


def test_a_map_may_say_how_even_the_ground_is(folder):
    edited(folder, "map.toml", "[contact]", "[ground]\nevenness = 0.0\n\n[contact]")
    assert import_log(folder, folder / "map.toml").meta.model["ground_evenness"] == 0.0


def test_a_base_reference_is_composed_with_the_mounting(folder):
    log = import_log(folder, folder / "map.toml")
    # The base is at (t, 0, 0.3), yawed by t; the IMU sits 0.1 m ahead, turned by 180 degrees.
    expected = np.column_stack(
        [log.t + 0.1 * np.cos(log.t), 0.1 * np.sin(log.t), np.full(len(log.t), 0.3)]
    )
    # Between samples 20 ms apart, and 80 ms once, it goes straight, as a sampled path does.
    sampled = np.isclose(np.round(log.t / 0.02) * 0.02, log.t) & log.ref_ok
    np.testing.assert_allclose(log.ref_p[sampled], expected[sampled], atol=1e-9)
    np.testing.assert_allclose(log.ref_p, expected, atol=1e-4)
    yaw = Rotation.from_rotvec(np.outer(log.t + np.pi, [0.0, 0.0, 1.0])).as_matrix()
    np.testing.assert_allclose(log.ref_R_GI, yaw, atol=1e-9)


def test_rows_outside_are_cut_and_gaps_are_marked(folder):
    log = import_log(folder, folder / "map.toml")
    assert log.t[0] == pytest.approx(0.1)
    assert log.t[-1] == pytest.approx(0.9)
    inside_gap = (log.t > 0.5 + 1e-9) & (log.t < 0.58 - 1e-9)
    np.testing.assert_array_equal(log.ref_ok, ~inside_gap)


@given(
    force=st.lists(st.floats(-100, 200), min_size=1, max_size=60),
    debounce=st.sampled_from([0.0, 0.01, 0.03]),
)
def test_contact_is_the_state_machine_it_says(force, debounce):
    t = np.arange(len(force)) / 100.0
    state, since, expected = False, None, []
    for k, f in enumerate(force):
        since = (k if since is None else since) if f > 50 else None
        if f < 30:
            state = False
        elif since is not None and (since == 0 or t[k] - t[since] >= debounce - 5e-7):
            state = True
        expected.append(state)
    found = contact_from_force(t, np.array(force), on=50, off=30, debounce=debounce)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", ["go1_square", "go1_square.toml"])
def test_a_bundled_map_is_known_by_its_name(name):
    assert map_file(name) == bundled_maps()["go1_square"]
    refused(r"import map .*No such file; bundled are .*go1_square", map_file, f"elsewhere/{name}")


@pytest.mark.parametrize("t", [[0.0, 0.01], [0.0, 0.01, 0.02, 0.09]])
def test_the_rate_of_two_rows_and_more_is_that_of_their_steps(t):
    assert usual_rate(np.array(t)) == 100.0


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("robot.csv", "wy,", "w2,", "robot.csv: column 'wy' is missing from the header"),
        ("robot.csv", "\n8.0,", "\n\n8.0,", "line 6: NaN or empty"),
        ("mocap.csv", "\n0.2,200.0", "\n0.2,2;0", "column 'x', line 7: '2;0' is not a number"),
        ("mocap.csv", ",0.3,", ",0.3,3", "mocap.csv: line 2: not a unit quaternion"),
        ("map.toml", 'unit = "g"', 'unit = "G"', "[columns.accel_x] unit 'G' (allowed: m/s^2, g,"),
        ("map.toml", "FL = 30, ", "", "[contact.off] FL is missing"),
        ("map.toml", "{ knee = -1 }", "{ ankle = -1 }", "[robot] joint 'ankle' has no column"),
        ("map.toml", "q_knee", 'q_hook = "knee"\nq_knee', "[columns] tau_hook is missing; name"),
        ("map.toml", "kp = { knee", "kp = { ankle", "[motor_law.kp] unknown key 'ankle'"),
        ("map.toml", 'ref_p_y = "y"\n', "", "[reference.columns] ref_p_y is missing"),
        ("map.toml", 'frame = "base"', 'frame = "world"', "[reference] frame must be one of"),
    ],
)
def test_faults_are_one_line_with_file_and_place(folder, file, old, new, said):
    edited(folder, file, old, new)
    assert said in refusal(import_log, folder, folder / "map.toml")


def test_a_reference_of_another_time_is_refused(folder):
    mocap = pd.read_csv(folder / "mocap.csv")
    mocap.assign(time=mocap["time"] + 50.0).to_csv(folder / "mocap.csv", index=False)
    refused("do not overlap", import_log, folder, folder / "map.toml")


def test_a_recording_without_stamps_takes_the_rate_of_its_map(tmp_path):
    (tmp_path / "a.csv").write_text("knee\n1\n2\n3\n")
    (tmp_path / "a.toml").write_text('[source]\nrate = 200\n[columns]\nq_knee = "knee"\n')
    log = import_log(tmp_path / "a.csv", tmp_path / "a.toml")
    np.testing.assert_allclose(log.t, [0.0, 0.005, 0.01])
    assert log.rate == 200.0


def readings(path, *columns):
    table = read_file(path, Source())
    return {name: column_readings(table, name, Source())[1] for name in columns}


@FUZZ
@given(
    row=st.integers(0, 9),
    cell=st.text(st.characters(blacklist_categories=["Cs", "Cc"]), min_size=1, max_size=8),
)
def test_a_cell_is_a_number_or_is_named(tmp_path, row, cell):
    cells = [f"{i}.5" for i in range(10)]
    cells[row] = '"' + cell.replace('"', '""') + '"'
    path = tmp_path / "cell.csv"
    path.write_text("a,b\n" + "".join(f"{c},1\n" for c in cells), encoding="utf-8")
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if np.isfinite(value):
        return
    refused(f"column 'a', line {row + 2}", readings, path, "a")


@pytest.mark.parametrize(
    ("of", "feet", "needs"),
    [("torque", 1, True), ("kinematics", 0, True), ("kinematics", 1, False)],
)
def test_contacts_from_joints_need_a_robot(tmp_path, of, feet, needs):
    """Those from kinematics do with the feet that a recording gives."""
    columns = as_named(("t", *(f"foot_left_{axis}" for axis in "xyz" * feet)))
    path = written(tmp_path / "map.toml", f'{columns}[contact]\nof = "{of}"\non = 1\noff = 1\n')
    if needs:
        refused(rf"\[contact\] of {of} needs a \[robot\]", ImportMap.read, path)
    else:
        assert ImportMap.read(path).sections.contact is not None


@needs_measured
def test_the_go1_recording_comes_in_whole():
    log = import_log(MEASURED / "go1_square", "go1_square")
    assert log.rate == 400.0
    assert log.joints == JOINTS
    assert log.meta.robot == "go1"
    np.testing.assert_array_equal(log.meta.model["p_BI"], [-0.01592, -0.06659, -0.00617])
    # The reference ends 1.05 s before the recording. It starts before it, but the IMU contradicts
    # the stamps of its first poses.
    assert len(log.t) == pytest.approx(10148 - (1.05 + 0.348) * 400, abs=4)
    assert log.t[0] == pytest.approx(42.5811 + 0.348, abs=0.01)
    # 15 gaps over 50 ms.
    assert np.sum(np.diff(log.ref_ok.astype(int)) == -1) == 15
    standing = (log.t > 44.0) & (log.t < 45.0)
    assert np.linalg.norm(log.accel[standing].mean(axis=0)) == pytest.approx(9.8, abs=0.2)
    walking = (log.t > 46.5) & (log.t < 63.0)
    # A trot: each foot stands about half of the time, on diagonal pairs.
    np.testing.assert_allclose(log.contact[walking].mean(axis=0), 0.525, atol=0.175)
    FL, FR, RL, RR = log.contact[walking].T
    assert np.mean(FL == RR) > 0.8
    assert np.mean(FL == FR) < 0.4
    assert np.mean(FR == RL) > 0.8


def test_a_tracked_body_elsewhere_on_another_clock_is_moved_to_the_imu(folder):
    """A map says what `surefoot align` found: the offset by recording, the place, the rotation."""
    at_imu = import_log(folder, folder / "map.toml")
    q_IM, p_IM = np.array([0.8, 0.0, 0.6, 0.0]), np.array([0.1, -0.2, 0.3])
    R_IM = Rotation.from_quat(q_IM, scalar_first=True)
    mocap = pd.read_csv(folder / "mocap.csv")
    R_GB = Rotation.from_quat(mocap[["qw", "qx", "qy", "qz"]], scalar_first=True)
    R_GI = R_GB * Rotation.from_quat([0.0, 0.0, 0.0, 1.0], scalar_first=True)
    p_GI = mocap[["x", "y", "z"]].to_numpy() * [1e-3, 1.0, 1.0] + R_GB.apply([0.1, 0.0, 0.0])
    p_GM = (p_GI + R_GI.apply(p_IM)) * [1e3, 1.0, 1.0]
    q_GM = (R_GI * R_IM).as_quat(scalar_first=True)
    columns = dict(zip(("x", "y", "z", "qw", "qx", "qy", "qz"), [*p_GM.T, *q_GM.T], strict=True))
    mocap.assign(time=mocap["time"] - 2.5, **columns).to_csv(folder / "mocap.csv", index=False)
    moved = f"offset = {{ robot = 2.5 }}\np_IM = {p_IM.tolist()}\nq_IM = {q_IM.tolist()}"
    edited(folder, "map.toml", 'frame = "base"', moved)
    edited(folder, "map.toml", "mocap.csv", "{name}_mocap.csv")
    (folder / "mocap.csv").rename(folder / "robot_mocap.csv")
    log = import_log(folder, folder / "map.toml")
    # Rounding may put the first or last row outside.
    assert len(log.t) > len(at_imu.t) - 3
    both = np.isin(at_imu.t, log.t)
    np.testing.assert_allclose(log.ref_p, at_imu.ref_p[both], atol=1e-9)
    np.testing.assert_allclose(log.ref_R_GI, at_imu.ref_R_GI[both], atol=1e-9)
    edited(folder, "map.toml", "robot = 2.5", "walk = 2.5")
    refused(
        r"offset.* has none for 'robot' \(known: walk\)", import_log, folder, folder / "map.toml"
    )


def test_the_imus_place_is_the_robot_files_where_the_map_gives_none(folder):
    text = robot_file("spot_class").read_text()
    text = text.replace('name="imu" pos="0.02 0 0.03"', 'name="imu" pos="0.1 0 0" quat="0 0 0 1"')
    (folder / "mine.xml").write_text(text)
    given = import_log(folder, folder / "map.toml")
    edited(folder, "map.toml", "ak80_pendulum", "mine.xml")
    edited(folder, "map.toml", "imu_position = [0.1, 0.0, 0.0]", "")
    edited(folder, "map.toml", "imu_orientation = [0.0, 0.0, 0.0, 1.0]", "")
    found = import_log(folder, folder / "map.toml")
    np.testing.assert_allclose(found.ref_p, given.ref_p, atol=1e-9)
    np.testing.assert_allclose(found.ref_R_GI, given.ref_R_GI, atol=1e-9)
