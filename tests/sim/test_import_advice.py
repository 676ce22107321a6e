"""Advice on a map is followed by pasting its lines: all of it together, and nothing remains."""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
import pytest
from recorded import POSE, SENSORS, pasted
from scipy.spatial.transform import Rotation

from surefoot.sim.ground.terrain import Ground
from surefoot.sim.importing.advice import advised_lines, entries
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.recording import read_recording
from surefoot.sim.log.schema import JOINTS, LEGS
from surefoot.sim.plausibility import check_log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.machine import machine_for_log
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

JOINT_COLUMNS = [f"{kind}_{joint}" for kind in ("q", "dq") for joint in JOINTS]


AS_IS = Rotation.identity()


@pytest.fixture(scope="module")
def walked():
    course = (Segment(3.0, 0.5), Segment(3.0, 0.4, turn=0.5), Segment(3.0, 0.4, turn=-0.5))
    return walk(Scenario("wrong", course, Ground(0.8)), Robot.load("spot_class"), 1)


def map_text(offset: str, **entries: str) -> str:
    feet = "force" if "force_FL" in entries else "contact"
    names = ("t", *SENSORS, *JOINT_COLUMNS, *(f"{feet}_{leg}" for leg in LEGS))
    lines = [f"{name} = {entries.get(name, repr(name))}" for name in names]
    lines += ["[reference]", "file = 'mocap.csv'", offset, "[reference.columns]"]
    lines += [f"{name} = {entries.get(name, repr(name))}" for name in ("t", *POSE)]
    return "\n".join(["[columns]", *lines, "[robot]", "name = 'spot_class'"]) + "\n"


def rotated(left: Rotation = AS_IS, right: Rotation = AS_IS):
    """Poses in another world, `left` from z up, of a body whose axes are `right` from the IMU's."""

    def change(mocap: pd.DataFrame) -> pd.DataFrame:
        R_GI = Rotation.from_quat(mocap[POSE[3:]].to_numpy(copy=True), scalar_first=True)
        made = mocap.copy()
        made[POSE[:3]] = left.apply(mocap[POSE[:3]].to_numpy(copy=True))
        made[POSE[3:]] = (left * R_GI * right).as_quat(scalar_first=True)
        return made

    return change


def of_point(x: float, y: float, z: float):
    """Poses of another point of the body [m]."""

    def change(mocap: pd.DataFrame) -> pd.DataFrame:
        R_GI = Rotation.from_quat(mocap[POSE[3:]].to_numpy(copy=True), scalar_first=True)
        made = mocap.copy()
        made[POSE[:3]] = mocap[POSE[:3]].to_numpy(copy=True) + R_GI.apply([x, y, z])
        return made

    return change


def renamed(names: dict[str, str]):
    """Poses whose columns have each other's names."""
    return lambda mocap: mocap.rename(columns=names)


@dataclass(frozen=True)
class Wrong:
    """A map that does not fit its recording: of readings in other units, of other poses.

    Attributes:
        factors: of the readings, by the log's column.
        early: of the reference's clock [s].
        mocap: change of the reference.
        keys: of [reference].
        entries: of the map's columns.
        robot: keys of [robot].
        imu: axes of the robot in those of the IMU.
    """

    factors: Mapping[str, float] = field(default_factory=dict)
    early: float = 0.0
    mocap: Callable[[pd.DataFrame], pd.DataFrame] = lambda mocap: mocap
    keys: str = ""
    entries: Mapping[str, str] = field(default_factory=dict)
    robot: str = ""
    imu: Rotation = AS_IS


