"""Commands in a newcomer's first hour: one clear line for what is wrong, tables that fit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from processes import ended
from refusals import refusal, refused

from surefoot.scenarios.cli.main import COMMANDS, main
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.inputs import notes_on
from surefoot.scenarios.estimate.settings import FilterSettings
from surefoot.scenarios.reporting.tables import WIDTH, in_terminal
from surefoot.sim.importing.recording import import_log
from surefoot.sim.log import Log, Meta
from surefoot.sim.robot import Robot
from surefoot.sim.robot.catalog import robot_file
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import walk

COURSE = """
name = "short"
robot = "spot_class"
[[segment]]
duration = 3.0
forward = 0.5
[[segment]]
duration = 2.0
forward = 0.3
turn = 0.5
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A scenario, its log, and logs of other joints and of another robot."""
    folder = tmp_path_factory.mktemp("cli")
    (folder / "short.toml").write_text(COURSE)
    log = walk(Scenario.load(folder / "short.toml"), Robot.load("spot_class"), 0)
    log.write(folder / "log.parquet")
    table = pq.read_table(folder / "log.parquet")
    hip = table.rename_columns([name.replace("FL_hip", "hip") for name in table.column_names])
    pq.write_table(hip.replace_schema_metadata(table.schema.metadata), folder / "joints.parquet")
    (folder / "other").mkdir()
    replace(log, meta=replace(log.meta, robot="v60_class")).write(folder / "other" / "log.parquet")
    (folder / "text.toml").write_text("this is not = [ toml")
    (folder / "columns.csv").write_text("a,b\n1,2\n")
    return folder


BAD = {
    # beside what tests/hostile has
    "missing log": ("estimate no.parquet --filter leg", "no.parquet"),
    "missing robot file": ("estimate log.parquet --filter leg --robot no.xml", "no.xml"),
    "joints of something else": ("estimate joints.parquet --filter leg", "joints"),
    "two files of one name": ("estimate log.parquet --filter leg -o new.tum", "new.tum"),
    "no observer": ("estimate log.parquet --filter coverage", "needs observer"),
    "no gml observer": ("estimate log.parquet --filter velocity", "needs observer"),
    "nothing to hide": ("simulate short.toml --undeclared -o new", "needs effects"),
    "trace of two robots": ("trace log.parquet other/log.parquet -o new", "v60_class"),
    "an experiment of no such name": ("experiment vision -o new", "bundled are spot, vision60"),
    "train too short": ("train log.parquet -o new.safetensors", "training takes"),
    "calibrate without observer": (
        "calibrate no.safetensors log.parquet -o new.json",
        "no.safetensors",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_clear_line(case, folder, monkeypatch, capsys):
    """Non-zero exit, one line that names what is at fault, and nothing left behind."""
    command, named = BAD[case]
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
    message = refusal(main, command.split(), error=SystemExit)
    assert message.startswith("surefoot: "), capsys.readouterr()
    assert named in message
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    "line",
    [
        "view mine.parquet -o mine.rrd",
        "train mine.parquet -o observer.safetensors",
        "estimate mine.parquet --filter leg",
        "trace mine.parquet -o traced",
        "loop mine.parquet -o looped",
        "realism mine.parquet -o card",
        "tune mine.parquet -o tuned",
    ],
)
def test_a_log_whose_robot_nobody_names_is_named(line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    columns = {f"{group}_{axis}": 0.0 for group in ("gyro", "accel") for axis in "xyz"}
    log = pd.DataFrame({"t": 0.01 * np.arange(200), "q_knee": 0.0, "contact_a": 1.0, **columns})
    Log(log, Meta(rate=100.0)).write("mine.parquet")
    refused("mine: the log names no robot: say which", main, line.split(), error=SystemExit)


def test_simulate_then_estimate(folder, monkeypatch, capsys):
    """The same seed walks the same log; the leg filter then follows it."""
    monkeypatch.chdir(folder)
    main("simulate short.toml --seeds 0:1 -o walks".split())
    assert Log.read("walks/short_0.parquet").frame.equals(Log.read("log.parquet").frame)
    main("estimate walks/short_0.parquet --filter leg -o leg.parquet".split())
    assert "APE_trans" in capsys.readouterr().out
    assert len((folder / "leg.tum").read_text().splitlines()) > 500


def test_compare_says_why_filters_were_left_out(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    main("compare log.parquet -o compared".split())
    out = capsys.readouterr().out
    assert "left out on log: coverage, coverage_gml, coverage_persistent" in out
    assert out.count("(needs observer and bounds)") == 1
    for name in ("table.md", "table.csv", "report.html", "log.rrd"):
        assert (folder / "compared" / name).stat().st_size > 100
    table = (folder / "compared" / "table.csv").read_text()
    assert [line.split(",")[1] for line in table.splitlines()[1:]] == ["leg", "leg_slip", "imu"]


def test_the_list_of_robots_loads_none(capsys, monkeypatch):
    monkeypatch.setattr("surefoot.sim.robot.Robot.load", lambda *_: pytest.fail("loaded"))
    main(["robots"])
    assert "spot_class" in capsys.readouterr().out


def test_a_robot_is_shown_as_it_was_read(tmp_path, capsys):
    """Numbers of the file itself: mass, a hinge's range and torque, the feet's radius."""
    main(["robots", "spot_class", "-o", str(tmp_path / "spot.png")])
    out = capsys.readouterr().out
    assert "32.70 kg, legs of 0.658 m" in out
    assert "walks in simulation" in out
    rows = {line.split()[1]: line for line in out.splitlines() if line.startswith("| ")}
    assert "115.000" in rows["FL_calf"]
    assert "0.036" in rows["RR"]
    assert (tmp_path / "spot.png").stat().st_size > 10_000


@pytest.fixture(scope="module")
def log(log) -> Log:
    """A few seconds of the walk that all tests share."""
    return log.rows(slice(0, 1500))


def test_a_table_fits_the_terminal_unless_all_of_it_is_wanted():
    names = ["log", "filter", "APE_trans [m]", "APE_rot [deg]", "RPE_trans [m]", "RPE_rot [deg/m]"]
    names += ["pi<gamma [%]", "NEES_pos", "NEES_vel", "NEES_att", "step [us]"]
    row = dict.fromkeys(names, 1.0) | {
        "log": "walk",
        "filter": "coverage_persistent",
        "empty": None,
    }
    shown = in_terminal([row, row])
    assert max(map(len, shown.splitlines())) <= WIDTH
    assert all(name in shown for name in ("filter", "APE_trans [m]", "NEES_pos"))
    assert "empty" not in shown
    assert all(name in in_terminal([row], wide=True) for name in names)


def test_chosen_filters_alone_run_and_identical_ones_are_said_to_be(log, tmp_path, capsys):
    path = tmp_path / "walk.parquet"
    log.write(path)
    main(f"compare {path} --filters leg,leg_slip -o {tmp_path / 'two'}".split())
    shown = capsys.readouterr().out
    assert "identical: leg and leg_slip" in shown
    assert max(map(len, shown.partition("\n\n")[0].splitlines())) <= WIDTH
    text = (tmp_path / "two" / "table.csv").read_text()
    assert [line.split(",")[1] for line in text.splitlines()[1:]] == ["leg", "leg_slip"]
    wrong = ended(f"compare {path} --filters leg,lag -o {tmp_path}/no")
    assert "unknown filter 'lag'" in str(wrong)
    assert not (tmp_path / "no").exists()


def test_a_folder_for_a_log_names_the_logs_in_it(log, tmp_path):
    assert "no log is in it" in str(ended(f"info {tmp_path}"))
    log.write(tmp_path / "mine.parquet")
    assert "mine.parquet" in str(ended(f"estimate {tmp_path} --filter imu"))


def test_a_log_of_another_robot_is_said_to_be(log):
    robots = Robot.load("spot_class"), Robot.load("v60_class")
    said = [notes_on(log, robot, Learnt(), FilterSettings()) for robot in robots]
    assert said[0] == ()
    assert ["spot_class" in line and "v60_class" in line for line in said[1]] == [True]
    unnamed = replace(log, meta=replace(log.meta, robot=""))
    assert notes_on(unnamed, robots[1], Learnt(), FilterSettings()) == ()


def test_an_imported_log_is_of_the_robot_in_the_file_that_its_map_names(log, tmp_path):
    (tmp_path / "mine.xml").write_text(robot_file("spot_class").read_text())
    log.frame.to_csv(tmp_path / "mine.csv", index=False)
    columns = "\n".join(f'{name} = "{name}"' for name in log.frame)
    (tmp_path / "mine.toml").write_text(f"[columns]\n{columns}\n[robot]\nname = 'mine.xml'\n")
    imported = import_log(tmp_path / "mine.csv", tmp_path / "mine.toml")
    robot = Robot.for_log(imported)
    assert robot.file == tmp_path / "mine.xml"
    assert notes_on(imported, robot, Learnt(), FilterSettings()) == ()
    other = Robot.load("v60_class")
    assert any(
        "v60_class" in line for line in notes_on(imported, other, Learnt(), FilterSettings())
    )
    # As 0.1.0 named it.
    by_file = replace(imported, meta=replace(imported.meta, robot=str(robot.file)))
    assert notes_on(by_file, robot, Learnt(), FilterSettings()) == ()


@pytest.mark.parametrize("command", ["", "compare", "estimate", "import"])
def test_help_is_not_cut_off(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert not ended(f"{command} --help")
    shown = capsys.readouterr().out
    assert not [mark for mark in ("…", "...\n ") if mark in shown.replace("LOG...", "")]
    assert command or all(name in shown for name in COMMANDS)
