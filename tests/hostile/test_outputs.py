"""Every command that writes: a full disk is noticed before the work or is one line, and a second
run into the same output is refused."""

import fcntl
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from courses import course_file
from forked import Outcome, copied, run_forked
from synthetic import resting, synthetic_walk

from surefoot.estimator.evaluation.trajectory import reference
from surefoot.models.observer.observer import Observer
from surefoot.scenarios.cli.main import COMMANDS
from surefoot.scenarios.cli.runs import OUTPUTS_OF_ONE_RUN
from surefoot.sim.common import files
from surefoot.sim.log import Log

FEW = "--gamma 0.5"
"""A level for which few independent errors are enough: how many a walk has differs by machine."""
LEARNT = "--observer observer.safetensors --bounds bounds.json"
WRITING = {
    "demo": "demo -o new",
    "simulate": "simulate short.toml -o new",
    "train": "train long.parquet --model mlp --inputs q,dq -o new.safetensors",
    "calibrate": f"calibrate own.safetensors long.parquet {FEW} -o new.json",
    "calibrate's report": f"calibrate own.safetensors long.parquet {FEW} -o b.json --report new",
    "estimate": "estimate walk.parquet --filter leg -o new.parquet",
    "compare": f"compare walk.parquet {LEARNT} -o new",
    "score": "score walk.tum --log walk.parquet -o new",
    "noise": "noise rest.parquet -o new.toml",
    "experiment": "experiment experiment.toml -o new",
    "suite": "suite spot -o new",
    "trace": "trace walk.parquet -o new",
    "loop": "loop walk.parquet -o new",
    "realism": "realism walk.parquet -o new",
    "import": "import data.csv --map map.toml -o new.parquet",
    "import's map": "import data.csv --guess -o new.toml",
    "export to CSV": "export walk.parquet -o new.csv",
    "export to TUM": "export walk.parquet -o new.tum",
    "export to MCAP": "export walk.parquet -o new.mcap",
    "align": "align long.parquet -o new",
    "view": "view short.toml -o new.rrd",
    "robots": "robots spot_class -o new.png",
    "new": "new estimator mine -o new",
    "tune": "tune walk.parquet --filters imu --budget 2 -o new",
}
"""What writes -> a command that does, named `new` with or without an ending."""
QUICK = ("export to CSV", "import", "noise")
"""Those that each change is tested with; the others are left to `.ci/run`."""
HOURS = ("demo", "compare", "experiment", "suite", "trace", "loop", "realism")
"""Those that write only when much work is done."""
SOON = 5.0
"""s of processor time: several times what a slow machine takes to read the inputs, and no work."""
SIZES = (0, 500, 20_000)
"""Bytes at which files can grow no further."""


@pytest.fixture(scope="module")
def more(good, tmp_path_factory) -> Path:
    """The good files, and a walk and a rest that are long enough to learn from."""
    folder = copied(good, tmp_path_factory.mktemp("outputs") / "good")
    course_file(folder, 1.0)
    synthetic_walk(0, 12.0, noise=0.1, robot="spot_class").write(folder / "long.parquet")
    observer = Observer.load(folder / "observer.safetensors")
    replace(observer, robot="spot_class").save(folder / "own.safetensors")
    resting(12.0).write(folder / "rest.parquet")
    reference(Log.read(folder / "walk.parquet")).write_tum(folder / "walk.tum")
    return folder


def each(names=WRITING):
    marks = {n: () if n in QUICK else (pytest.mark.long,) for n in names}
    return pytest.mark.parametrize("what", [pytest.param(n, marks=m) for n, m in marks.items()])


def run(what: str, folder: Path, **limits) -> Outcome:
    return run_forked(WRITING[what].split(), folder, **limits)


def test_the_table_has_every_command_that_writes():
    named = {command.split()[0] for command in WRITING.values()}
    assert named == {
        n for n, c in COMMANDS.items() if set(OUTPUTS_OF_ONE_RUN) & c.__dataclass_fields__.keys()
    }


@each()
def test_a_full_disk_is_noticed_before_the_work(what, more, tmp_path, monkeypatch):
    usage = type(shutil.disk_usage("/"))(10**12, 10**12 - 1_000_000, 1_000_000)
    monkeypatch.setattr(files.shutil, "disk_usage", lambda path: usage)
    found = run(what, copied(more, tmp_path / "case"))
    assert found.refused, found
    assert "has 1 MB free" in found.err
    assert found.seconds < SOON


@each()
def test_a_second_run_into_the_same_output_is_refused(what, more, tmp_path):
    folder = copied(more, tmp_path / "case")
    command = WRITING[what].split()
    (name,) = (word for word in command[1:] if word.startswith("new"))
    with (folder / f".{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        found = run(what, folder)
    assert found.refused, found
    assert "another run is writing there" in found.err


@each([what for what in WRITING if what not in HOURS])
def test_a_disk_that_fills_up_is_one_line(what, more, tmp_path):
    """What looks whole is whole, and nothing else is left."""
    for longest in SIZES:
        found = run(what, copied(more, tmp_path / "case"), longest=longest)
        if longest == 0 or found.code:
            assert found.refused, found
            assert "File too large" in found.err


PLANTED = {
    "a link": lambda path: path.symlink_to("../victim.txt"),
    "a link to nothing": lambda path: path.symlink_to("../nothing"),
    "a pipe": os.mkfifo,
    "a folder": os.mkdir,
}


@pytest.mark.parametrize("kind", PLANTED)
@pytest.mark.parametrize("name", [files.MANIFEST, ".new.csv.lock"])
@pytest.mark.parametrize("what", ["export to CSV", "import's map"])
def test_a_manifest_or_a_lock_that_is_no_file_is_refused(what, name, kind, more, tmp_path):
    """Lines would be appended to a file outside of the folder, or a reader waited for."""
    folder = copied(more, tmp_path / "case")
    (output,) = (word for word in WRITING[what].split() if word.startswith("new"))
    outside = tmp_path / "victim.txt"
    outside.write_text("keep\n")
    PLANTED[kind](folder / name.replace("new.csv", output))
    found = run(what, folder)
    assert found.refused, found
    assert "no regular file" in found.err
    assert outside.read_text() == "keep\n"
    assert not outside.with_name("nothing").exists()


BYTES = {
    "a log": "estimate @.parquet --filter imu -o new.parquet",
    "an estimate": "estimate walk.parquet --filter imu -o @.parquet",
    "a comparison": "compare walk.parquet -o @",
    "walks": "simulate scenario.toml -o @",
    "a scenario": "simulate @.toml -o new",
    "a robot": "trace walk.parquet --robot @.xml -o new",
    "a map": "import csv data.csv --map @.toml -o new.parquet",
    "a table": "import csv @.csv --map map.toml -o new.parquet",
    "a recording": "view @.parquet -o new.rrd",
    "a log of a folder": "info @/walk.parquet",
}
"""What has a name that is not UTF-8 -> a command with `@` for that."""


@pytest.mark.parametrize("what", BYTES)
def test_a_path_that_is_not_utf8_is_one_line(what, more, tmp_path):
    folder, half = copied(more, tmp_path / "case"), "\udcff"
    for name in ("walk.parquet", "scenario.toml", "robot.xml", "data.csv"):
        shutil.copy(folder / name, folder / f"{half}{Path(name).suffix}")
    (folder / half).mkdir()
    shutil.copy(folder / "walk.parquet", folder / half)
    found = run_forked(BYTES[what].replace("@", half).split(), folder)
    assert found.refused, found
    (said,) = found.err.splitlines()
    assert "not UTF-8" in said
