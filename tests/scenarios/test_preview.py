"""`surefoot view` of what has no recording yet: a course, and a log."""

import pytest
from rerun.chunk import RrdReader

from surefoot.scenarios.cli.main import main
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk


def entities(path) -> set[str]:
    return {str(chunk.entity_path) for chunk in RrdReader(path).stream().to_chunks()}


def test_a_course_is_shown_on_its_ground_before_it_is_walked(tmp_path, capsys):
    main(["view", "demo/walk", "-o", str(tmp_path / "course.rrd")])
    assert "course.rrd" in capsys.readouterr().out
    found = entities(tmp_path / "course.rrd")
    assert {"/world/truth/path", "/world/ground/patch_0", "/world/robot"} <= found


def test_a_log_is_shown_as_it_is(tmp_path):
    flat = Scenario("flat", (Segment(1.0, 0.5),), Ground(0.8))
    walk(flat, Robot.load("spot_class"), 0).write(tmp_path / "log.parquet")
    main(["view", str(tmp_path / "log.parquet"), "-o", str(tmp_path / "log.rrd")])
    assert {"/world/truth/path", "/feet/contact/FL"} <= entities(tmp_path / "log.rrd")


def test_what_is_neither_is_one_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for line, message in (("view nowhere", "view opens"), ("view no.toml", "No such file")):
        with pytest.raises(SystemExit, match=message):
            main(line.split())
