"""A training that was killed goes on where it was, to the same bits."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import synthetic
import torch
from synthetic import Body, synthetic_walk

from surefoot.models.observer.data import prepare
from surefoot.models.observer.observer import Observer, ObserverError
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import _begin, partial_path, train

PLAN = TrainSettings(inputs="q", loss="gml", seed=3, steps=24, batch=1, every=2)
SCRIPT = """
import sys
from pathlib import Path
sys.path[:0] = {paths}
from test_training_resume import PLAN, fit
fit(Path("{partial}"), lambda step, *_: print(step, flush=True)).save("{out}")
"""
PATHS = [str(Path(__file__).parent), str(Path(synthetic.__file__).parent)]


def fit(partial=None, progress: Any = False, settings=PLAN):
    walk = synthetic_walk(0, duration=15, noise=0.1)
    return train(walk, Body(), settings, progress, partial)


def test_a_real_kill_costs_no_bit(tmp_path):
    out = tmp_path / "o.safetensors"
    partial = partial_path(out)
    script = SCRIPT.format(partial=partial, out=out, paths=PATHS)
    victim = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert victim.stdout is not None
    for line in victim.stdout:
        # After the mean's own steps, at no validation in particular.
        if int(line) >= 12:
            break
    time.sleep(0.01)
    os.kill(victim.pid, signal.SIGKILL)
    victim.wait()
    assert partial.exists()
    assert not out.exists()
    told = []
    resumed = fit(partial, lambda step, *_: told.append(step))
    assert told[0] > 12
    assert resumed.hash == fit().hash


def test_a_killed_end_is_only_ended(tmp_path):
    """All steps made, the observer not yet saved: nothing is trained again."""
    partial = tmp_path / "o.safetensors.partial"
    first = fit(partial)
    told = []
    assert fit(partial, lambda *step: told.append(step)).hash == first.hash
    assert told == []


def test_an_early_end_stays_an_early_end(tmp_path):
    partial = tmp_path / "o.safetensors.partial"
    patient = replace(PLAN, loss="mse", every=1, patience=2, rate=0.5, steps=40)
    first = fit(partial, settings=patient)
    dataset = prepare([synthetic_walk(0, 15, noise=0.1)], Body(), ("q",))
    fresh = _begin(dataset, replace(patient, width=first.width), torch.device("cpu"))
    assert not fresh.restore(partial, "another task")
    assert fresh.step == 0
    told = []
    again = fit(partial, lambda *step: told.append(step), patient)
    assert again.hash == first.hash
    assert told == []


@pytest.mark.parametrize("other", [{"loss": "mse"}, {"model": "mlp"}, {"width": 8}, {"steps": 22}])
def test_the_state_of_another_training_is_not_gone_on_from(other, tmp_path):
    partial = tmp_path / "o.safetensors.partial"
    fit(partial)
    changed = replace(PLAN, **other)
    assert fit(partial, settings=changed).hash == fit(settings=changed).hash


def test_a_state_that_was_changed_is_not_gone_on_from(tmp_path, capsys):
    partial = tmp_path / "o.safetensors.partial"
    fit(partial)
    state = bytearray(partial.read_bytes())
    state[len(state) // 2] ^= 1
    partial.write_bytes(state)
    assert fit(partial).hash == fit().hash
    (said,) = capsys.readouterr().err.splitlines()
    assert partial.name in said


@pytest.mark.parametrize("what", ["text", "observer"])
def test_a_file_that_is_no_state_is_left_alone(what, tmp_path, mse_observer):
    partial = tmp_path / "o.safetensors.partial"
    if what == "text":
        partial.write_text("my notes")
    else:
        mse_observer.save(partial)
    before = partial.read_bytes()
    with pytest.raises(ObserverError, match="not a training that was broken off"):
        fit(partial)
    assert partial.read_bytes() == before


def test_no_state_is_an_observer(tmp_path):
    partial = tmp_path / "o.safetensors.partial"
    fit(partial)
    with pytest.raises(ObserverError, match="a file of PyTorch"):
        Observer.load(partial)
