"""Commands that are ended at random moments, or run out of disk: what is there is whole, what goes
on ends with the same bytes, nothing runs on, and one line says how to go on."""

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from dataclasses import replace
from pathlib import Path
from shutil import rmtree

import numpy as np
import pytest
from courses import course_file
from forked import copied
from good_files import FILES
from PIL import Image
from pyarrow import parquet
from recorded import as_named
from synthetic import resting, synthetic_walk

from surefoot.models.observer.observer import Observer, observer_of_torch
from surefoot.scenarios.datasets.simulate import simulate
from surefoot.scenarios.settings import SimulateSettings

GRID = """
scenarios = ["a.toml", "c.toml"]
seeds = [0, 1]
filters = ["leg", "imu"]
[observer]
losses = ["mse"]
steps = 50
inputs = "q,dq"
"""
COMMANDS = {
    "simulate": ("simulate a.toml --seeds 0:4 --workers 2 -o out", "*.parquet"),
    "train": ("train walk.parquet --inputs q,dq --model mlp -o out/o.safetensors", "o.safetensors"),
    "calibrate": ("calibrate observer.safetensors walk.parquet -o out/bounds.json", "bounds.json"),
    "experiment": ("experiment grid.toml --workers 2 --no-recordings -o out", "cache/*/*.parquet"),
    "compare": ("compare walk.parquet -o out", "*.none"),
    "estimate": ("estimate walk.parquet --filter imu -o out/imu.parquet", "imu.*"),
    "import": ("import walk.csv --map map.toml -o out/log.parquet", "log.parquet"),
    "export": ("export walk.parquet -o out/walk.mcap", "walk.mcap"),
    "noise": ("noise rest.parquet -o out/noise.toml", "noise.*"),
    "align": ("align a.parquet -o out", "[!.]*"),
    "view": ("view a.parquet -o out/walk.rrd", "*.none"),
    "tune": ("tune a.parquet --filters imu,leg --budget 4 --workers 2 -o out", "tuned.*"),
    "plan": ("plan encoder_offset --robot spot_class", "*"),
    "realism": ("realism a.parquet -o out", "drift.csv"),
    "trace": ("trace a.parquet -o out", "effects.toml"),
}
"""Command, and those of its files whose bytes depend on nothing but its input."""
BEGUN = {
    "suite": "suite spot --seeds 0 --workers 2 --no-recordings -o out",
    "loop": "loop a.parquet -o out",
    "demo": "demo -o out",
}
"""Commands of minutes and more, which are not run to their end here."""
BEGUN_FOR = 30.0
"""s"""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
QUICK = ("simulate", "estimate", "import", "export")
"""Commands of a few seconds."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("interrupted") / "inputs"
    folder.mkdir()
    course_file(folder, 10.0, name="a", role="train")
    course_file(folder, 2.0, name="c")
    (folder / "grid.toml").write_text(GRID)
    walk = synthetic_walk(0, 30.0, noise=0.1, robot="spot_class")
    walk.write(folder / "walk.parquet")
    walk.frame.to_csv(folder / "walk.csv", index=False)
    (folder / "map.toml").write_text(as_named(walk.frame))
    resting(30.0).write(folder / "rest.parquet")
    observer = observer_of_torch(FILES / "observer_q_dq_gml.pt")
    replace(observer, robot="spot_class").save(folder / "observer.safetensors")
    simulate(SimulateSettings([folder / "a.toml"], folder / "walks"))
    (folder / "walks" / "a_0.parquet").rename(folder / "a.parquet")
    rmtree(folder / "walks")
    return folder


def started(command: str, folder: Path) -> subprocess.Popen:
    """A command in a process group of its own, as a terminal has one for each."""
    return subprocess.Popen(
        [sys.executable, "-m", "surefoot", *command.split()],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def running(group: int) -> list[int]:
    """Processes of a group that are neither gone nor defunct."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, of_group = stat.read_text().rpartition(") ")[2].split()[:3]
        except (OSError, ValueError):
            continue
        if int(of_group) == group and state != "Z":
            found.append(int(stat.parent.name))
    return found


