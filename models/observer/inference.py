"""A trained network at work: from scaled inputs, 10 ms apart, to the outputs of its head.

The architectures in COMPILED run here, in float32 and without torch. An object of one of these
classes continues where its last call ended, and its loops sum each row in the same order whatever
their number: a whole log gives the same bits as its samples one by one, which BLAS would not.
"""

from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np

from surefoot.models.observer.gru import scan
from surefoot.models.observer.odometry import add_leg_velocity, complete_weights
from surefoot.sim.common.kernels import kernel

Features = Callable[[np.ndarray], np.ndarray]
"""x (T, inputs), from a log's first sample or the one after the last call -> (T, features)."""
Weights = Mapping[str, np.ndarray]
"""Name in torch's state dict -> weights (float32), of a whole network."""
LOSS_OUTPUTS = {"mse": 3, "gml": 9}
"""Number of the head's outputs, by loss."""
SMALLEST = 1e-3
"""Lower bound of L's diagonal; without one, the likelihood is unbounded for a perfect fit."""


class CompiledGRU:
    """A GRU (`surefoot.models.observer.gru`), whose state is zero when a log begins."""

    def __init__(self, weights: Weights, inputs: int, width: int):
        """Start as at the beginning of a log. Raises as `linear` does."""
        gates = 3 * width
        self._inputs = linear(weights, "body.weight_ih_l0", inputs, gates)
        self._recurrence = linear(weights, "body.weight_hh_l0", width, gates)
        self._state = np.zeros(width, np.float32)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        states = gru_states(x, self._state, *self._inputs, *self._recurrence)
        self._state = states[-1]
        return states[1:]


class CompiledMLP:
    """Two ReLU layers on `taps` samples that are `apart` steps apart, the last of them the newest.

    Before the start of a log, the window is filled with its first sample.
    """

    taps: ClassVar[int] = 8
    apart: ClassVar[int] = 4

    def __init__(self, weights: Weights, inputs: int, width: int):
        """Start as at the beginning of a log. Raises as `linear` does."""
        self._first = linear(weights, "body.first.weight", self.taps * inputs, width)
        self._second = linear(weights, "body.second.weight", width, width)
        self._past: np.ndarray | None = None

    def __call__(self, x: np.ndarray) -> np.ndarray:
        span = (self.taps - 1) * self.apart
        past = np.repeat(x[:1], span, axis=0) if self._past is None else self._past
        seen = np.concatenate((past, x))
        self._past = seen[-span:]
        return mlp_features(seen, self.apart, *self._first, *self._second)


COMPILED = {"gru": CompiledGRU, "mlp": CompiledMLP}
"""Name -> class of the architectures that run without torch."""


class Head:
    """The linear head of a network, and the leg odometry that it corrects, if there are legs."""

    def __init__(self, weights: Weights, features: int, outputs: int, legs: int):
        """Raises as `linear` does."""
        self._linear = linear(weights, "head.weight", features, outputs)
        self._gates = linear(weights, "odometry.gates.weight", features, legs) if legs else None
        known = complete_weights(weights) if legs else {}
        sizes = {"gain": 3, "mean": 3 * legs, "scale": 3 * legs, "speed": 3} if legs else {}
        self._units = [of_shape(known, f"odometry.{name}", n) for name, n in sizes.items()]

    def __call__(self, x: np.ndarray, features: np.ndarray) -> np.ndarray:
        """Outputs (T, 3 or 9) of scaled inputs x (T, C) and features (T, F)."""
        outputs = dense(features, *self._linear, 1)
        if self._gates:
            gates = dense(features, *self._gates, 1)
            add_leg_velocity(outputs, gates, *self._units, x)
        return outputs


def linear(weights: Weights, name: str, inputs: int, outputs: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (inputs, outputs) and biases (outputs,) of a linear layer.

    Raises LookupError where one is missing, ValueError where it has another shape.
    """
    W = of_shape(weights, name, outputs, inputs)
    return np.ascontiguousarray(W.T), of_shape(weights, name.replace("weight", "bias"), outputs)


def of_shape(weights: Weights, name: str, *shape: int) -> np.ndarray:
    """A weight of that shape, beyond whose ends a compiled loop would read. Raises as `linear`."""
    if weights[name].shape != shape:
        raise ValueError(f"weights: {name} is not of shape {shape}")
    return weights[name]


def cholesky_factor(outputs: np.ndarray) -> np.ndarray:
    """Lower-triangular L (..., 3, 3) with a positive diagonal, from the head's outputs (..., 9)."""
    L = np.zeros((*outputs.shape[:-1], 3, 3), outputs.dtype)
    L[..., range(3), range(3)] = np.logaddexp(0, outputs[..., 3:6]) + SMALLEST
    L[..., [1, 2, 2], [0, 0, 1]] = outputs[..., 6:9]
    return L


@kernel(nogil=True)
def gru_states(x, state, W_x, b_x, W_h, b_h):
    """The given state and those after each sample, (T + 1, H).

    Args:
        x: (T, C), the samples.
        state: (H,), before the first.
        W_x: (C, 3 H), weights of the samples, for the gates.
        b_x: (3 H,), biases.
        W_h: (H, 3 H), weights of the state.
        b_h: (3 H,), biases.
    """
    gates = dense(x, W_x, b_x, np.int64(1))
    states, _ = scan(gates.reshape(len(x), 1, -1), W_h, b_h, state.reshape(1, -1))
    return states.reshape(len(x) + 1, -1)


@kernel(nogil=True)
def mlp_features(x, apart, W_1, b_1, W_2, b_2):
    """Features (T, F) of two layers with rectified outputs.

    Args:
        x: samples, as of `dense`, as is `apart`.
        apart: distance of those that the first layer sees.
        W_1: (taps C, F), weights of the first layer.
        b_1: (F,), its biases.
        W_2: (F, F), weights of the second.
        b_2: (F,), its biases.
    """
    hidden = rectified(dense(x, W_1, b_1, apart))
    return rectified(dense(hidden, W_2, b_2, np.int64(1)))


@kernel(inline="always")
def rectified(y):
    """max(y, 0) of a matrix, in place; nan stays."""
    for t in range(y.shape[0]):
        for j in range(y.shape[1]):
            if y[t, j] < 0:
                y[t, j] = 0
    return y


@kernel(nogil=True)
def dense(x, W, b, apart):
    """Outputs (T, F) of a linear layer that sees one sample, or several at equal distances.

    All arrays are float32 and contiguous. For a literal `apart` numba would compile it once more.

    Args:
        x: (T + (taps - 1) apart, C), the samples.
        W: (taps C, F), weights of the samples, the oldest first.
        b: (F,), biases.
        apart: distance of the samples.
    """
    C, F = x.shape[1], len(b)
    taps = len(W) // C
    y = np.empty((len(x) - (taps - 1) * apart, F), np.float32)
    for t in range(len(y)):
        row = y[t]
        for j in range(F):
            row[j] = b[j]
        for tap in range(taps):
            for k in range(C):
                xk, w = x[t + tap * apart, k], W[tap * C + k]
                for j in range(F):
                    row[j] += xk * w[j]
    return y
