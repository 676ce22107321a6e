"""Every architecture behind one interface: what it may see, step by step as over the whole log."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import Body

from surefoot.models.observer import training
from surefoot.models.observer.architectures import BiGRU
from surefoot.models.observer.network import Network, torch_features
from surefoot.models.observer.observer import Observer, ObserverError
from surefoot.models.observer.predict import predict, prediction_errors
from surefoot.models.observer.samples import observer_samples
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train
from surefoot.models.registry import ARCHITECTURES

MODELS = list(ARCHITECTURES)
IN_TORCH = ["rnn", "lstm", "tcn"]
"""Causal, and not compiled."""


def network_of(model: str, inputs: int = 7) -> Network:
    network = Network(model, inputs, 3, ARCHITECTURES[model].width)
    network.initialise(torch.Generator().manual_seed(2))
    return network


def changed_by(network: Network, k: int, T: int = 150) -> np.ndarray:
    """At which of T steps (T,) the answer changes when the input of step k does."""
    x = torch.randn(T, 1, 7, generator=torch.Generator().manual_seed(0))
    other = x.clone()
    other[k] += 1.0
    with torch.no_grad():
        return (network(x) != network(other)).any(-1)[:, 0].numpy()


@pytest.mark.parametrize("model", MODELS)
def test_an_answer_depends_on_what_is_stated(model):
    changed = np.flatnonzero(changed_by(network_of(model), 40))
    stated = ARCHITECTURES[model]
    assert (changed[0] >= 40) == stated.causal
    if stated.receptive_field is not None:
        assert changed[-1] == 40 + stated.receptive_field - 1


@pytest.mark.parametrize("model", MODELS)
def test_sizes_are_comparable(model):
    assert network_of(model, 36).size == pytest.approx(20_000, rel=0.15)


@pytest.mark.parametrize("model", IN_TORCH)
def test_step_by_step_is_the_whole_sequence(model):
    """From the first step on, where a window has no past yet."""
    network = network_of(model)
    x = np.random.default_rng(1).standard_normal((90, 7)).astype(np.float32)
    whole, alone = (torch_features(network, whole)(x) for whole in (True, False))
    assert alone == pytest.approx(whole, rel=1e-5, abs=1e-5)


def test_both_ways_is_torchs_bidirectional_gru():
    torch.manual_seed(3)
    theirs, ours = torch.nn.GRU(7, 10, bidirectional=True), BiGRU(7, 10)
    for layer, suffix in ((ours.forwards, ""), (ours.backwards, "_reverse")):
        layer.load_state_dict(
            {name: theirs.state_dict()[name + suffix] for name in layer.state_dict()}
        )
    x = torch.randn(40, 3, 7)
    torch.testing.assert_close(ours(x), theirs(x)[0], rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("model", [m for m in MODELS if m != "gru"])
def test_every_model_learns_and_comes_back_from_disk(model, walks, tmp_path):
    plan = TrainSettings(steps=60, batch=10, every=60)
    observer = train(walks["fit"], Body(), replace(plan, inputs="q,dq", model=model))
    _, errors = prediction_errors(observer, walks["test"], Body())
    spread = walks["test"].ref_v.std(axis=0)
    assert np.sqrt((errors**2).mean(axis=0))[0] < 0.6 * spread[0]
    observer.save(tmp_path / "o.safetensors")
    loaded = Observer.load(tmp_path / "o.safetensors")
    assert loaded.model == model
    ours, theirs = (predict(o, walks["test"], Body()) for o in (observer, loaded))
    assert np.array_equal(ours.v_I, theirs.v_I)
    seen = observer_samples(walks["test"], observer.inputs)
    if model == "bigru":
        with pytest.raises(ObserverError, match="both ends"):
            loaded.running()
        return
    loop = loaded.running()
    for m in range(80):
        assert loop(seen.x[m : m + 1])[0][0] == pytest.approx(ours.v_I[m], abs=1e-5)


def test_an_unknown_model_is_refused(walks, mse_observer, tmp_path):
    with pytest.raises(ObserverError, match=r"unknown model 'transformer'; known: gru, mlp"):
        train(walks["fit"], Body(), TrainSettings(model="transformer"))
    replace(mse_observer, model="lstm").save(tmp_path / "o.safetensors")
    with pytest.raises(ObserverError, match="not a whole"):
        Observer.load(tmp_path / "o.safetensors")


def test_of_many_training_errors_every_nth_is_kept(walks, monkeypatch):
    monkeypatch.setattr(training, "MOST_ERRORS", 700)
    observer = train(walks["fit"], Body(), TrainSettings(steps=2, every=2))
    _, errors = prediction_errors(observer, walks["fit"], Body())
    every = -(-len(errors) // 700)
    assert every > 1
    assert observer.errors == pytest.approx(errors[::every], abs=1e-6)
