"""Advice on a map is followed by pasting its lines: all of it together, and nothing remains."""

import tomllib

import pytest

from surefoot.sim.ground.terrain import Ground
from surefoot.sim.importing.advice import advised_lines
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.recording import read_recording
from surefoot.sim.log.schema import JOINTS, LEGS
from surefoot.sim.plausibility import check_log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.machine import machine_for_log
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

SENSORS = [f"{name}_{axis}" for name in ("gyro", "accel") for axis in "xyz"]
POSE = [f"ref_p_{axis}" for axis in "xyz"] + [f"ref_q_{axis}" for axis in "wxyz"]
JOINT_COLUMNS = [f"{kind}_{joint}" for kind in ("q", "dq") for joint in JOINTS]


@pytest.fixture(scope="module")
def walked():
    course = (Segment(3.0, 0.5), Segment(3.0, 0.4, turn=0.5), Segment(3.0, 0.4, turn=-0.5))
    return walk(Scenario("wrong", course, Ground(0.8)), Robot.load("spot_class"), 1)


def map_text(offset: str, **entries: str) -> str:
    names = ("t", *SENSORS, *JOINT_COLUMNS, *(f"contact_{leg}" for leg in LEGS))
    lines = [f"{name} = {entries.get(name, repr(name))}" for name in names]
    lines += ["[reference]", "file = 'mocap.csv'", offset, "[reference.columns]"]
    lines += [f"{name} = {entries.get(name, repr(name))}" for name in ("t", *POSE)]
    return "\n".join(["[columns]", *lines, "[robot]", "name = 'spot_class'"]) + "\n"


def pasted(text: str, lines: tuple[str, ...]) -> str:
    """A map with lines in place of its own."""
    section = ""
    for line in lines:
        if line.startswith("["):
            section = line
            continue
        key = line.partition(" = ")[0]
        kept, at = [], ""
        for old in text.splitlines():
            at = old if old.startswith("[") else at
            if not (at == section and old.partition(" = ")[0] == key):
                kept.append(old)
            if old == section:
                kept.append(line)
        text = "\n".join(kept) + "\n"
    tomllib.loads(text)
    return text


WRONG = {
    "the clock, half corrected": ({}, 2.6, "offset = 2.0", {}),
    "offsets by recording": ({}, 0.4, "offset = { robot = -0.1, other = 2.0 }", {}),
    "an axis of the accelerometer that counts against the map's sign": (
        {}, 0.0, "", {"accel_x": "{ column = 'accel_x', sign = -1 }"},
    ),
    "a reference in millimetres": ({name: lambda x: 1e3 * x for name in POSE[:3]}, 0.0, "", {}),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_all_advice_of_an_import_is_followed_at_once(tmp_path, walked, case):
    made, early, offset, entries = WRONG[case]
    frame = walked.frame.assign(**{name: f(walked.frame[name]) for name, f in made.items()})
    frame.to_csv(tmp_path / "robot.csv", index=False)
    mocap = frame[["t", *POSE]].iloc[::5]
    mocap.assign(t=mocap["t"] - early).to_csv(tmp_path / "mocap.csv", index=False)
    text = map_text(offset, **entries)
    for _ in range(2):
        (tmp_path / "map.toml").write_text(text)
        recording = read_recording(tmp_path / "robot.csv", tmp_path / "map.toml")
        log = recording.log()
        found = check_log(log, machine_for_log(log))
        advice = [(one.streams, one.map_line) for one in found]
        lines = advised_lines(advice, recording.rules, recording.name)
        if not found:
            break
        assert lines, [one.line for one in found]
        text = pasted(text, lines)
    assert [one.line for one in found] == []


def test_advice_is_added_to_what_the_map_says(tmp_path):
    (tmp_path / "map.toml").write_text(
        "[columns]\nt = 't'\nq_knee = { column = 'a', unit = 'rad', sign = -1 }\ndq_knee = 'b'\n"
        "accel_x = 'ax'\naccel_y = { column = 'ay', unit = 'g' }\n"
        "[even]\nheld = ['q']\nlate = { dq = 0.01 }\n"
        "[robot]\nname = 'hopper'\njoint_sign = { knee = -1 }\n"
    )
    advice = [
        (("q_knee", "dq_knee"), 'q_knee, ... = { ..., unit = "deg" }'),
        (("q_knee",), "q_knee = { ..., sign = -1 }"),
        (("dq_knee",), "[even] late = { dq = 0.0050 }"),
        (("dq_knee",), '[even] held = ["dq"]'),
        (("q_knee",), "[robot.joint_sign] knee = -1"),
        (("accel_x",), "accel_x = { column = <their column of accel_y>, sign = -1 }"),
        (("q_knee",), "[robot] joint_offset of knee or hip"),
    ]
    lines = advised_lines(advice, ImportMap.read(tmp_path / "map.toml"), "run")
    found = tomllib.loads("\n".join(lines))
    assert found == {
        "columns": {
            "q_knee": {"column": "a", "unit": "deg"},
            "dq_knee": {"column": "b", "unit": "deg"},
            "accel_x": {"column": "ay", "unit": "g", "sign": -1.0},
        },
        "even": {"late": {"dq": pytest.approx(0.015)}, "held": ["q", "dq"]},
        "robot": {"joint_sign": {"knee": 1.0}},
    }
