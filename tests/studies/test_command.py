"""A study on the command line: one line for bad input and for an interruption."""

import os
import signal
from dataclasses import dataclass

import pytest

from studies.command import run_study
from surefoot.extend import SurefootError


@dataclass(frozen=True)
class Ended:
    """A study that is ended by a signal, or has bad input."""

    number: int = 0

    def run(self) -> None:
        if not self.number:
            raise SurefootError("no such plan")
        os.kill(os.getpid(), self.number)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_study_says_in_one_line_how_it_continues(number, capsys):
    with pytest.raises(SystemExit) as ended:
        run_study(Ended, ["--number", str(int(number))])
    assert ended.value.code == 128 + number
    (line,) = capsys.readouterr().err.split("\n")[1:-1]
    assert "run the same command" in line


def test_bad_input_of_a_study_is_one_line():
    with pytest.raises(SystemExit, match="surefoot: no such plan"):
        run_study(Ended, [])
