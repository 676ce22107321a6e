"""One layer of gated recurrent units over whole sequences, with compiled forward and backward
passes.

    r = sigmoid(g_r + W_r h + b_r)
    z = sigmoid(g_z + W_z h + b_z)
    n = tanh(g_n + r * (W_n h + b_n))
    h' = (1 - z) n + z h

with g = W_x x + b_x the contribution of the inputs, computed beforehand for all steps at once.
Equations and weight layout are those of torch.nn.GRU, whose state dict fits. With 64 units and
small batches, torch spends more time per step in dispatch than in arithmetic: forward and backward
through 1000 steps of 4 windows took torch.nn.GRU (2.13, one thread) 8 times as long as this loop,
as did a whole log without gradients, and 8 windows 5 times.
"""

import math
from collections.abc import Callable

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from surefoot.sim.common.kernels import kernel


@kernel(inline="always")
def tanh(x: np.float32) -> np.float32:
    """tanh in float32 by Eigen's rational approximation, within 3e-7, which vectorises."""
    x = min(max(x, np.float32(-7.9)), np.float32(7.9))
    y = x * x
    p = np.float32(-2.76076847742355e-16)
    p = p * y + np.float32(2.00018790482477e-13)
    p = p * y + np.float32(-8.60467152213735e-11)
    p = p * y + np.float32(5.12229709037114e-08)
    p = p * y + np.float32(1.48572235717979e-05)
    p = p * y + np.float32(6.37261928875436e-04)
    p = p * y + np.float32(4.89352455891786e-03)
    q = np.float32(1.19825839466702e-06)
    q = q * y + np.float32(1.18534705686654e-04)
    q = q * y + np.float32(2.26843463243900e-03)
    q = q * y + np.float32(4.89352518554385e-03)
    return x * p / q


@kernel(nogil=True)
def scan(gates: np.ndarray, W: np.ndarray, b: np.ndarray, h0: np.ndarray):
    """Run the recurrence; all arrays are float32 and contiguous.

    gates (T, B, 3H): the inputs' contribution in the order r, z, n; W (H, 3H): W_hh transposed; b
    (3H,); h0 (B, H). Returns h (T + 1, B, H), whose first entry is h0, and the values for the
    backward pass, r, z, n and W_n h + b_n concatenated, (T, B, 4H).
    """
    T, B, H = gates.shape[0], gates.shape[1], h0.shape[1]
    h = np.empty((T + 1, B, H), np.float32)
    saved = np.empty((T, B, 4 * H), np.float32)
    for i in range(B):
        for j in range(H):  # assigning the array takes three seconds to compile
            h[0, i, j] = h0[i, j]
    a = np.empty(3 * H, np.float32)
    half = np.float32(0.5)
    for t in range(T):
        for i in range(B):
            for j in range(3 * H):
                a[j] = b[j]
            for k in range(H):
                hk = h[t, i, k]
                for j in range(3 * H):
                    a[j] += hk * W[k, j]
            g, s = gates[t, i], saved[t, i]
            for j in range(2 * H):
                s[j] = half + half * tanh(half * (g[j] + a[j]))
            for j in range(H):
                s[3 * H + j] = a[2 * H + j]
                n = tanh(g[2 * H + j] + s[j] * a[2 * H + j])
                s[2 * H + j] = n
                h[t + 1, i, j] = n + s[H + j] * (h[t, i, j] - n)
    return h, saved


@kernel(nogil=True)
def gru_step(x, h, W_x, b_x, W_h, b_h):
    """One step without a batch, for a robot's own loop: the next h (H,).

    All arrays are float32 and contiguous.

    Args:
        x: (C,), inputs of the layer.
        h: (H,), its hidden state.
        W_x: (C, 3H), weights of the inputs, transposed.
        b_x: (3H,), their biases.
        W_h: (H, 3H), weights of the hidden state, transposed.
        b_h: (3H,), their biases.
    """
    gates = b_x.copy()
    for k in range(x.shape[0]):
        xk = x[k]
        for j in range(gates.shape[0]):
            gates[j] += xk * W_x[k, j]
    states, _ = scan(gates.reshape(1, 1, -1), W_h, b_h, h.reshape(1, -1))
    return states[1, 0]


