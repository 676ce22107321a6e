"""Commands in a newcomer's first hour: one clear line for what is wrong, tables that fit."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from processes import ended
from recorded import as_recording
from refusals import refused

from surefoot import FilterSettings, Learnt, Robot, import_log
from surefoot.extend import robot_file
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.estimate.inputs import notes_on
from surefoot.scenarios.reporting.tables import LEAST_NEEDED, WIDTH, in_terminal
from surefoot.sim.log import Log, Meta


@pytest.mark.parametrize(
    "line",
    [
        "view mine.parquet -o mine.rrd",
        "train mine.parquet -o observer.safetensors",
        "trace mine.parquet -o traced",
        "loop mine.parquet -o looped",
        "tune mine.parquet -o tuned",
    ],
)
def test_a_log_whose_robot_nobody_names_is_named(line, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    columns = {f"{group}_{axis}": 0.0 for group in ("gyro", "accel") for axis in "xyz"}
    log = pd.DataFrame({"t": 0.01 * np.arange(200), "q_knee": 0.0, "contact_a": 1.0, **columns})
    Log(log, Meta(rate=100.0)).write("mine.parquet")
    refused("mine: the log names no robot: say which", main, line.split(), error=SystemExit)


@pytest.fixture(scope="module")
def log(log) -> Log:
    """A few seconds of the walk that all tests share."""
    return log.rows(slice(0, 1500))


def test_a_robot_is_shown_as_it_was_read(tmp_path, capsys):
    """Numbers of the file itself: mass, a hinge's range and torque, the feet's radius."""
    main(["robots", "spot_class", "-o", str(tmp_path / "spot.png")])
    out = capsys.readouterr().out
    assert "32.70 kg, legs of 0.658 m" in out
    rows = {line.split()[1]: line for line in out.splitlines() if line.startswith("| ")}
    assert "115.000" in rows["FL_calf"]
    assert "0.036" in rows["RR"]
    assert (tmp_path / "spot.png").stat().st_size > 10_000


def test_a_table_fits_the_terminal_unless_all_of_it_is_wanted():
    names = ["log", "filter", "APE_trans [m]", "NEES_pos", *LEAST_NEEDED]
    row = dict.fromkeys(names, 1.0) | {"filter": "coverage_persistent", "empty": None}
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


def notes(log: Log, robot: Robot) -> tuple[str, ...]:
    return notes_on(log, robot, Learnt(), FilterSettings())


def test_a_log_of_another_robot_is_said_to_be(log):
    robot = Robot.load("v60_class")
    assert notes(log, Robot.load("spot_class")) == ()
    assert ["spot_class" in line and "v60_class" in line for line in notes(log, robot)] == [True]
    assert notes(replace(log, meta=replace(log.meta, robot="")), robot) == ()


def test_an_imported_log_is_of_the_robot_in_the_file_that_its_map_names(log, tmp_path):
    (tmp_path / "mine.xml").write_text(robot_file("spot_class").read_text())
    imported = import_log(*as_recording(tmp_path, log, "mine", "[robot]\nname = 'mine.xml'\n"))
    robot = Robot.for_log(imported)
    assert robot.file == tmp_path / "mine.xml"
    assert notes(imported, robot) == ()
    assert any("v60_class" in line for line in notes(imported, Robot.load("v60_class")))
    # As 0.1.0 named it.
    by_file = replace(imported, meta=replace(imported.meta, robot=str(robot.file)))
    assert notes(by_file, robot) == ()
