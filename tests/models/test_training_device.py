"""Training on another device than the CPU. None is at hand here: torch's "meta", which has shapes
and devices but no values, refuses what was left behind on the CPU."""

from dataclasses import replace

import pytest
import torch
from synthetic import Body, synthetic_walk

from surefoot.models.observer.architectures import GRU
from surefoot.models.observer.data import draw, prepare
from surefoot.models.observer.network import loss_of
from surefoot.models.observer.observer import ObserverError
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import CPU, _begin, train

META = torch.device("meta")
BEGUN = TrainSettings(width=8, rate=1e-2)
BUNDLED = ("gru", "rnn", "lstm", "bigru", "mlp", "tcn")


def dataset():
    return prepare([synthetic_walk(0, 15, noise=0.1)], Body(), ("q",))


@pytest.mark.parametrize(("model", "loss"), [*((m, "mse") for m in BUNDLED), ("gru", "gml")])
def test_a_step_is_taken_where_the_device_is(model, loss):
    data = dataset()
    training = _begin(data, replace(BEGUN, model=model, loss=loss), META)
    x, y, trains = draw([log.to(META) for log in data.logs], 2, 25, training.rng)
    few = slice(40)  # of two hundred: torch takes recurrent layers there one by one
    loss_of(loss, training.network(x[few]), y[few]).mean().backward()
    training.optimiser.step()
    weights = list(training.network.parameters())
    assert {t.device for t in (x, y, trains, *weights)} == {META}
    assert all(weight.grad is not None and weight.grad.device == META for weight in weights)


def test_torchs_recurrence_is_the_compiled_one():
    layer = GRU(7, 10)
    layer.initialise(torch.Generator().manual_seed(3))
    x = torch.sin(torch.arange(60.0 * 3 * 7)).reshape(60, 3, 7)
    torch.testing.assert_close(layer._by_torch(x), layer(x), rtol=2e-5, atol=2e-5)


def test_weights_are_drawn_and_kept_on_the_cpu():
    data = dataset()
    there, here = (_begin(data, BEGUN, d) for d in (META, CPU))
    for name, weight in here.best.items():
        torch.testing.assert_close(there.best[name], weight, rtol=0, atol=0)


@pytest.mark.parametrize("name", ["meta", "gpu", "cuda:99"])
def test_a_device_that_torch_cannot_use_is_one_line(name):
    with pytest.raises(ObserverError, match=f"device {name}: torch cannot use it here") as error:
        train(synthetic_walk(0, 15, noise=0.1), Body(), TrainSettings(inputs="q", device=name))
    assert "\n" not in str(error.value)
