"""A signal at each stage of a process: before its command begins, within, when its output is there
already, and after. The exit code is the signal's or the command's, and one line says which."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

HERE = "os.kill(os.getpid(), SIGNAL)"
SOON = f"{HERE}; time.sleep(5.0)"
"""A signal that another thread may get first: the main one hears of it a moment later."""
IMPORTED = f"""
class Finder:
    def find_spec(self, name, *_):
        if name == "surefoot.scenarios.cli.main":
            {HERE}
sys.meta_path.insert(0, Finder())
entry_point()
"""
COMMAND = """
from surefoot.scenarios.cli.main import COMMANDS
from surefoot.sim.common.files import whole_file
@dataclass(frozen=True)
class Export:
    out: Path
    def run(self):
        with whole_file(self.out) as temporary:
            temporary.write_text("whole")
            {within}
        {written}
COMMANDS["export"] = Export
class Last:
    def __del__(self, kill=os.kill, me=os.getpid(), number=SIGNAL):
        kill(me, number)
{around}
entry_point()
"""


def command(within: str = "pass", written: str = "pass", around: str = "pass") -> str:
    return COMMAND.format(within=within, written=written, around=around)


LIBRARY = f"""
def library():
    try:
        {SOON}
    except BaseException as error:
        raise SystemError("a result with an exception set") from error
"""
DEFAULT = {"SIGINT": "default_int_handler"}
BEFORE = "surefoot: interrupted before it began"
WITHIN = "surefoot: interrupted; nothing was written, the same command starts again"
WRITTEN = "out.csv was already written, --force replaces it"
STAGES = {
    "at the first import": ("SIGTERM", IMPORTED, BEFORE),
    "within": ("SIGINT", command(within=SOON), WITHIN),
    "within, twice": ("SIGTERM", command(within=f"{HERE}, {SOON}"), WITHIN),
    "in a destructor": ("SIGTERM", command(within="Last(); time.sleep(20.0)"), WITHIN),
    "in what compiled code calls": ("SIGINT", command(within="library()", around=LIBRARY), WITHIN),
    "when all is written": ("SIGHUP", command(written=SOON), WRITTEN),
    "at Python's end": ("SIGINT", command(around=f"atexit.register(lambda: {HERE})"), ""),
    "at the last moment": ("SIGTERM", command(around="sys.last_of_all = Last()"), ""),
    "ignored, as by nohup": (
        "SIGHUP",
        f"signal.signal(SIGNAL, signal.SIG_IGN){command(within=HERE)}",
        "",
    ),
}
"""Stage -> signal, what the process runs, and the end of the line that it says, "" for none."""


@pytest.mark.parametrize("stage", STAGES)
def test_one_line_and_the_code_of_the_signal(stage, tmp_path):
    name, work, said = STAGES[stage]
    process = ended(name, work, tmp_path)
    left = {path.name for path in tmp_path.iterdir()} - {".surefoot.jsonl"}
    assert left == ({"out.csv"} if said in (WRITTEN, "") else set())
    assert process.returncode == (128 + getattr(signal, name) if said else 0), process.stderr
    lines = [line for line in process.stderr.splitlines() if line.strip()]
    assert len(lines) == bool(said), process.stderr
    assert not said or lines[0].endswith(said)


def ended(name: str, work: str, folder: Path) -> subprocess.CompletedProcess:
    lines = (
        "import atexit, os, signal, sys, time",
        f"SIGNAL = signal.{name}",
        # Whatever the process ignores that these tests are run by.
        f"signal.signal(SIGNAL, signal.{DEFAULT.get(name, 'SIG_DFL')})",
        "from dataclasses import dataclass",
        "from pathlib import Path",
        "from surefoot.scenarios.cli.start import entry_point",
        "sys.argv = ['surefoot', 'export', '--out', 'out.csv']",
        work,
    )
    return subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], cwd=folder, stderr=subprocess.PIPE, text=True,
        timeout=120, check=False,
    )  # fmt: skip


STARTED = """
import sys
from surefoot.scenarios.cli.start import entry_point
sys.argv = ["surefoot", "--version"]
try:
    entry_point()
except SystemExit:
    pass
sys.addaudithook(lambda event, _: event == "subprocess.Popen" and print("started"))
import mujoco
"""


def test_mujoco_starts_no_process_that_a_signal_could_end_with_a_traceback():
    done = subprocess.run([sys.executable, "-c", STARTED], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "started" not in done.stdout
