"""Architectures of the observer's network: those the paper compared, each of about 20 000
parameters.

| model | input of each output                                       | causal |
|-------|------------------------------------------------------------|--------|
| gru   | everything since the log began, from a zero state          | yes    |
| rnn   | the same                                                   | yes    |
| lstm  | the same                                                   | yes    |
| bigru | the whole log: a GRU from each end, states concatenated    | no     |
| mlp   | 8 samples 40 ms apart: 0.28 s back                         | yes    |
| tcn   | convolutions dilated by 1, 2, 4, 8, 16: 0.62 s back        | yes    |

Each is a class with the interface of `surefoot.models.observer.network.Architecture`, registered by
name in `surefoot.models.registry`. Trained ones of `gru` and `mlp` run without torch, in
`surefoot.models.observer.inference`. Before the start of a log, a window is filled with its first
sample, since the robot stood there.
"""

import math
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from surefoot.models.observer.gru import scan, scan_backward
from surefoot.models.observer.inference import CompiledMLP

Stepper = Callable[[np.ndarray], np.ndarray]


class _Recurrence(torch.autograd.Function):
    @staticmethod
    def forward(ctx, gates, W_hh, b_hh):
        """`scan` over (T, B, 3H) gates from a zero state; returns the hidden states (T, B, H).

        Args:
            ctx: torch's context, keeps the arrays for `backward`.
            gates: (T, B, 3H), the inputs' share of the gates.
            W_hh: (3H, H), weights of the hidden state.
            b_hh: (3H,), their biases.
        """
        W = W_hh.detach().numpy()
        h, saved = scan(
            gates.detach().contiguous().numpy(),
            np.ascontiguousarray(W.T),
            b_hh.detach().numpy(),
            np.zeros((gates.shape[1], W.shape[1]), np.float32),
        )
        ctx.arrays = (h, saved, np.ascontiguousarray(W))
        return torch.from_numpy(h)[1:]

    @staticmethod
    @once_differentiable
    def backward(ctx, dh_out):  # pyright: ignore[reportIncompatibleMethodOverride]
        h, saved, W = ctx.arrays
        d_in, d_rec = scan_backward(dh_out.contiguous().numpy(), h, saved, W)
        d_rec = torch.from_numpy(d_rec).flatten(0, 1)
        dW = d_rec.T @ torch.from_numpy(h[:-1]).flatten(0, 1)
        return torch.from_numpy(d_in), dW, d_rec.sum(0)


class Recurrent(torch.nn.Module):
    """Base of networks with a state, of `features` units."""

    receptive_field = None
    causal = True
    features: int

    def initialise(self, generator: torch.Generator) -> None:
        """Uniform within 1/sqrt(features), as torch does, drawn from `generator`."""
        k = 1 / math.sqrt(self.features)
        for p in self.parameters():
            torch.nn.init.uniform_(p, -k, k, generator=generator)


class GRU(Recurrent):
    """A GRU layer in float32, with torch.nn.GRU's equations and parameter names; on another device
    than the CPU, where the compiled recurrence runs, with its own.

    `forward(x (T, B, inputs)) -> h (T, B, hidden)`, from a zero state.
    """

    width, rate = 64, 1e-2

    def __init__(self, inputs: int, hidden: int):
        super().__init__()
        self.features = hidden
        self.weight_ih_l0 = torch.nn.Parameter(torch.empty(3 * hidden, inputs))
        self.weight_hh_l0 = torch.nn.Parameter(torch.empty(3 * hidden, hidden))
        self.bias_ih_l0 = torch.nn.Parameter(torch.zeros(3 * hidden))
        self.bias_hh_l0 = torch.nn.Parameter(torch.zeros(3 * hidden))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        if x.device.type != "cpu":
            return self._by_torch(x)
        gates = torch.nn.functional.linear(x, self.weight_ih_l0, self.bias_ih_l0)
        return _Recurrence.apply(gates, self.weight_hh_l0, self.bias_hh_l0)  # pyright: ignore[reportReturnType]

    def _by_torch(self, x: torch.Tensor) -> torch.Tensor:
        weights = self.weight_ih_l0, self.weight_hh_l0, self.bias_ih_l0, self.bias_hh_l0
        h0 = x.new_zeros(1, x.shape[1], self.features)
        return torch.gru(x, h0, weights, True, 1, 0.0, self.training, False, False)[0]