def check_whole(folder: Path) -> None:
    """Every file that is not hidden can be read to its end."""
    for path in folder.rglob("*"):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if hidden or not path.is_file():
            continue
        if path.suffix in WHOLE:
            WHOLE[path.suffix](path)
        assert path.stat().st_size, f"{path} is empty"


def _ends(path: Path) -> None:
    assert path.read_text(encoding="utf-8").rstrip().endswith("</html>"), path


WHOLE = {
    ".parquet": parquet.read_table,
    ".json": lambda path: json.loads(path.read_text(encoding="utf-8")),
    ".toml": lambda path: tomllib.loads(path.read_text(encoding="utf-8")),
    ".safetensors": Observer.load,
    ".png": lambda path: Image.open(path).load(),
    ".html": _ends,
}


def finished(command: str, folder: Path) -> float:
    """Seconds that a command takes, which must end well."""
    began = time.monotonic()
    process = started(command, folder)
    _, err = process.communicate(timeout=300)
    assert process.returncode == 0, err[-3000:]
    return time.monotonic() - began


def same_bytes(one: Path, other: Path, pattern: str) -> None:
    names = sorted(p.relative_to(one) for p in one.glob(pattern))
    assert names == sorted(p.relative_to(other) for p in other.glob(pattern))
    for name in names:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


def interrupted_once(command: str, folder: Path, number: int, after: float) -> bool:
    """End a command after some seconds; whether it was still running, and then ended well."""
    process = started(command, folder)
    time.sleep(after)
    if process.poll() is not None:
        process.communicate()
        return False
    # From a keyboard a signal reaches all processes of the terminal.
    send = os.killpg if number == signal.SIGINT else os.kill
    send(process.pid, number)
    _, err = process.communicate(timeout=60)
    if "exists already" in err:
        return False  # one before it was done when its signal came
    if number != signal.SIGKILL and process.returncode != 0:
        assert "Traceback" not in err, err[-3000:]
        assert process.returncode == 128 + number, err[-3000:]
        (last,) = [line for line in err.splitlines() if line.startswith("surefoot: ")]
        assert last.startswith("surefoot: interrupted"), err[-3000:]
    waiting_until = time.monotonic() + 5.0
    while running(process.pid) and time.monotonic() < waiting_until:
        time.sleep(0.05)
    assert not running(process.pid), "processes run on"
    check_whole(folder)
    return True


def each_command():
    """Every command, the quick ones among the tests of some seconds."""
    marks = {name: pytest.mark.long if name in QUICK else pytest.mark.slow for name in COMMANDS}
    return [pytest.param(name, marks=mark) for name, mark in marks.items()]


@pytest.mark.parametrize("name", each_command())
def test_ended_at_random_moments(name, inputs, tmp_path):
    """From its first import to after its end, six times; then it goes on to the same bytes."""
    command, pattern = COMMANDS[name]
    whole = copied(inputs, tmp_path / "whole")
    finished(command, whole)  # compiles what is compiled once
    whole = copied(inputs, tmp_path / "whole")
    seconds = finished(command, whole)
    rng = np.random.default_rng(sum(name.encode()))
    folder = copied(inputs, tmp_path / "ended")
    for number in SIGNALS * 2:
        interrupted_once(command, folder, number, rng.uniform(0.1, 1.05) * seconds)
        if number != signal.SIGKILL:
            assert not list(folder.rglob("*.tmp"))
    if "give --force" in (process := started(command, folder)).communicate(timeout=300)[1]:
        finished(f"{command} --force", folder)  # one was done before it was ended
    else:
        assert process.returncode == 0
    same_bytes(whole / "out", folder / "out", pattern)
    check_whole(folder)
    assert not list(folder.rglob("*.tmp")), "debris"
    assert not list(folder.rglob("*.lock")), "locks"


@pytest.mark.slow
@pytest.mark.parametrize("name", BEGUN)
def test_a_long_job_ended_at_random_moments(name, inputs, tmp_path):
    """Six times in its first half minute; each time it begins again, or goes on, without a word."""
    rng = np.random.default_rng(sum(name.encode()))
    folder = copied(inputs, tmp_path / "ended")
    for number in SIGNALS * 2:
        assert interrupted_once(BEGUN[name], folder, number, rng.uniform(0.1, BEGUN_FOR))
