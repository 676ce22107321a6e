"""What runs without torch is torch's network, and gives a whole log's bits sample by sample."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from synthetic import Body

from surefoot.models.observer.inference import COMPILED, LOSS_OUTPUTS, Head
from surefoot.models.observer.network import Network
from surefoot.models.observer.predict import predict
from surefoot.models.observer.samples import observer_samples
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train

INPUTS, WIDTH, LEGS = 31, 24, 4
SETTINGS = [
    (model, loss, legs) for model in COMPILED for loss in LOSS_OUTPUTS for legs in (0, LEGS)
]


def network_of(model: str, loss: str, legs: int) -> Network:
    """An untrained network with an odometry that does not weigh all legs alike."""
    network = Network(model, INPUTS, LOSS_OUTPUTS[loss], WIDTH, legs)
    generator = torch.Generator().manual_seed(2)
    network.initialise(generator)
    for weight in network.state_dict().values():
        weight += 0.2 * torch.rand(weight.shape, generator=generator)
    return network


def running(model: str, loss: str, legs: int) -> Callable[[np.ndarray], np.ndarray]:
    """The same network without torch."""
    network = network_of(model, loss, legs)
    weights = {name: weight.numpy() for name, weight in network.state_dict().items()}
    body = COMPILED[model](weights, INPUTS, WIDTH)
    head = Head(weights, WIDTH, LOSS_OUTPUTS[loss], legs)
    return lambda x: head(x, body(x))


def samples(T: int) -> np.ndarray:
    return np.random.default_rng(0).standard_normal((T, INPUTS)).astype(np.float32)


@pytest.mark.parametrize(("model", "loss", "legs"), SETTINGS)
def test_outputs_are_those_of_torch(model, loss, legs):
    x = samples(300)
    with torch.no_grad():
        expected = network_of(model, loss, legs)(torch.from_numpy(x[:, None]))[:, 0].numpy()
    assert running(model, loss, legs)(x) == pytest.approx(expected, rel=2e-5, abs=2e-5)


@pytest.mark.parametrize(("model", "loss", "legs"), SETTINGS)
def test_pieces_give_the_bits_of_the_whole(model, loss, legs):
    x, cuts = samples(200), [*range(1, 60), 60, 100, 101, 199]
    pieces, whole = (running(model, loss, legs) for _ in range(2))
    found = [pieces(part) for part in np.split(x, cuts)]
    assert np.array_equal(np.concatenate(found), whole(x))


@pytest.mark.parametrize("model", COMPILED)
@pytest.mark.parametrize("loss", LOSS_OUTPUTS)
def test_a_loop_gives_the_bits_of_the_whole_log(model, loss, walks):
    plan = TrainSettings(model=model, loss=loss, inputs="q,dq", steps=6, batch=2, every=3)
    observer = train(walks["fit"], Body(), plan)
    whole, loop = predict(observer, walks["test"], Body()), observer.running()
    steps = [loop(x[None]) for x in observer_samples(walks["test"], observer.inputs).x]
    assert np.array_equal(np.concatenate([v_I for v_I, _, _ in steps]), whole.v_I)
    if loss == "gml":
        covariances = [covariance for _, covariance, _ in steps if covariance is not None]
        assert whole.covariance is not None
        assert np.array_equal(np.concatenate(covariances), whole.covariance)
