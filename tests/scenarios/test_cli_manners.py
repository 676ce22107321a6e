"""What a person expects of a command line: version, suggestions, JSON, quiet pipes, own files."""

import io
import json
import os
import re
import sys
from pathlib import Path

import pytest
from processes import ended, printed, python
from refusals import refused
from synthetic import resting

import surefoot
from surefoot.scenarios.cli.main import COMMANDS, main
from surefoot.scenarios.cli.start import _check_environment
from surefoot.sim.common import progress

PLUGIN = """
from surefoot.scenarios.estimate.bundled import Imu


class Still(Imu):
    name = "still"
    description = "The IMU alone, by another name."


PLUGINS = {"surefoot.estimators": {"still": Still}}
"""


def command(folder: Path | None, *arguments: str, **variables: str):
    return python("-m", "surefoot", *arguments, cwd=folder, env=variables)


def test_without_a_command_the_commands_are_listed(capsys):
    assert not ended("")
    shown = capsys.readouterr().out
    assert "Begin with `surefoot demo`" in shown
    assert all(name in shown for name in COMMANDS)


def test_version(capsys):
    assert not ended("--version")
    assert capsys.readouterr().out.strip() == f"surefoot {surefoot.__version__}"


ABSENT = {
    "train gone.parquet -o o.safetensors": "gone.parquet: no such file",
    "import --guess gone.csv": "gone.csv: no such file",
    "import here.csv --map go1_sqare -o l.parquet": "; did you mean 'go1_square'?",
    "import here.csv --map gone.toml -o l.parquet": "import map gone.toml: No such file",
    "simulate demo/wlak -o new": "; did you mean 'demo/walk'?",
    "simulate demo/walk --robot gone.xml -o new": "gone.xml: no such MJCF file",
    "view gone.rrd": "gone.rrd: no such file",
    "robots spot_clas": "; did you mean 'spot_class'?",
    "realism here.csv --walker spot_clas -o new": "; did you mean 'spot_class'?",
    "estimate here.csv --filter lag": "; did you mean 'leg'?",
    "plan --robot spot_class gyro_scal": "; did you mean 'gyro_scale'?",
    "noise here.csv": "here.csv: not a log, which is a Parquet file; `surefoot import`",
    "experiment gone.toml -o new": "experiment gone.toml: No such file",
}
ONE_BY_ONE = """
import json, sys
from surefoot.scenarios.cli.main import main
for line in sys.argv[1:]:
    try:
        main(line.split())
    except SystemExit as stop:
        heavy = [m for m in ("torch", "pandas", "mujoco", "numba") if m in sys.modules]
        print(json.dumps([line, stop.code, heavy]))
"""


@pytest.fixture(scope="module")
def answers(tmp_path_factory) -> dict[str, list]:
    """Line -> what it ends with, and the heavy modules that are imported by then."""
    folder = tmp_path_factory.mktemp("absent")
    (folder / "here.csv").write_text("t,a\n0,1\n")
    said = printed("-c", ONE_BY_ONE, *ABSENT, cwd=folder)
    return {line: rest for line, *rest in map(json.loads, said.splitlines())}


@pytest.mark.parametrize(("line", "message"), ABSENT.items())
def test_what_is_not_there_is_said_before_anything_is_imported(line, message, answers):
    """Those that take a second or more to import are what a slip of the pen should not wait for."""
    said, heavy = answers[line]
    assert heavy == []
    assert message in said
    assert "\n" not in said


@pytest.mark.parametrize("name", ["OMP_NUM_THREADS", "MUJOCO_GL", "MPLBACKEND"])
def test_nonsense_in_a_variable_that_libraries_read_is_one_line(name):
    """numba and numexpr would each end the process by a traceback of their own."""
    done = command(None, "--version", **{name: "banana"})
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"surefoot: {name}")
    assert "'banana'" in line


