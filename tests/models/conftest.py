"""One small observer a loss, trained once for all tests of this folder."""

from dataclasses import replace

import pytest
import torch
from synthetic import Body, synthetic_walk

from surefoot.models.calibration.calibrate import calibrate
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train

QUICK = TrainSettings(steps=120, batch=20, rate=1e-2, every=40)


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def walks():
    """Training, calibration and test walks of one synthetic robot."""
    return {
        name: synthetic_walk(seed, duration, noise=0.1, name=name)
        for seed, (name, duration) in enumerate((("fit", 40), ("calibrate", 60), ("test", 60)))
    }


@pytest.fixture(scope="session")
def mse_observer(walks):
    return train(walks["fit"], Body(), replace(QUICK, inputs=("q", "dq"), loss="mse", seed=1))


@pytest.fixture(scope="session")
def gml_observer(walks):
    return train(walks["fit"], Body(), replace(QUICK, inputs=("q", "dq"), loss="gml", seed=1))


@pytest.fixture(scope="session")
def bounds(mse_observer, walks):
    return calibrate(mse_observer, walks["calibrate"], robot=Body())
