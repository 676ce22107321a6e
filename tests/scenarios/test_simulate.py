"""`surefoot simulate`: an index of what happened, runs that go on, effects that stay hidden."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from courses import course_file
from dataset_index import digests, read_index
from refusals import refusal, refused

from surefoot import Log, Robot, SimulateSettings, simulate
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.datasets.index import Journal
from surefoot.sim.common.files import MANIFEST, command_run
from surefoot.sim.effects import effect
from surefoot.sim.effects.file import load_effects, save_effects
from surefoot.sim.walk import SETTLING_TIME

RANGES = "[ranges]\nmu = [0.8, 1.2]\npayload = [0.0, 2.0]\n"


@pytest.fixture
def folder(tmp_path, monkeypatch, cliff) -> Path:
    monkeypatch.chdir(tmp_path)
    course_file(tmp_path, 1.5, RANGES)
    save_effects(tmp_path / "effects.toml", [effect("gyro_scale", "z", 0.05)])
    return tmp_path


def short(out: str = "walks", **options) -> None:
    simulate(SimulateSettings([Path("short.toml")], Path(out), **options))


def with_hidden_effect(out: str) -> None:
    short(out, effects=Path("effects.toml"), undeclared=True)


def test_the_index_says_what_was_drawn_and_what_happened(folder, capsys):
    main("simulate short.toml cliff.toml --seeds 0:2 --workers 2 -o walks".split())
    assert "fell: cliff, spot_class, seed 0, at" in capsys.readouterr().out
    index = read_index(folder / "walks")
    assert list(index.scenario) == ["cliff", "cliff", "short", "short"]
    assert list(index.falls) == [1, 1, 0, 0]
    walked = index[index.falls == 0]
    assert walked.mu.nunique() == 2
    assert walked.payload.between(0.0, 2.0).all()
    assert dict(zip(walked.file, walked.sha256, strict=True)) == digests(folder / "walks")
    for row in walked.itertuples():
        log = Log.read(folder / "walks" / row.file)
        assert row.duration == log.t[-1]
        assert 0.2 < row.length < 0.9
        assert row.creep < 2e-3
    every = pd.read_parquet(folder / "walks")
    assert len(every) == sum(len(Log.read(folder / "walks" / name).t) for name in walked.file)
    card = (folder / "walks" / "_dataset" / "README.md").read_text()
    assert "2 logs" in card
    assert "| cliff" in card


def test_a_fall_says_where_and_why_and_keeps_its_walk(folder, capsys):
    stop = refusal(main, "simulate cliff.toml -o walks".split(), error=SystemExit)
    assert "no walk was made" in stop
    out = capsys.readouterr().out
    assert re.search(r"fell: .* s at \(-?\d.*\) m: the base (tilted|sank)", out)
    log = Log.read(folder / "walks" / "_dataset" / "falls" / "cliff_0.parquet")
    assert log.t[-1] == pytest.approx(
        read_index(folder / "walks").fell_at[0] - SETTLING_TIME, abs=0.01
    )
    assert not list((folder / "walks").glob("*.parquet"))


def test_another_run_adds_and_makes_nothing_twice(folder, capsys):
    short(seeds="0:2")
    assert "[ranges]" not in capsys.readouterr().out
    before = {p: p.stat().st_mtime_ns for p in Path("walks").glob("*.parquet")}
    both = [Path("short.toml"), Path("cliff.toml")]
    simulate(SimulateSettings(both, Path("walks"), seeds="0:3", workers=2))
    assert "note: cliff has no [ranges]: its seeds walk alike" in capsys.readouterr().out
    assert {p: p.stat().st_mtime_ns for p in before} == before
    assert len(read_index(Path("walks"))) == 6
    lines = Path("walks/_dataset/journal.jsonl").read_text().splitlines()
    assert len(lines) == 6  # falls, too, are not walked again


def test_another_robot_has_logs_of_its_own(folder, capsys):
    for robot in (None, "v60_class"):
        short(robot=robot)
    assert set(read_index(Path("walks")).file) == {"short_0.parquet", "short_v60_class_0.parquet"}


def test_a_robot_whose_model_has_no_imu_is_said_to_have_none(folder, capsys):
    text = Robot.load("spot_class").file.read_text()
    bare = re.sub(r'<site name="imu"[^>]*/>|<sensor>.*</sensor>', "", text, flags=re.DOTALL)
    (folder / "blind.xml").write_text(bare)
    short(robot="blind.xml")
    assert "note: blind.xml: its model has no IMU" in capsys.readouterr().out


def test_a_changed_scenario_is_not_mixed_with_its_past(folder):
    short()
    course_file(folder, 1.6, RANGES)
    refused(r"short_0\.parquet: was made from another", short)
    short(force=True)
    assert len(read_index(Path("walks"))) == 1


def test_a_strangers_file_is_not_taken_for_a_log_of_ours(folder):
    short(seeds="1")
    Path("other").mkdir()
    Path("walks/short_1.parquet").rename("other/short_0.parquet")
    refused(r"short_0\.parquet: exists already", short, "other")


def test_a_log_that_a_kill_parted_from_its_row_is_kept(folder):
    """Killed between the log and its line in the journal, or within the line."""
    short(seeds="0:2")
    index = read_index(Path("walks"))
    journal = Path("walks/_dataset/journal.jsonl")
    journal.write_text(journal.read_text()[:-200])
    before = {p: p.stat().st_mtime_ns for p in Path("walks").glob("*.parquet")}
    short(seeds="0:2")
    pd.testing.assert_frame_equal(read_index(Path("walks")), index)
    assert {p: p.stat().st_mtime_ns for p in before} == before
    assert len(Journal(Path("walks")).rows) == 2


CHANGED = {
    "another walk": lambda path: shutil.copy(path.with_name("short_1.parquet"), path),
    "empty": lambda path: path.write_bytes(b""),
    "a link": lambda path: (path.unlink(), path.symlink_to("short_1.parquet")),
}
WITHOUT = {"journal": "_dataset/journal.jsonl", "manifest": MANIFEST}


@pytest.fixture(scope="module")
def two_walks(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("two")
    course = course_file(folder, 1.5, RANGES)
    with command_run("simulate"):
        simulate(SimulateSettings([course], folder / "walks", seeds="0:2"))
    return folder


def gone_on(two_walks: Path, folder: Path, change) -> None:
    shutil.copytree(two_walks / "walks", folder / "walks")
    change(folder / "walks")
    with command_run("simulate"):
        simulate(SimulateSettings([two_walks / "short.toml"], folder / "walks", seeds="0:2"))


@pytest.mark.parametrize(
    ("how", "missing"),
    [*((how, None) for how in CHANGED), *(("another walk", name) for name in WITHOUT)],
)
def test_a_log_that_was_changed_is_walked_again(how, missing, two_walks, tmp_path, capsys):
    """With journal and manifest, and with one of them."""

    def change(walks: Path) -> None:
        CHANGED[how](walks / "short_0.parquet")
        if missing:
            (walks / WITHOUT[missing]).unlink()

    gone_on(two_walks, tmp_path, change)
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert "short_0.parquet" in said[0]
    assert "made again" in said[0]
    assert digests(tmp_path / "walks") == digests(two_walks / "walks")


@pytest.mark.parametrize(
    "row",
    [
        {"file": "../short.toml"},
        {"scenario": {"name": "short"}},
        {"falls": "no", "duration": "long"},
        {"sha256": ""},
    ],
)
def test_a_row_that_none_of_ours_has_is_not_believed(row, two_walks, tmp_path):
    def change(walks: Path) -> None:
        journal = walks / WITHOUT["journal"]
        rows = [json.loads(line) | row for line in journal.read_text().splitlines()]
        journal.write_text("".join(f"{json.dumps(one)}\n" for one in rows))

    gone_on(two_walks, tmp_path, change)
    assert digests(tmp_path / "walks") == digests(two_walks / "walks")
    assert list(read_index(tmp_path / "walks").file) == ["short_0.parquet", "short_1.parquet"]


def test_a_folder_of_the_index_that_is_a_link_is_refused_before_the_walk(folder):
    """Files outside of the output would be written and appended to."""
    place = folder / "walks" / "_dataset"
    place.parent.mkdir()
    (folder / "elsewhere").mkdir()
    place.symlink_to(folder / "elsewhere")
    refused("_dataset", short)
    assert not list((folder / "elsewhere").iterdir())
    assert list((folder / "walks").iterdir()) == [place]


OUTPUTS = ("truth.toml", "short_0.parquet", "_dataset/index.parquet", "_dataset/journal.jsonl")


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_pipe_in_the_place_of_an_output_is_refused(name, folder):
    pipe = folder / "walks" / name
    pipe.parent.mkdir(parents=True)
    os.mkfifo(pipe)
    with command_run("simulate"):
        refused(pipe.name, with_hidden_effect, "walks")


def test_undeclared_effects_leave_no_trace_but_the_answer(folder):
    """Against a walk without effects, only the readings differ."""
    short("plain")
    with_hidden_effect("hidden")
    plain, hidden = (Log.read(f"{name}/short_0.parquet") for name in ("plain", "hidden"))
    assert plain.meta == hidden.meta
    differing = {c for c in plain.frame if not plain.frame[c].equals(hidden.frame[c])}
    assert differing == {"gyro_z"}
    ours = read_index(Path("plain")).drop(columns="sha256")
    pd.testing.assert_frame_equal(ours, read_index(Path("hidden")).drop(columns="sha256"))
    assert load_effects("hidden/truth.toml") == load_effects("effects.toml")
    for path in Path("hidden").rglob("*"):
        if path.is_file() and path.name != "truth.toml":
            assert b"gyro_scale" not in path.read_bytes()
    refused("undeclared effects", short, "hidden")
    refused("other undeclared effects, with none", with_hidden_effect, "plain")


def test_declared_effects_stand_in_log_and_index(folder):
    short(effects=Path("effects.toml"))
    said = json.loads(read_index(Path("walks")).effects[0])
    assert said == list(Log.read("walks/short_0.parquet").meta.effects)
    assert said[0]["name"] == "gyro_scale"


def test_debris_of_a_dead_writer_goes_and_that_of_a_living_one_stays(folder):
    Path("walks").mkdir()
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    dropped, ours = (Path(f"walks/.short_0.parquet.{n}.tmp") for n in (dead.pid, os.getpid()))
    other = Path(f"walks/.theirs.parquet.{dead.pid}.tmp")
    living = Path(f"walks/.short_1.parquet.{os.getppid()}.tmp")
    index = Path(f"walks/_dataset/.index.parquet.{dead.pid}.tmp")
    index.parent.mkdir()
    for path in (dropped, ours, other, living, index):
        path.write_text("half")
    short(seeds="0:2")
    assert not dropped.exists()
    assert not index.exists()
    assert other.exists()
    assert living.exists()
