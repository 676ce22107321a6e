"""What a newcomer meets: tables that fit, filters by name, folders, another robot's log."""

from dataclasses import replace

import pytest
from processes import ended

from surefoot.scenarios.cli.main import COMMANDS, main
from surefoot.scenarios.compare import compare_log
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.inputs import notes_on
from surefoot.scenarios.estimate.settings import FilterSettings
from surefoot.scenarios.reporting.tables import WIDTH, in_terminal
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot


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


def test_filters_that_differ_are_not_said_to_be_identical(log):
    found = compare_log(log, Robot.load("spot_class"), Learnt(), ("leg", "imu"))
    assert not found.notes


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


@pytest.mark.parametrize("command", ["", "compare", "estimate", "import"])
def test_help_is_not_cut_off(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert not ended(f"{command} --help")
    shown = capsys.readouterr().out
    assert not [mark for mark in ("…", "...\n ") if mark in shown.replace("LOG...", "")]
    assert command or all(name in shown for name in COMMANDS)
