"""Settings of a training, without importing torch."""

from dataclasses import dataclass
from importlib.util import find_spec

from surefoot.sim.common.errors import SurefootError

INSTALL_TORCH = (
    "PyTorch is not installed; the build for CPUs suffices: pip install torch --index-url "
    "https://download.pytorch.org/whl/cpu"
)
"""What to say where torch is missing. By default pip installs CUDA too on Linux, about 3 GB."""


def torch_is_installed() -> bool:
    """Whether observers can be trained here."""
    return find_spec("torch") is not None


MOST_STEPS = 1_000_000
"""Largest number of steps, and of windows in one."""


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """Network, loss and course of a training, for `surefoot.train`.

    Raises SurefootError for numbers out of range; `train` checks the names.
    """

    loss: str = "mse"
    """Loss: mean squared error (mse), or Gaussian maximum likelihood (gml), with which the observer
    also predicts a covariance.
    """
    inputs: str | tuple[str, ...] = "q,dq,tau"
    """Inputs of the observer, which the log must have, separated by commas. q: joint angles, dq:
    joint velocities, tau: joint torques (the paper's are these three), gyro: angular velocity,
    accel: specific force, contact: of the feet, feet: what each foot at rest says of the velocity,
    from q, dq, gyro and the declared robot. With many walks, tau,gyro,accel,contact,feet has the
    smallest errors.
    """
    model: str = "gru"
    """Architecture: gru, rnn and lstm are recurrent, mlp and tcn see a window of fixed length;
    bigru reads a log from both ends, so it works on whole logs only.
    """
    steps: int = 3600
    """Maximum number of training steps; training stops earlier if the validation error no longer
    improves. The learning rate rises over the first twentieth of them, then falls to zero along a
    cosine.
    """
    batch: int = 4
    """Number of two-second windows in each step."""
    rate: float | None = None
    """Largest learning rate; by default the architecture's own."""
    every: int = 75
    """Number of steps between validations."""
    patience: int = 20
    """Number of validations without improvement of the error after which the training stops."""
    width: int | None = None
    """Number of units in each layer; by default the architecture's own, which gives about 20 000
    weights.
    """
    device: str = "cpu"
    """PyTorch device for the training, such as cuda or mps; the observer itself runs on the CPU."""
    seed: int = 0
    """Seed of the initial weights and of the order of the windows."""

    def __post_init__(self):
        for name in ("steps", "batch", "every", "patience"):
            if not 0 < getattr(self, name) <= MOST_STEPS:
                raise SurefootError(f"train: {name} must be within 1 and {MOST_STEPS}")
        if self.rate is not None and not 0.0 < self.rate <= 1.0:
            raise SurefootError(f"train: rate must be above 0 and at most 1, is {self.rate:g}")


TRAIN_DEFAULT = TrainSettings()