@pytest.mark.parametrize(
    ("name", "value", "accepted"),
    [
        ("OMP_NUM_THREADS", "2,1", False),
        ("NUMBA_NUM_THREADS", "0", False),
        ("NUMBA_NUM_THREADS", "", True),
        ("SOURCE_DATE_EPOCH", "banana", False),
        ("SOURCE_DATE_EPOCH", "0", True),
        ("MPLBACKEND", "svg", True),
    ],
)
def test_numbers_in_the_environment_are_what_libraries_accept(name, value, accepted, monkeypatch):
    monkeypatch.setenv(name, value)
    if accepted:
        _check_environment()
        assert os.environ.get(name, "") == value
    else:
        refused(f"{name} .*'{value}'", _check_environment)


def test_results_are_json_where_that_is_asked_for(tmp_path, capsys):
    main(["robots", "spot_class", "--json"])
    card = json.loads(capsys.readouterr().out)
    assert (card["mass"], len(card["joints"]), card["walks"]) == (32.7, 12, True)
    main(["robots", "--json"])
    assert json.loads(capsys.readouterr().out)["spot_class"] == "bundled"
    resting(30.0, 100.0).write(tmp_path / "rest.parquet")
    main(["noise", f"{tmp_path}/rest.parquet", "--json"])
    white = json.loads(capsys.readouterr().out)["gyro"][0]["white"]
    assert white["low"] < 1e-4 < white["high"]  # 1e-3 rad/s at 100 Hz


def test_the_list_of_robots_loads_none(capsys, monkeypatch):
    monkeypatch.setattr("surefoot.sim.robot.Robot.load", lambda *_: pytest.fail("loaded"))
    main(["robots"])
    assert "spot_class" in capsys.readouterr().out


def test_a_pipe_is_told_of_progress_once_a_minute(monkeypatch):
    """And not at all of quick work."""
    pipe, now = io.StringIO(), [1000.0]
    monkeypatch.setattr(sys, "stderr", pipe)
    monkeypatch.setattr("tqdm.std.time", lambda: now[0])
    for _ in progress.bar(range(10), desc="quick"):
        pass
    assert pipe.getvalue() == ""
    with progress.bar(total=400, desc="walking") as bar:
        for _ in range(400):
            now[0] += 1.0
            bar.update()
    lines = pipe.getvalue().splitlines()
    assert 5 <= len(lines) <= 8
    assert all("walking" in line and "\r" not in line for line in lines)


def test_a_file_of_one_s_own_is_a_plugin_for_one_run(tmp_path, capsys):
    (tmp_path / "mine.py").write_text(PLUGIN)
    with_it = command(tmp_path, "estimate", "--help", "--plugin", "mine.py")
    assert "still" in with_it.stdout
    assert not ended("estimate --help")
    assert "still" not in capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_a_whole_sentence_for_each_option(command, capsys, monkeypatch):
    """What tyro adds in brackets follows a full stop, and each flag has a text. Left to itself,
    tyro prints `{None}|PATH`, `(default: None)` and `(default: )`, and the defaults of flags."""
    monkeypatch.setenv("COLUMNS", "80")
    assert not ended(f"{command} --help")
    help_ = capsys.readouterr().out
    assert not re.search(r"…|\.\.\.\n ", help_.replace("LOG...", ""))
    assert not re.findall(r"None|default: (?:''|False|True|)\)", help_)
    text = " ".join(re.sub("[─│╭╮╰╯]", " ", help_.partition("╭")[2]).split())
    bare = r"\S*[^.\s] \((?:required|optional|repeatable|default: [^)]*)\)"
    assert re.findall(rf"{bare}|--[\w-]+(?= -|$)", text) == []


@pytest.mark.parametrize(("options", "seen"), [((), False), (("-W", "default"), True)])
def test_warnings_of_libraries_do_not_reach_a_terminal(options, seen):
    """MuJoCo and NumPy warn of what a command then refuses in a line of its own."""
    script = (
        "import warnings; from surefoot.scenarios.cli import main, start\n"
        "main.main = lambda arguments: warnings.warn('of a library')\n"
        "start.entry_point()"
    )
    assert ("of a library" in python(*options, "-c", script).stderr) == seen
