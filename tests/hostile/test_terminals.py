"""Commands whose streams are closed, whose terminal has no width, or whose disk is too small."""

import os
import shutil
import subprocess
import sys
from types import SimpleNamespace

import pytest

from surefoot.scenarios.demo import demo
from surefoot.sim.common.errors import SurefootError

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


def test_a_demo_that_does_not_fit_on_the_disk_does_not_begin(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=5e7))
    with pytest.raises(SurefootError, match="needs about 100 MB, its disk has 50 MB"):
        demo(tmp_path / "out")
    assert not list(tmp_path.iterdir())
