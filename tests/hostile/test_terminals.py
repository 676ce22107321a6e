"""Commands whose streams are closed, whose terminal has no width, or whose disk is too small."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace

import pytest
from forked import copied, run_forked
from refusals import refused

from surefoot.scenarios.demo import demo
from surefoot.sim.common.progress import bar
from surefoot.sim.common.terminal import printable, printing_plainly
from surefoot.sim.log import Log

SUREFOOT = [sys.executable, "-m", "surefoot"]


@pytest.mark.parametrize("closed", [1, 2])
def test_a_command_without_a_stream_ends_well(closed):
    done = subprocess.run(
        [*SUREFOOT, "robots"],
        stdout=None if closed == 1 else subprocess.PIPE,
        stderr=None if closed == 2 else subprocess.PIPE,
        preexec_fn=lambda: os.close(closed),
        timeout=60,
    )
    assert done.returncode == 0
    assert b"Traceback" not in (done.stdout or b"") + (done.stderr or b"")


def test_help_on_a_terminal_of_one_column_ends():
    done = subprocess.run(
        [*SUREFOOT, "estimate", "--help"],
        env=os.environ | {"COLUMNS": "1"},
        capture_output=True,
        timeout=60,
    )
    assert done.returncode == 0
    assert b"--filter" in done.stdout


CONTROLS = {
    "colour": "\x1b[31mred",
    "title": "\x1b]0;owned\x07",
    "start of the line": "\rsurefoot: all is well",
    "C1": "\x9b31mred",
    "right to left": "log\u202e.exe",
    "line separator": "a\u2028b",
    "half a character": "a\udc80",
    "null": "a\x00b",
}
"""What is not to reach a terminal."""


@pytest.mark.parametrize("name", CONTROLS.values(), ids=CONTROLS)
def test_what_controls_a_terminal_is_escaped(name, capsys):
    with printing_plainly():
        print(f"{name} 12 °\u00a0m ± 1", "日本", sep="\t")
        print(f"warning: {name}", file=sys.stderr)
    print("\x1b[0m", end="")
    out, err = capsys.readouterr()
    assert out.endswith("12 °\u00a0m ± 1\t日本\n\x1b[0m")
    shown = out.removesuffix("\x1b[0m") + err
    assert all(c.isprintable() or c in "\n\t\u00a0" for c in shown), ascii(shown)
    assert printable(name) in shown


def test_bars_are_drawn_on_a_terminal_with_plain_names(monkeypatch):
    class Terminal(StringIO):
        def isatty(self):
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with printing_plainly():
        for name in bar(["\x1b[31mred\rgreen"], desc="outer", position=1):
            for _ in bar(range(2), desc=name, position=0):
                pass
    drawn = terminal.getvalue()
    assert r"\x1b[31mred\rgreen" in drawn
    assert "\router" in drawn
    assert "\x1b[A" in drawn
    assert "\x1b[31" not in drawn


@pytest.mark.parametrize("command", ["export", "estimate"])
def test_no_name_of_a_log_controls_a_terminal(command, good, tmp_path):
    folder = copied(good, tmp_path / "case")
    name = CONTROLS["colour"] + CONTROLS["title"] + ".parquet"
    log = Log.read(folder / "walk.parquet")
    Log(log.frame, replace(log.meta, robot=CONTROLS["C1"]), "walk").write(folder / name)
    options = ["--filter", "imu"] if command == "estimate" else ["-o", f"{name}.csv"]
    found = run_forked([command, name, *options], folder)
    shown = found.out + found.err
    assert r"\x1b[31mred" in shown
    assert all(c.isprintable() or c in "\n\t" for c in shown), ascii(shown)


def test_a_demo_that_does_not_fit_on_the_disk_does_not_begin(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=5e7))
    refused("needs about 100 MB, its disk has 50 MB", demo, tmp_path / "out")
    assert not list(tmp_path.iterdir())
