"""One layer of gated recurrent units over whole sequences, in compiled loops, forward and backward.

    r = sigmoid(g_r + W_r h + b_r)
    z = sigmoid(g_z + W_z h + b_z)
    n = tanh(g_n + r * (W_n h + b_n))
    h' = (1 - z) n + z h

with g = W_x x + b_x the contribution of the inputs, computed beforehand for all steps at once.
Equations and weight layout are those of torch.nn.GRU. Training and running share `scan`. With 64
units and small batches, torch spends more time per step in dispatch than in arithmetic: forward and
backward through 1000 steps of 4 windows took torch.nn.GRU (2.13, one thread) 8 times as long as
this loop, as did a whole log without gradients, and 8 windows 5 times.
"""

import numpy as np

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
def scan_backward(dh_out: np.ndarray, h: np.ndarray, saved: np.ndarray, W: np.ndarray):
    """Reverse mode of `scan`: back-propagation through time.

    dh_out (T, B, H): gradient of the loss by each output h[1:]; W (3H, H): W_hh. Returns the
    gradients by the inputs' contribution and by the recurrent one W_hh h + b_hh, (T, B, 3H) each.
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
    return d_in, d_rec
