"""What a terminal is told while kernels are compiled for the first time."""

import sys

import pytest

from surefoot.sim.common.kernels import COMPILE_TIME, _CompilationNotice


@pytest.mark.parametrize("terminal", [True, False])
def test_compiling_is_said_once_and_to_a_terminal_alone(monkeypatch, capsys, terminal):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    listener = _CompilationNotice()
    for _ in range(2):
        listener.on_start(None)  # type: ignore[arg-type]
    said = f"compiling once, up to {COMPILE_TIME:.0f} s\n"
    assert capsys.readouterr().err == said * terminal
