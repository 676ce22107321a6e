"""A network in a package of a user's own is one like ours: in help, files, training and loops."""

import pytest
from own_package import lines_of_script

from surefoot.models.observer.observer import Observer, ObserverError

USE = """
import sys
from pathlib import Path

import numpy as np
from synthetic import Body, synthetic_walk

from surefoot.models.observer.observer import Observer
from surefoot.models.observer.predict import Loop, predict, prediction_errors
from surefoot.models.observer.samples import observer_samples
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train
from surefoot.models.registry import ARCHITECTURES
from surefoot.scenarios.experiments.file import Experiment
from surefoot.scenarios.experiments.products import learning_choices

print(*ARCHITECTURES)
walk, test = (synthetic_walk(seed, 20, noise=0.1) for seed in (0, 1))
plan = TrainSettings(inputs="q,dq", model="averages", steps=15, batch=2, every=15)
observer = train(walk, Body(), plan)
observer.save("observer.safetensors")
loaded = Observer.load("observer.safetensors")
v_I = predict(loaded, test, Body()).v_I
_, errors = prediction_errors(loaded, test, Body())
assert np.sqrt((errors**2).mean(axis=0))[0] < test.ref_v.std(axis=0)[0]
loop, x = Loop(loaded), observer_samples(test, loaded.inputs).x
assert np.allclose([loop.step(row)[0] for row in x[:50]], v_I[:50], atol=1e-5)

learning = Experiment.load("grid.toml").learning
print(learning.model, learning_choices(learning)["model"])
"""


def test_an_own_network_is_offered_trained_and_run(tmp_path):
    names, learning = lines_of_script("own_architecture", USE, 'model = "averages"', tmp_path)
    assert names == "gru mlp rnn lstm bigru tcn averages"
    assert learning.startswith("averages ['averages', '")
    with pytest.raises(ObserverError, match=r"unknown model 'averages'; known: gru, mlp"):
        Observer.load(tmp_path / "observer.safetensors")
