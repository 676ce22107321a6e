"""A study on the command line: one line for bad input and for an interruption."""

import signal
from dataclasses import dataclass

import pytest
from processes import python

from studies.command import run_study
from surefoot.extend import SurefootError

ENDED = """
import os
from dataclasses import dataclass
from studies.command import run_study

@dataclass(frozen=True)
class Ended:
    number: int

    def run(self) -> None:
        os.kill(os.getpid(), self.number)

run_study(Ended)
"""


@pytest.mark.parametrize("number", [int(signal.SIGINT), int(signal.SIGTERM)])
def test_an_interrupted_study_says_in_one_line_how_it_continues(number):
    ended = python("-c", ENDED, "--number", number)
    assert ended.returncode == 128 + number
    (line,) = ended.stderr.splitlines()
    assert "run the same command" in line


@dataclass(frozen=True)
class Refused:
    """A study with bad input."""

    def run(self) -> None:
        raise SurefootError("no such plan")


def test_bad_input_of_a_study_is_one_line():
    with pytest.raises(SystemExit, match="surefoot: no such plan"):
        run_study(Refused, [])