XYZW = dict(zip([*POSE[4:], POSE[3]], POSE[3:], strict=True))
QUARTER = Rotation.from_euler("z", 90, degrees=True)
TILTED = Rotation.from_euler("zx", [40, 25], degrees=True)
DEGREE = float(np.degrees(1.0))
DEGREES = dict.fromkeys(JOINT_COLUMNS, DEGREE)
WRONG = {
    "the clock, half corrected": Wrong(early=2.6, keys="offset = 2.0"),
    "offsets by recording": Wrong(early=0.4, keys="offset = { robot = -0.1, other = 2.0 }"),
    "an axis of the accelerometer that counts against the map's sign": Wrong(
        entries={"accel_x": "{ column = 'accel_x', sign = -1 }"}
    ),
    "a reference in millimetres": Wrong(dict.fromkeys(POSE[:3], 1e3)),
    "joints in degrees": Wrong(DEGREES),
    "joints in degrees, a clock a fifth of a second off": Wrong(DEGREES, early=0.2),
    "a body turned further than the map says": Wrong(
        mocap=rotated(right=TILTED), keys="q_IM = [0.7071068, 0.0, 0.0, 0.7071068]"
    ),
    "a base that is turned": Wrong(
        mocap=rotated(right=QUARTER), keys="frame = 'base'", robot="imu_position = [0.0, 0.0, 0.0]"
    ),
    "two feet whose contacts are swapped": Wrong(
        entries={"contact_FL": "'contact_RL'", "contact_RL": "'contact_FL'"}
    ),
    "two feet whose forces are swapped": Wrong(
        entries={"force_FL": "'force_RL'", "force_RL": "'force_FL'"},
        robot="[contact]\non = 40\noff = 30",
    ),
    "a quaternion whose last number is w": Wrong(mocap=renamed(XYZW)),
    "a quaternion whose first number is w": Wrong(mocap=renamed({w: x for x, w in XYZW.items()})),
    "a world whose y is up": Wrong(mocap=rotated(Rotation.from_euler("x", -90, degrees=True))),
    "a world that turns again": Wrong(
        mocap=rotated(Rotation.from_euler("x", 180, degrees=True)),
        keys="q_GW = [0.7071068, 0.0, 0.0, 0.7071068]",
    ),
    "a world that is not level": Wrong(mocap=rotated(Rotation.from_euler("y", 12, degrees=True))),
    "a point ahead of the IMU": Wrong(mocap=of_point(0.5, 0.0, 0.1)),
    "a point further than the map says": Wrong(
        mocap=of_point(0.5, 0.0, 0.3), keys="p_IM = [0.0, 0.0, 0.2]"
    ),
    "a point ahead of the base": Wrong(
        mocap=of_point(0.5, 0.0, 0.1), keys="frame = 'base'", robot="imu_position = [0.0, 0.0, 0.0]"
    ),
    "an IMU that is turned in the body": Wrong(imu=TILTED),
    "an IMU that is turned in the body, away from the tracked point": Wrong(
        mocap=of_point(0.3, 0.1, 0.2), keys="p_IM = [0.3, 0.1, 0.2]", imu=TILTED
    ),
    "an IMU that is turned in the base": Wrong(
        keys="frame = 'base'", robot="imu_position = [0.0, 0.0, 0.0]", imu=TILTED
    ),
    "an IMU that is upside down": Wrong(imu=Rotation.from_euler("x", 180, degrees=True)),
    "a body whose axes are forward, right, down": Wrong(
        mocap=rotated(right=Rotation.from_euler("x", 180, degrees=True))
    ),
}


GYRO, ACCEL = SENSORS[:3], SENSORS[3:]
OTHER_AXIS = {"gyro_y": "'gyro_z'", "gyro_z": "'gyro_y'"}
OTHER_AXIS |= {"accel_y": "'accel_z'", "accel_z": "'accel_y'"}
ONE_CAUSE = {
    "gyro in deg/s": Wrong(dict.fromkeys(GYRO, DEGREE)),
    "gyro negated": Wrong(dict.fromkeys(GYRO, -1.0)),
    "accelerometer in g": Wrong(dict.fromkeys(ACCEL, 1.0 / 9.80665)),
    "accelerometer negated": Wrong(dict.fromkeys(ACCEL, -1.0)),
    "accelerometer's z negated": Wrong({"accel_z": -1.0}),
    "IMU turned about x": Wrong(imu=Rotation.from_euler("x", 90, degrees=True)),
    "IMU turned about z": Wrong(imu=Rotation.from_euler("z", 180, degrees=True)),
    "IMU mirrored": Wrong(entries=OTHER_AXIS),
    "calves reversed": Wrong({name: -1.0 for name in JOINT_COLUMNS if name.endswith("calf")}),
    "a thigh reversed": Wrong({"q_FR_thigh": -1.0, "dq_FR_thigh": -1.0}),
    "an angle reversed": Wrong({"q_FR_thigh": -1.0}),
    "quaternions of the inverse": Wrong(dict.fromkeys(POSE[4:], -1.0)),
    "tracked body turned about y": Wrong(
        mocap=rotated(right=Rotation.from_euler("y", 90, degrees=True))
    ),
    "tracked body turned about z": Wrong(
        mocap=rotated(right=Rotation.from_euler("z", 30, degrees=True))
    ),
}


