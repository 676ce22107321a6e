"""The point of a box nearest to a Gaussian's mean in the Mahalanobis distance, over all 27 faces.

Each axis is either free, and then at its conditional mean, or at its lower or upper bound. The
distance is strictly convex, so the nearest feasible candidate is the minimum. Faces are visited by
conditioning, one axis at a time, without an inverse.
"""

import numpy as np

from surefoot.sim.common.kernels import kernel


@kernel
def remaining(variance: float, c: float, other: float) -> float:
    """Variance left by conditioning on a variable of variance `other` and covariance c.

    Kept above working precision, since the subtraction may round to zero or below for a positive
    definite matrix.
    """
    return max(variance - c * c / other, 1e-14 * variance)


@kernel
def nearest_in_rectangle(gaussian, rectangle):
    """Squared distance of a Gaussian to a rectangle, and the nearest point (two numbers).

    Args:
        gaussian: (m0, m1, v0, c, v1), those of N([m0, m1], [[v0, c], [c, v1]]).
        rectangle: (l0, u0, l1, u1), lower and upper bounds of the two axes.
    """
    m0, m1, v0, c, v1 = gaussian
    l0, u0, l1, u1 = rectangle
    best, x0, x1 = np.inf, m0, m1
    # Axis 1 free: at its conditional mean, given axis 0.
    a0 = min(max(m0, l0), u0)
    a1 = m1 + c / v0 * (a0 - m0)
    if l1 <= a1 <= u1:
        best, x0, x1 = (a0 - m0) ** 2 / v0, a0, a1
    rest = remaining(v0, c, v1)
    for side in range(2):
        bound = l1 if side == 0 else u1
        if not np.isfinite(bound):
            continue
        off = bound - m1
        centre = m0 + c / v1 * off
        b0 = min(max(centre, l0), u0)
        distance = off * off / v1 + (b0 - centre) ** 2 / rest
        if distance < best:
            best, x0, x1 = distance, b0, bound
    return best, x0, x1


@kernel
def nearest_given_first(x0: float, C, lower, upper):
    """Squared distance of the zero-mean Gaussian C (3, 3) to the box with x[0] fixed, and x[1:]."""
    b1, b2 = C[0, 1] / C[0, 0], C[0, 2] / C[0, 0]
    given = (
        b1 * x0,
        b2 * x0,
        remaining(C[1, 1], C[0, 1], C[0, 0]),
        C[1, 2] - b1 * C[0, 2],
        remaining(C[2, 2], C[0, 2], C[0, 0]),
    )
    rectangle = lower[1], upper[1], lower[2], upper[2]
    distance, x1, x2 = nearest_in_rectangle(given, rectangle)
    return distance + x0 * x0 / C[0, 0], x1, x2


@kernel
def nearest_in_box(C, lower, upper, point) -> float:
    """Squared distance of the zero-mean Gaussian C (3, 3) to the box; fills the nearest point
    (3,).
    """
    others = 0.0, 0.0, C[1, 1], C[1, 2], C[2, 2]
    rectangle = lower[1], upper[1], lower[2], upper[2]
    best, x1, x2 = nearest_in_rectangle(others, rectangle)
    # Axis 0 free: at its conditional mean, by conditioning on the other two in turn.
    b = C[1, 2] / C[1, 1]
    gain = (C[0, 2] - b * C[0, 1]) / remaining(C[2, 2], C[1, 2], C[1, 1])
    x0 = C[0, 1] / C[1, 1] * x1 + gain * (x2 - b * x1)
    if not lower[0] <= x0 <= upper[0]:
        best = np.inf
    for side in range(2):
        bound = lower[0] if side == 0 else upper[0]
        if not np.isfinite(bound):
            continue
        distance, b1, b2 = nearest_given_first(bound, C, lower, upper)
        if distance < best:
            best, x0, x1, x2 = distance, bound, b1, b2
    point[0], point[1], point[2] = x0, x1, x2
    return best
