"""The groups SO(3), SE_2(3), SE_{2+K}(3): hat, exp and the Gamma functions.

Every coefficient comes from one family of entire functions of the squared angle,

    e_k(x) = sum_j (-x)^j / (2 j + k)!,     e_k = 1/k! - x e_{k+2},

so that nothing is ever divided by a small angle. Gamma_m (Hartley 2020, Appendix B) is then

    Gamma_m(phi) = sum_n [phi]x^n / (n + m)! = I/m! + e_{m+1} [phi]x + e_{m+2} [phi]x^2.

Gamma_0 is the exponential of SO(3) and Gamma_1 its left Jacobian. An element of SE_{2+K}(3) is the
square matrix [R c_1 ... c_{2+K}; 0 I]; its tangent vectors are ordered (rotation, velocity,
position, ...), as the paper orders xi.
"""

import numpy as np

from surefoot.sim.common.kernels import kernel

# Below this squared angle the series is more accurate, above it the recursion.
_SERIES_LIMIT = 4.0


@kernel
def entire(x: float) -> tuple[float, float, float, float, float, float, float]:
    """e_0 ... e_6 at the squared angle x >= 0 (see the module)."""
    if x < _SERIES_LIMIT:
        e5 = 1.0
        e6 = 1.0
        for j in range(3 if x < 1e-4 else 12, -1, -1):
            e5 = 1.0 - x * e5 / ((2 * j + 6) * (2 * j + 7))
            e6 = 1.0 - x * e6 / ((2 * j + 7) * (2 * j + 8))
        e5 /= 120.0
        e6 /= 720.0
        e4 = 1.0 / 24.0 - x * e6
        e3 = 1.0 / 6.0 - x * e5
        e2 = 0.5 - x * e4
        e1 = 1.0 - x * e3
        return 1.0 - x * e2, e1, e2, e3, e4, e5, e6
    angle = np.sqrt(x)
    e0 = np.cos(angle)
    e1 = np.sin(angle) / angle
    e2 = (1.0 - e0) / x
    e3 = (1.0 - e1) / x
    e4 = (0.5 - e2) / x
    e5 = (1.0 / 6.0 - e3) / x
    e6 = (1.0 / 24.0 - e4) / x
    return e0, e1, e2, e3, e4, e5, e6


def hat(phi: np.ndarray) -> np.ndarray:
    """[phi]x (..., 3, 3) of phi (..., 3): hat(a) @ b = a x b."""
    zero, (x, y, z) = np.zeros_like(phi[..., 0]), np.moveaxis(phi, -1, 0)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


@kernel
def _polynomial(phi, identity: float, linear: float, square: float, out):
    """out = identity I + linear [phi]x + square [phi]x^2."""
    x, y, z = phi[0], phi[1], phi[2]
    out[0, 0] = identity - square * (y * y + z * z)
    out[1, 1] = identity - square * (x * x + z * z)
    out[2, 2] = identity - square * (x * x + y * y)
    out[0, 1] = square * x * y - linear * z
    out[1, 0] = square * x * y + linear * z
    out[0, 2] = square * x * z + linear * y
    out[2, 0] = square * x * z - linear * y
    out[1, 2] = square * y * z - linear * x
    out[2, 1] = square * y * z + linear * x


@kernel
def gammas(phi, gamma_0, gamma_1, gamma_2):
    """Gamma_0, Gamma_1 and Gamma_2 (3, 3) of phi (3,), written into the three arrays."""
    gammas_of(phi, entire(phi[0] ** 2 + phi[1] ** 2 + phi[2] ** 2), gamma_0, gamma_1, gamma_2)


@kernel(inline="always")
def gammas_of(phi, e, gamma_0, gamma_1, gamma_2):
    """`gammas` of phi into gamma_0, gamma_1 and gamma_2, with e, the values of `entire` at the
    squared angle.
    """
    _polynomial(phi, 1.0, e[1], e[2], gamma_0)
    _polynomial(phi, 1.0, e[2], e[3], gamma_1)
    _polynomial(phi, 0.5, e[3], e[4], gamma_2)