class OfTorch(Recurrent):
    """One recurrent layer of torch, of type `layer_type`."""

    layer_type: ClassVar[Callable[[int, int], torch.nn.Module]]

    def __init__(self, inputs: int, width: int):
        super().__init__()
        self.layer = type(self).layer_type(inputs, width)
        self.features = width

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.layer(x)[0]

    def stepper(self) -> Stepper:
        state = None

        @torch.no_grad()
        def step(x: np.ndarray) -> np.ndarray:
            nonlocal state
            features, state = self.layer(torch.from_numpy(x)[None, None], state)
            return features[0, 0].numpy()

        return step


class RNN(OfTorch):
    """A layer of tanh units."""

    layer_type = torch.nn.RNN
    width, rate = 120, 3e-3


class LSTM(OfTorch):
    """A layer of long short-term memory."""

    layer_type = torch.nn.LSTM
    width, rate = 54, 1e-2


class BiGRU(torch.nn.Module):
    """A GRU from the log's start and one from its end. It sees the future, so it has no stepper."""

    width, rate = 40, 1e-2
    receptive_field = None
    causal = False

    def __init__(self, inputs: int, width: int):
        super().__init__()
        self.forwards = GRU(inputs, width)
        self.backwards = GRU(inputs, width)
        self.features = 2 * width

    def initialise(self, generator: torch.Generator) -> None:
        """As in GRU, for both."""
        self.forwards.initialise(generator)
        self.backwards.initialise(generator)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.cat((self.forwards(x), self.backwards(x.flip(0)).flip(0)), -1)


class Windowed(torch.nn.Module):
    """Base of networks that see a window of `receptive_field` samples, by `valid`."""

    receptive_field: ClassVar[int]
    causal = True

    def valid(self, x: torch.Tensor) -> torch.Tensor:
        """Features (T, B, F) from x (T + receptive_field - 1, B, inputs), which includes the
        past.
        """
        raise NotImplementedError

    def initialise(self, generator: torch.Generator) -> None:
        """He's uniform weights for rectified units, drawn from `generator`; no bias."""
        for p in self.parameters():
            if p.dim() > 1:
                torch.nn.init.kaiming_uniform_(p, nonlinearity="relu", generator=generator)
            else:
                torch.nn.init.zeros_(p)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.valid(torch.cat((x[:1].expand(self.receptive_field - 1, -1, -1), x)))

    def stepper(self) -> Stepper:
        window = None

        @torch.no_grad()
        def step(x: np.ndarray) -> np.ndarray:
            nonlocal window
            new = torch.from_numpy(x)[None, None]
            window = new.expand(self.receptive_field, -1, -1) if window is None else window
            window = torch.cat((window[1:], new))
            return self.valid(window)[0, 0].numpy()

        return step


class MLP(Windowed):
    """Two ReLU layers on 8 samples, 40 ms apart."""

    width, rate = 64, 1e-2
    taps, apart = CompiledMLP.taps, CompiledMLP.apart
    receptive_field = (taps - 1) * apart + 1

    def __init__(self, inputs: int, width: int):
        super().__init__()
        self.first = torch.nn.Linear(self.taps * inputs, width)
        self.second = torch.nn.Linear(width, width)
        self.features = width

    def valid(self, x: torch.Tensor) -> torch.Tensor:
        T = len(x) - self.receptive_field + 1
        seen = torch.cat([x[k * self.apart :][:T] for k in range(self.taps)], -1)
        return torch.relu(self.second(torch.relu(self.first(seen))))


class TCN(Windowed):
    """Residual blocks, each with one dilated convolution over three samples and a ReLU."""

    width, rate = 36, 1e-2
    dilations = (1, 2, 4, 8, 16)
    receptive_field = 1 + 2 * sum(dilations)

    def __init__(self, inputs: int, width: int):
        super().__init__()
        self.first = torch.nn.Conv1d(inputs, width, 1)
        self.blocks = torch.nn.ModuleList(
            torch.nn.Conv1d(width, width, 3, dilation=d) for d in self.dilations
        )
        self.features = width

    def valid(self, x: torch.Tensor) -> torch.Tensor:
        h = self.first(x.permute(1, 2, 0))
        for dilation, block in zip(self.dilations, self.blocks, strict=True):
            h = h[..., 2 * dilation :] + torch.relu(block(h))
        return h.permute(2, 0, 1)
