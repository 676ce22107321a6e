"""The observer's network: one of `models.observer.architectures`, a linear head, and the two
losses.

    (h_t, v_t) = NN(y_t, h_{t - dt})          the paper's Eq. (setup_rnn), h_0 = 0

`mse` reads a velocity off the head. `gml` reads a Gaussian's mean and the Cholesky factor L of its
covariance L L^T, and maximises its likelihood (Russell and Reale, Multivariate Uncertainty in Deep
Learning, TNNLS 2022). With leg odometry the head adds to what
the soles say (`models.observer.odometry`). Everything here is in scaled units, float32.
"""

from __future__ import annotations

import math

import torch
from torch.nn.functional import softplus

from surefoot.models.observer.architectures import ARCHITECTURES, Body
from surefoot.models.observer.odometry import Odometry

LOSSES = ("mse", "gml")
OUTPUTS = {"mse": 3, "gml": 9}
SMALLEST = 1e-3
"""Floor of L's diagonal: a likelihood without one grows without bound on a perfect fit."""


class Network(torch.nn.Module):
    """`forward(x (T, B, inputs)) -> head (T, B, outputs)`, from the beginning of a log."""

    def __init__(self, model: str, inputs: int, outputs: int, width: int, odometry: bool = False):
        super().__init__()
        self.body: Body = ARCHITECTURES[model].make(inputs, width)
        self.head = torch.nn.Linear(self.body.features, outputs)
        self.odometry = Odometry(self.body.features) if odometry else None

    def initialise(self, generator: torch.Generator) -> None:
        """Draw all weights from `generator`; the head's bias starts at zero."""
        self.body.initialise(generator)
        k = 1 / math.sqrt(self.head.in_features)
        torch.nn.init.uniform_(self.head.weight, -k, k, generator=generator)
        torch.nn.init.zeros_(self.head.bias)
        if self.odometry is not None:
            # Begin as plain odometry.
            torch.nn.init.zeros_(self.head.weight)
            self.odometry.initialise()

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        features = self.body(x)
        outputs = self.head(features)
        if self.odometry is None:
            return outputs
        return torch.cat((outputs[..., :3] + self.odometry(x, features), outputs[..., 3:]), -1)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(p.numel() for p in self.parameters())


def cholesky_factor(outputs: torch.Tensor) -> torch.Tensor:
    """Lower-triangular L (..., 3, 3) with a positive diagonal from the head's outputs (..., 9)."""
    d = softplus(outputs[..., 3:6]) + SMALLEST
    a = outputs[..., 6:9]
    zero = torch.zeros_like(d[..., 0])
    rows = (
        torch.stack((d[..., 0], zero, zero), -1),
        torch.stack((a[..., 0], d[..., 1], zero), -1),
        torch.stack((a[..., 1], a[..., 2], d[..., 2]), -1),
    )
    return torch.stack(rows, -2)


def loss_of(kind: str, outputs: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Loss of each sample, (...): of head outputs (..., 3 or 9) against velocities (..., 3).

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
