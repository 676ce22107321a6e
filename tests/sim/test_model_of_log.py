"""The model that a log keeps of a robot known by its file: found again, moved, or changed."""

from dataclasses import replace
from pathlib import Path

import pytest

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.catalog import of_robot, robot_file
from surefoot.sim.robot.machine import machine_for_log
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk


@pytest.fixture(scope="module")
def text() -> str:
    """A bundled model with a heavier trunk: another robot."""
    return robot_file("spot_class").read_text().replace('mass="13', 'mass="14')


@pytest.fixture(scope="module")
def written(tmp_path_factory, text) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("mine")
    mine = folder / "mine.xml"
    mine.write_text(text)
    log = walk(Scenario("stand", (Segment(0.2),), Ground(0.8), stand=0.2), Robot.load(mine), 0)
    log.write(folder / "log.parquet")
    return mine, folder / "log.parquet"


def test_it_is_read_from_its_file_while_that_is_the_same(written):
    mine, path = written
    assert Robot.for_log(Log.read(path)).file == mine


def test_a_file_that_moved_or_changed_is_replaced_by_what_the_log_keeps(
    written, text, tmp_path, monkeypatch
):
    mine, path = written
    monkeypatch.setenv("SUREFOOT_CACHE", str(tmp_path / "cache"))
    log, same = Log.read(path), Robot.load(mine)
    mine.write_text(text.replace('mass="14', 'mass="19'))
    try:
        changed = Robot.for_log(log)
        mine.rename(mine.with_name("moved.xml"))
        moved = machine_for_log(log)
    finally:
        mine.write_text(text)
    for found in (changed, moved):
        assert isinstance(found, Robot)
        assert (found.name, found.mass, found.digest) == ("mine", same.mass, same.digest)


def test_what_was_tampered_with_or_needs_other_files_is_one_line(written, tmp_path):
    _, path = written
    log = Log.read(path)
    kept = log.meta.model["file"] | {"path": str(tmp_path / "gone.xml")}
    for file, message in (
        (kept | {"text": kept["text"] + " "}, "does not match its digest"),
        ({k: v for k, v in kept.items() if k != "text"}, "gone.xml, is not there: say which"),
        (kept | {"path": str(tmp_path / "..")}, "is not there: say which"),
    ):
        other = replace(log, meta=replace(log.meta, model={"file": file}))
        with pytest.raises(SurefootError, match=message):
            Robot.for_log(other)


def test_a_robot_that_is_named_takes_the_place_of_the_log_s(written):
    mine, path = written
    log = of_robot(Log.read(path), "spot_class")
    assert "file" not in log.meta.model
    assert Robot.for_log(log).file == robot_file("spot_class")
    assert Robot.for_log(of_robot(log, mine)).file == mine
