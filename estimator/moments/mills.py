"""Mills' ratio of the normal distribution by table: one division and a short polynomial, to 15
digits.
"""

import math

import numpy as np
from scipy.special import erfcx

from surefoot.sim.common.kernels import kernel

_PIECES, _DEGREE = 64, 8
_SCALE = 3.0


def _table() -> np.ndarray:
    """Coefficients (_PIECES, 3, _DEGREE + 1), lowest first, of R / u, D / u^2 and E / u^3.

    u = _SCALE / (_SCALE + x) maps [0, inf) to (0, 1], where the quotients are smooth.
    """
    nodes = np.cos(np.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))
    powers = np.linalg.inv(np.vander(nodes, increasing=True))
    u = (np.arange(_PIECES)[:, None] + 0.5 + 0.5 * nodes) / _PIECES
    x = _SCALE / u - _SCALE
    R = math.sqrt(math.pi / 2.0) * erfcx(x / math.sqrt(2.0))
    D = 1.0 - x * R
    E = R - x * D
    # For large x the differences cancel; there R = 1 / (x + 1 / (x + 2 / (x + 3 / ...))).
    far = np.maximum(x, 4.0)
    tail = far
    for k in range(200, 2, -1):
        tail = far + k / tail
    above = 2.0 / tail
    D = np.where(x > 4.0, 1.0 / (far * (far + above) + 1.0), D)
    E = np.where(x > 4.0, above * D, E)
    return np.stack([R / u, D / u**2, E / u**3], axis=1) @ powers.T


TABLE = _table()


@kernel(error_model="numpy")
def mills(x: float):
    """R, D and E: the integrals of exp(-x t - t^2/2) over t >= 0 with the weights 1, t and t^2.

    For x >= 0. R(x) = (1 - Phi(x)) / phi(x), D = 1 - x R and E = R - x D, each to full precision.
    """
    u = _SCALE / (_SCALE + x)
    at = min(int(_PIECES * u), _PIECES - 1)
    s = 2.0 * (_PIECES * u - at) - 1.0
    r, d, e = TABLE[at, 0, _DEGREE], TABLE[at, 1, _DEGREE], TABLE[at, 2, _DEGREE]
    for k in range(_DEGREE - 1, -1, -1):
        r = r * s + TABLE[at, 0, k]
        d = d * s + TABLE[at, 1, k]
        e = e * s + TABLE[at, 2, k]
    return r * u, d * u * u, e * u * u * u