@kernel(nogil=True)
def scan_backward(dh_out: np.ndarray, h: np.ndarray, saved: np.ndarray, W: np.ndarray):
    """Reverse mode of `scan`: back-propagation through time.

    dh_out (T, B, H): gradient of the loss by each output h[1:]; W (3H, H): W_hh. Returns the
    gradients by the inputs' contribution, (T, B, 3H), by the recurrent one W_hh h + b_hh, (T, B,
    3H), and by h0, (B, H).
    """
    T, B, H = dh_out.shape
    d_in = np.empty((T, B, 3 * H), np.float32)
    d_rec = np.empty((T, B, 3 * H), np.float32)
    dh = np.zeros((B, H), np.float32)
    one = np.float32(1.0)
    for t in range(T - 1, -1, -1):
        for i in range(B):
            s, di, dr, d = saved[t, i], d_in[t, i], d_rec[t, i], dh[i]
            for j in range(H):
                r, z, n = s[j], s[H + j], s[2 * H + j]
                total = d[j] + dh_out[t, i, j]
                dn = total * (one - z) * (one - n * n)
                dz = total * (h[t, i, j] - n) * z * (one - z)
                d_r = dn * s[3 * H + j] * r * (one - r)
                di[j], di[H + j], di[2 * H + j] = d_r, dz, dn
                dr[j], dr[H + j], dr[2 * H + j] = d_r, dz, dn * r
                d[j] = total * z
            for k in range(3 * H):
                dk = dr[k]
                for j in range(H):
                    d[j] += dk * W[k, j]
    return d_in, d_rec, dh


class _Recurrence(torch.autograd.Function):
    @staticmethod
    def forward(ctx, gates, W_hh, b_hh, h0):
        """`scan` over (T, B, 3H) gates; returns the hidden states (T, B, H).

        Args:
            ctx: torch's context, keeps the arrays for `backward`.
            gates: (T, B, 3H), the inputs' share of the gates.
            W_hh: (3H, H), weights of the hidden state.
            b_hh: (3H,), their biases.
            h0: (B, H), the first hidden state.
        """
        W = W_hh.detach().numpy()
        h, saved = scan(
            gates.detach().contiguous().numpy(),
            np.ascontiguousarray(W.T),
            b_hh.detach().numpy(),
            h0.detach().contiguous().numpy(),
        )
        ctx.arrays = (h, saved, np.ascontiguousarray(W))
        return torch.from_numpy(h)[1:]

    @staticmethod
    @once_differentiable
    def backward(ctx, dh_out):  # pyright: ignore[reportIncompatibleMethodOverride]
        h, saved, W = ctx.arrays
        d_in, d_rec, dh0 = scan_backward(dh_out.contiguous().numpy(), h, saved, W)
        d_rec = torch.from_numpy(d_rec).flatten(0, 1)
        dW = d_rec.T @ torch.from_numpy(h[:-1]).flatten(0, 1)
        return torch.from_numpy(d_in), dW, d_rec.sum(0), torch.from_numpy(dh0)


class GRU(torch.nn.Module):
    """A GRU layer on the CPU in float32, with torch.nn.GRU's equations and parameter names.

    `forward(x (T, B, inputs), h0 (B, hidden) | None) -> h (T, B, hidden)`; no h0 means zeros.
    `stepper()` returns a function for a robot's own loop, from x (inputs,) to h (hidden,), that
    keeps the state.
    """

    width, rate = 64, 1e-2
    receptive_field = None
    causal = True

    def __init__(self, inputs: int, hidden: int):
        super().__init__()
        self.features = hidden
        self.weight_ih_l0 = torch.nn.Parameter(torch.empty(3 * hidden, inputs))
        self.weight_hh_l0 = torch.nn.Parameter(torch.empty(3 * hidden, hidden))
        self.bias_ih_l0 = torch.nn.Parameter(torch.zeros(3 * hidden))
        self.bias_hh_l0 = torch.nn.Parameter(torch.zeros(3 * hidden))

    def initialise(self, generator: torch.Generator) -> None:
        """Uniform within 1/sqrt(hidden), as torch.nn.GRU does, drawn from `generator`."""
        draw_uniform(self, self.features, generator)

    def forward(self, x: torch.Tensor, h0: torch.Tensor | None = None) -> torch.Tensor:
        gates = torch.nn.functional.linear(x, self.weight_ih_l0, self.bias_ih_l0)
        h0 = x.new_zeros(x.shape[1], self.features) if h0 is None else h0
        return _Recurrence.apply(gates, self.weight_hh_l0, self.bias_hh_l0, h0)  # pyright: ignore[reportReturnType]

    def stepper(self) -> Callable[[np.ndarray], np.ndarray]:
        W_x, W_h = _transposed(self.weight_ih_l0), _transposed(self.weight_hh_l0)
        b_x, b_h = self.bias_ih_l0.detach().numpy(), self.bias_hh_l0.detach().numpy()
        h = np.zeros(self.features, np.float32)

        def one(x: np.ndarray) -> np.ndarray:
            nonlocal h
            h = gru_step(x, h, W_x, b_x, W_h, b_h)
            return h

        return one


def draw_uniform(layer: torch.nn.Module, width: int, generator: torch.Generator) -> None:
    """Draw all weights of a layer uniformly within 1/sqrt(width)."""
    k = 1 / math.sqrt(width)
    for p in layer.parameters():
        torch.nn.init.uniform_(p, -k, k, generator=generator)


def _transposed(weight: torch.Tensor) -> np.ndarray:
    return np.ascontiguousarray(weight.detach().numpy().T)
