"""The observer's network: an architecture, a linear head, and the two losses.

    (h_t, v_t) = NN(y_t, h_{t - dt})          the paper's Eq. (setup_rnn), h_0 = 0

With `mse` the head returns a velocity. With `gml` it returns a Gaussian's mean and the Cholesky
factor L of its covariance L L^T, trained by maximum likelihood (Russell and Reale, Multivariate
Uncertainty in Deep Learning, TNNLS 2022). With leg odometry, the head is added to that of the
contact points (`surefoot.models.observer.odometry`). Everything here is in scaled units and
float32.
"""

import math
from collections.abc import Callable
from typing import ClassVar, Protocol

import numpy as np
import torch
from torch.nn.functional import softplus

from surefoot.models.observer.inference import SMALLEST, Features
from surefoot.models.observer.odometry import STILL
from surefoot.models.registry import ARCHITECTURES


class Architecture(Protocol):
    """Interface of an architecture: a torch.nn.Module from scaled inputs, 10 ms apart, to features.

    Constructed as `Architecture(inputs, width)`, with weights in float32, and registered by the
    entry point group "surefoot.architectures".

    Attributes:
        width: default width of its layers, with about 20 000 parameters on 36 inputs.
        rate: Adam's largest learning rate.
        receptive_field: samples that an output depends on; None for all since the log began.
        causal: whether no output depends on later samples.
        features: number of its outputs.
    """

    width: ClassVar[int]
    rate: ClassVar[float]
    receptive_field: ClassVar[int | None]
    causal: ClassVar[bool]
    features: int

    def __init__(self, inputs: int, width: int): ...

    def initialise(self, generator: torch.Generator) -> None:
        """Draw all weights from `generator`."""
        ...

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        """Features (T, B, features) of x (T, B, inputs), from the beginning of a log."""
        ...

    def stepper(self) -> Callable[[np.ndarray], np.ndarray]:
        """The same sample by sample: a function from x (inputs,) to features (features,) with its
        own state. Called for causal architectures only, and for none that is compiled
        (`surefoot.models.observer.inference`).
        """
        ...


class Network(torch.nn.Module):
    """`forward(x (T, B, inputs)) -> head (T, B, outputs)`, from the beginning of a log."""

    def __init__(self, model: str, inputs: int, outputs: int, width: int, legs: int = 0):
        """Build a network; its weights are not initialised yet.

        Args:
            model: name of its architecture.
            inputs: number of channels.
            outputs: of the head: LOSS_OUTPUTS of the loss.
            width: of the architecture's layers.
            legs: of a robot whose leg odometry it corrects; 0 without.
        """
        super().__init__()
        self.body: Architecture = ARCHITECTURES[model](inputs, width)
        self.head = torch.nn.Linear(self.body.features, outputs)
        self.odometry = Odometry(self.body.features, legs) if legs else None

    def initialise(self, generator: torch.Generator) -> None:
        """Draw all weights from `generator`; the head's bias starts at zero."""
        self.body.initialise(generator)
        k = 1 / math.sqrt(self.head.in_features)
        torch.nn.init.uniform_(self.head.weight, -k, k, generator=generator)
        torch.nn.init.zeros_(self.head.bias)
        if self.odometry is not None:
            # Start as plain odometry.
            torch.nn.init.zeros_(self.head.weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.outputs(x, self.features(x))

    def features(self, x: torch.Tensor) -> torch.Tensor:
        """Features (T, B, F) of the body."""
        return self.body(x.clone())  # an architecture may write to its input

    def outputs(self, x: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
        """Outputs of the head, of inputs and features."""
        outputs = self.head(features)
        if self.odometry is None:
            return outputs
        mean, spread = outputs[..., :3], outputs[..., 3:]
        return torch.cat((self.odometry(x, features, mean), spread), -1)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(p.numel() for p in self.parameters())


class Odometry(torch.nn.Module):
    """The sum over the L legs of `surefoot.models.observer.odometry`, in the network's units; x
    (..., C) ends with the velocities.

    Untrained, it is plain odometry: equal weights of all legs, gain 1.
    `mean` and `scale` (3 L,) convert a scaled velocity of a contact point to the output's units,
    `speed` (3,) converts it from these to multiples of STILL.
    """

    mean: torch.Tensor
    scale: torch.Tensor
    speed: torch.Tensor

    def __init__(self, features: int, legs: int):
        super().__init__()
        self.gates = torch.nn.Linear(features, legs)
        torch.nn.init.zeros_(self.gates.weight)
        torch.nn.init.zeros_(self.gates.bias)
        self.gain = torch.nn.Parameter(torch.ones(3))
        self.register_buffer("mean", torch.zeros(3 * legs))
        self.register_buffer("scale", torch.ones(3 * legs))
        self.register_buffer("speed", torch.zeros(3))

    def set_units(self, mean: np.ndarray, scale: np.ndarray, output_scale: np.ndarray) -> None:
        """Set the units from the inputs' mean and scale (C,), and the outputs' scale (3,) [m/s]."""
        columns = len(self.mean)
        unit = np.tile(output_scale, columns // 3)
        self.mean.copy_(torch.from_numpy(mean[-columns:] / unit))
        self.scale.copy_(torch.from_numpy(scale[-columns:] / unit))
        self.speed.copy_(torch.from_numpy(output_scale / STILL))

    def forward(
        self, x: torch.Tensor, features: torch.Tensor, correction: torch.Tensor
    ) -> torch.Tensor:
        """Velocity (..., 3) by legs and correction (..., 3), in units of the output."""
        u = (self.mean + self.scale * x[..., -len(self.mean) :]).unflatten(-1, (-1, 3))
        w = torch.softmax(self.gates(features), -1)
        by_legs = -self.gain * (w[..., None] * u).sum(-2)
        square = (self.speed * u).square().sum(-1).mean(-1, keepdim=True)
        return by_legs + correction * (square / (square + 1.0) if self.speed.any() else 1.0)


def torch_features(network: Network, whole: bool) -> Features:
    """Function that computes the features of a network's architecture by torch.

    Args:
        network: whose architecture is causal, unless the log is whole.
        whole: whether the one call has the whole log; otherwise it goes sample by sample.
    """
    body = network.body
    step = None if whole else body.stepper()

    @torch.no_grad()
    def run(x: np.ndarray) -> np.ndarray:
        x = x.copy()  # an architecture may write to its input
        if step is None:
            features = body(torch.from_numpy(x[:, None]))[:, 0].numpy()
        else:
            features = np.array([step(row) for row in x], np.float32)
        return features.reshape(len(x), body.features)

    return run


def loss_of(kind: str, outputs: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Loss of each sample, (...), of head outputs (..., 3 or 9) for velocities (..., 3).

    mse: |v - v_hat|^2 / 3. gml: log det L + |L^-1 (v - v_hat)|^2 / 2, the negative log-likelihood
    without its constant, by forward substitution.
    """
    error = target - outputs[..., :3]
    if kind == "mse":
        return error.square().mean(-1)
    d = softplus(outputs[..., 3:6]) + SMALLEST
    a = outputs[..., 6:9]
    z0 = error[..., 0] / d[..., 0]
    z1 = (error[..., 1] - a[..., 0] * z0) / d[..., 1]
    z2 = (error[..., 2] - a[..., 1] * z0 - a[..., 2] * z1) / d[..., 2]
    return d.log().sum(-1) + 0.5 * (z0.square() + z1.square() + z2.square())
