"""Kernels: their notices, caches and signatures, and the same numbers without the compiler."""

import errno
import importlib
import os
import sys

import numpy as np
import pytest
from numba.core.caching import IndexDataCacheFile
from processes import printed

from surefoot.sim.common.kernels import (
    COMPILE_TIME,
    QUIET_TIME,
    _Compilation,
    compiled,
    kernel,
    lacks_code,
)
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import walk

SAID = f"compiling once, up to {COMPILE_TIME:.0f} s\n"


@pytest.mark.parametrize(
    ("terminal", "seconds", "said"),
    [(True, 0.0, SAID), (False, QUIET_TIME / 2, ""), (False, QUIET_TIME * 2, SAID)],
)
def test_compiling_is_said_once_to_a_terminal_or_if_it_takes_long(
    monkeypatch, capsys, terminal, seconds, said
):
    """Many short compilations are not one long one."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    now = [0.0]
    listener = _Compilation(lambda: now[0])
    for _ in range(2):
        listener.on_start(None)  # type: ignore[arg-type]
        now[0] += seconds
        for _ in range(2):  # functions that the kernel calls
            listener.on_start(None)  # type: ignore[arg-type]
            listener.on_end(None)  # type: ignore[arg-type]
        listener.on_end(None)  # type: ignore[arg-type]
        now[0] += QUIET_TIME
    assert capsys.readouterr().err == said


@pytest.mark.parametrize("place", ["a file", "a pipe", "nothing but letters", "full"])
def test_a_kernel_works_where_its_cache_does_not(place, tmp_path, monkeypatch):
    """And keeps nothing beside its source, where its own imports alone would be checked."""
    cache = tmp_path / ("x" * 300 if place == "nothing but letters" else "cache")
    if place == "a file":
        cache.write_text("mine")
    elif place == "a pipe":
        os.mkfifo(cache)
    elif place == "full":
        monkeypatch.setattr(IndexDataCacheFile, "save", full)
    monkeypatch.setenv("SUREFOOT_CACHE", str(cache))
    source = tmp_path / "doubled.py"
    source.write_text("def doubled(x):\n    return 2.0 * x\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    function = importlib.import_module("doubled").doubled
    monkeypatch.delitem(sys.modules, "doubled")
    assert kernel(function)(3.0) == 6.0
    assert not list(tmp_path.rglob("*.nbi"))


def test_a_cache_lacks_code_until_it_is_compiled_or_if_it_keeps_none(tmp_path, monkeypatch):
    monkeypatch.setenv("SUREFOOT_CACHE", str(tmp_path / "cache"))
    (tmp_path / "tripled.py").write_text("def tripled(x):\n    return 3.0 * x\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    function = kernel(importlib.import_module("tripled").tripled)
    assert lacks_code("tripled")
    assert function(2.0) == 6.0
    assert not lacks_code("tripled")
    for elsewhere in ("a file", "x" * 300):
        monkeypatch.setenv("SUREFOOT_CACHE", str(tmp_path / elsewhere))
        if elsewhere == "a file":
            (tmp_path / elsewhere).write_text("mine")
        assert not lacks_code("tripled")
    monkeypatch.delitem(sys.modules, "tripled")


def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_kernel_compiled_for_a_signature_refuses_other_arguments():
    @kernel
    def total(x):
        return x.sum()

    for _ in range(2):  # a second time changes nothing
        assert compiled(total, "f8(f8[::1])") is total
    assert total(np.ones(3)) == 3.0
    with pytest.raises(TypeError):
        total(np.ones((3, 2))[:, 0])


INTERPRETED = {"NUMBA_DISABLE_JIT": "1"}


SCENARIO = """
name = "short"
robot = "spot_class"
stand = 0.1
segment = [{duration = 0.3, forward = 0.3}]
"""


@pytest.mark.long
def test_an_interpreted_walk_is_the_compiled_one(tmp_path):
    file = tmp_path / "short.toml"
    file.write_text(SCENARIO)
    printed("-m", "surefoot", "simulate", file, "-o", tmp_path, env=INTERPRETED)
    interpreted = Log.read(tmp_path / "short_0.parquet")
    compiled = walk(Scenario.load(file), Robot.load("spot_class"), 0)
    # Compiled code contracts products and sums: the last digits differ, and steps amplify that.
    for name, values in compiled.columns.items():
        np.testing.assert_allclose(interpreted.columns[name], values, atol=1e-4, err_msg=name)
    assert np.ptp(compiled.columns["ref_p_x"]) > 0.02


def test_a_filter_can_be_made_without_the_compiler():
    code = """
import numpy as np
from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.filter import InvariantFilter
start = NavState(np.eye(3), np.zeros(3), np.zeros(3))
made = InvariantFilter(start, 0.01 * np.eye(15), FilterNoise())
made.predict(np.zeros(3), np.array([0.0, 0.0, 9.81]), 0.01)
"""
    printed("-c", code, env=INTERPRETED)