@pytest.mark.parametrize("case", WRONG | ONE_CAUSE)
def test_all_advice_of_an_import_is_followed_at_once(tmp_path, walked, case):
    wrong = (WRONG | ONE_CAUSE)[case]
    frame = walked.frame.assign(**{n: x * walked.frame[n] for n, x in wrong.factors.items()})
    turned = np.column_stack([wrong.imu.apply(walked.gyro), wrong.imu.apply(walked.accel)])
    frame = (
        frame.assign(**dict(zip(SENSORS, turned.T, strict=True))) if wrong.imu != AS_IS else frame
    )
    frame.to_csv(tmp_path / "robot.csv", index=False)
    mocap = wrong.mocap(frame[["t", *POSE]].iloc[::5])
    mocap.assign(t=mocap["t"] - wrong.early).to_csv(tmp_path / "mocap.csv", index=False)
    text = map_text(wrong.keys, **wrong.entries) + wrong.robot + "\n"
    said, found, log = [], (), walked
    for _ in range(2):
        (tmp_path / "map.toml").write_text(text)
        recording = read_recording(tmp_path / "robot.csv", tmp_path / "map.toml")
        log = recording.log()
        left_out = recording.reference()[1]
        assert left_out is not None
        assert np.mean(left_out) < 0.01  # what is wrong with all is said once
        found = check_log(log, machine_for_log(log))
        advice = [one.changes for one in found]
        lines, follow = advised_lines(advice, recording.rules, recording.name)
        assert all(follow)
        said += [one.line for one in found]
        if not found:
            break
        assert lines, said
        text = pasted(text, lines)
    assert [one.line for one in found] == [], said
    assert case not in ONE_CAUSE or len(said) == 1, said
    # The heading of a world is free; a point is given to a centimetre.
    walk_of = [np.linalg.norm(x - x[0], axis=1) for x in (walked.ref_p, log.ref_p)]
    assert walk_of[1] == pytest.approx(np.interp(log.t, walked.t, walk_of[0]), abs=0.06)


def test_advice_is_added_to_what_the_map_says(tmp_path):
    (tmp_path / "map.toml").write_text(
        "[columns]\nt = 't'\nq_knee = { column = 'a', unit = 'rad', sign = -1 }\ndq_knee = 'b'\n"
        "q_ankle = { column = 'c', unit = 'deg' }\naccel_x = 'ax'\n"
        "accel_y = { column = 'ay', unit = 'g' }\n[even]\nheld = ['q']\nlate = { dq = 0.01 }\n"
        "[robot]\nname = 'ak80_pendulum'\njoint_sign = { knee = -1 }\n"
    )
    advice = (
        {"columns": {"q_knee": {"unit": "deg"}, "dq_knee": {"unit": "deg/s"}}},
        entries(("q_ankle",), wrap=2.0 * np.pi),
        entries(("q_knee",), sign=-1.0),
        {"even": {"late": {"dq": 0.005}}},
        {"even": {"held": ("dq",)}},
        {"robot": {"joint_sign": {"knee": -1.0}}},
        entries(("accel_x",), of="accel_y", sign=-1.0),
        {},
        {"reference": {"offset": 0.1}},
        entries(("tau_knee",), sign=-1.0),
    )
    lines, follow = advised_lines(advice, ImportMap.read(tmp_path / "map.toml"), "run")
    assert follow == (True,) * 7 + (False,) * 3
    found = tomllib.loads("\n".join(lines))
    assert found == {
        "columns": {
            "q_knee": {"column": "a", "unit": "deg"},
            "dq_knee": {"column": "b", "unit": "deg/s"},
            "q_ankle": {"column": "c", "unit": "deg", "wrap": pytest.approx(360.0)},
            "accel_x": {"column": "ay", "unit": "g", "sign": -1.0},
        },
        "even": {"late": {"dq": pytest.approx(0.015)}, "held": ["q", "dq"]},
        "robot": {"joint_sign": {"knee": 1.0}},
    }


def test_an_offset_of_contacts_is_no_clock_of_a_recording(tmp_path):
    zeros = "[contact]\non = 40\noff = 30\noffset = { FL = 4, FR = 4, RL = 4, RR = 4 }\n"
    (tmp_path / "map.toml").write_text(map_text("", force_FL="'force_FL'") + zeros)
    rules = ImportMap.read(tmp_path / "map.toml")
    lines, _ = advised_lines(({"contact": {"on": 25.0, "offset": 0.0}},), rules, "run")
    assert tomllib.loads("\n".join(lines)) == {"contact": {"on": 25.0, "offset": 0.0}}
