"""Probability and moments of a three-dimensional Gaussian on a box, without sampling.

Two dimensions are integrated by nested Gauss-Legendre rules, the innermost in closed form. Three
measures keep the precision: the windows of integration follow from the exact nearest point of the
box (27 faces), all weights are relative to the density there, and moments are accumulated about it.
The outermost axis is the one with the shortest interval relative to its conditional deviation:
narrow, or weakly correlated.

For strongly correlated axes the integrand bends sharply at known places, where the conditional mean
of one axis, given the others, crosses a bound. The rules are split there.

The covariance of a truncated Gaussian does not exceed that of the Gaussian, as for every convex
set, but only up to rounding in the computed moments: `clip_to_prior` enforces it.
"""

import math

import numpy as np

from surefoot.estimator.core.checks import numbers, real, spd
from surefoot.estimator.moments.faces import (
    nearest_given_first,
    nearest_in_box,
    remaining,
)
from surefoot.estimator.moments.grid import grid_moments
from surefoot.estimator.moments.line import DEPTH, line_moments, plane_moments
from surefoot.estimator.moments.parts import outer_parts
from surefoot.estimator.moments.quadrature import NODES, WEIGHTS, drop_between, rule
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import kernel

_LOG_2PI = math.log(2.0 * math.pi)
_FAR = 1e6
"""Squared distance beyond which differences from the prior's covariance are lost to rounding."""
_ROUNDING = 5e-10
"""Tolerance above the prior's covariance, in units of the prior's variances."""


def box_moments(
    mean: np.ndarray, cov: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Log probability, mean (3,) and covariance (3, 3) of N(mean, cov) truncated to a box.

    mean (3,), cov (3, 3), lower (3,) and upper (3,) are in any one unit; bounds may be infinite.
    The results are log pi, mu_C and Sigma_C of eqs. pi_def_error_state and
    trunc_moments_error_state. Deterministic, and finite for boxes many deviations away. Raises
    SurefootError, a ValueError, on wrong shapes, NaN, lower >= upper, or a covariance that is not
    symmetric positive definite.
    """
    mean, cov = numbers("box_moments: mean", mean, (3,)), spd("box_moments: cov", cov, 3)
    lower, upper = real("box_moments: lower", lower), real("box_moments: upper", upper)
    if lower.shape != (3,) or upper.shape != (3,) or not np.all(lower < upper):
        raise SurefootError("box_moments: lower must be three numbers below those of upper")
    out_mean, out_cov = np.empty(3), np.empty((3, 3))
    return box_moments_kernel(mean, cov, lower, upper, out_mean, out_cov), out_mean, out_cov


@kernel
def box_moments_kernel(mean, cov, lower, upper, out_mean, out_cov) -> float:
    """`surefoot.estimator.box.box_moments`, compiled; returns the log probability of the box.

    Args:
        mean: (3,) of the Gaussian, in the unit of the bounds.
        cov: (3, 3) of the Gaussian, positive definite.
        lower: (3,), the box's lower bounds; may be -inf.
        upper: (3,), the box's upper bounds; may be inf.
        out_mean: (3,), receives the truncated mean.
        out_cov: (3, 3), receives the truncated covariance.
    """
    order, spread = np.empty(3, dtype=np.int64), np.empty(3)
    C, low, high = np.empty((3, 3)), np.empty(3), np.empty(3)
    for i in range(3):
        spread[i] = math.sqrt(cov[i, i])
    _axis_order(mean, cov, lower, upper, spread, order)
    for i in range(3):
        a = order[i]
        low[i] = (lower[a] - mean[a]) / spread[a]
        high[i] = (upper[a] - mean[a]) / spread[a]
        for j in range(3):
            C[i, j] = cov[a, order[j]] / (spread[a] * spread[order[j]])
    mode = np.empty(3)
    distance = nearest_in_box(C, low, high, mode)
    found, S = np.empty(3), np.empty((3, 3))
    log_prob = grid_moments(C, low, high, mode, distance, found, S)
    if np.isnan(log_prob):
        sums = np.zeros(10)
        log_prob = _integrate(C, low, high, mode, distance, sums)
        _centre(sums, mode, found, S)
        sound = 1e-60 < sums[0] < np.inf  # above the mode's rounding
        for i in range(3):
            sound &= 0.0 < S[i, i] < np.inf
        if not (sound and (distance < _FAR or below_prior(C, S))):
            log_prob = _corner(C, low, high, mode, distance, sums)
            _centre(sums, mode, found, S)
        log_prob += math.log(sums[0])
    if not below_prior(C, S):
        clip_to_prior(C, S)
    for i in range(3):
        a = order[i]
        out_mean[a] = min(max(mean[a] + spread[a] * found[i], lower[a]), upper[a])
        for j in range(3):
            out_cov[a, order[j]] = spread[a] * spread[order[j]] * S[i, j]
    return min(log_prob, 0.0)


@kernel(error_model="numpy")
def _centre(sums, mode, mean, cov):
    """Mean (3,) and covariance (3, 3) from the moments 0, 1 and 2 about the mode."""
    total = sums[0]
    for i in range(3):
        mean[i] = mode[i] + sums[1 + i] / total
        for j in range(i, 3):
            second = sums[4 + 3 * i - i * (i - 1) // 2 + j - i] / total
            cov[i, j] = cov[j, i] = second - sums[1 + i] * sums[1 + j] / (total * total)


@kernel
def _corner(C, low, high, mode, distance, sums) -> float:
    """Approximate moments where distances are so large that their differences have no digits left.

    Each axis by itself, given the other two at the nearest point: finite, inside the box and below
    the prior. Needed beyond 200 deviations with correlations within 1e-6 of one.

    Args:
        C: (3, 3), correlation matrix.
        low: (3,), the box's lower bounds in prior standard deviations from the mean.
        high: (3,), its upper bounds, likewise.
        mode: (3,), the point of the box nearest to zero.
        distance: squared Mahalanobis distance of the mode.
        sums: (10,), receives the moments 0, 1 and 2 about the mode.
    """
    sums[:] = 0.0
    sums[0] = 1.0
    log_density = -0.5 * distance - 1.5 * _LOG_2PI
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        b = C[j, k]
        rest = remaining(1.0, b, 1.0)
        given = remaining(1.0, C[i, j], 1.0)
        gain = (C[i, k] - b * C[i, j]) / rest
        s = math.sqrt(remaining(given, C[i, k] - b * C[i, j], rest))
        mean = C[i, j] * mode[j] + gain * (mode[k] - b * mode[j])
        _, n0, n1, n2, about = line_moments((low[i] - mean) / s, (high[i] - mean) / s)
        first = n1 / n0
        sums[1 + i] = min(max(mean + s * (about + first), low[i]), high[i]) - mode[i]
        sums[4 + 3 * i - i * (i - 1) // 2] = s * s * (n2 / n0 - first * first) + sums[1 + i] ** 2
        log_density += math.log(s * n0)
    for i in range(2):
        for j in range(i + 1, 3):
            sums[4 + 3 * i - i * (i - 1) // 2 + j - i] = sums[1 + i] * sums[1 + j]
    b1 = C[0, 1]
    v1 = remaining(1.0, b1, 1.0)
    v2 = remaining(remaining(1.0, C[0, 2], 1.0), C[1, 2] - b1 * C[0, 2], v1)
    return log_density - 0.5 * math.log(v1 * v2)


@kernel
def _axis_order(mean, cov, lower, upper, spread, order):
    """Sort the axes by the length of their interval relative to their conditional deviation.

    Args:
        mean: (3,) of the Gaussian.
        cov: (3, 3) of the Gaussian.
        lower: (3,), the box's lower bounds.
        upper: (3,), its upper bounds.
        spread: (3,), prior standard deviations.
        order: (3,), receives the axes, the shortest interval first.
    """
    length = np.empty(3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        b = cov[j, k] / cov[j, j]
        given = remaining(cov[i, i], cov[i, j], cov[j, j])
        rest = remaining(cov[k, k], cov[j, k], cov[j, j])
        left = remaining(given, cov[i, k] - b * cov[i, j], rest)
        reach = math.sqrt(2.0 * DEPTH) * spread[i]
        inside = min(upper[i] - mean[i], reach) - max(lower[i] - mean[i], -reach)
        if inside <= 0.0:
            inside = min(upper[i] - lower[i], reach)
        length[i] = inside / math.sqrt(left)
        order[i] = i
    for i in range(2):
        for j in range(2 - i):
            if length[order[j]] > length[order[j + 1]]:
                order[j], order[j + 1] = order[j + 1], order[j]


@kernel
def _integrate(C, low, high, mode, distance, sums) -> float:
    """Moments of the box by nested rules; returns the log of their common factor.

    Args:
        C: (3, 3), correlation matrix.
        low: (3,), the box's lower bounds in prior standard deviations from the mean.
        high: (3,), its upper bounds, likewise.
        mode: (3,), the point of the box nearest to zero.
        distance: squared Mahalanobis distance of the mode.
        sums: (10,), zeros, receives the moments 0, 1 and 2 about the mode.
    """
    # Axis 1 given axis 0, and axis 2 given both.
    b1, b2 = C[0, 1], C[0, 2]
    v1 = remaining(1.0, b1, 1.0)
    slope = (C[1, 2] - b1 * b2) / v1
    v2 = remaining(remaining(1.0, b2, 1.0), C[1, 2] - b1 * b2, v1)
    s1, s2 = math.sqrt(v1), math.sqrt(v2)
    left = _outer_end(C, low, high, mode, distance, -1.0)
    right = _outer_end(C, low, high, mode, distance, 1.0)
    cuts, scales = np.empty(16), np.empty(16)
    parts = outer_parts(C, low, high, left, right, distance, cuts, scales)
    inner = np.empty(6)
    rectangle = low[1], high[1], low[2], high[2]
    for part in range(parts):
        start, end = cuts[part], cuts[part + 1]
        drop = drop_between(
            0.5 * nearest_given_first(start, C, low, high)[0],
            0.5 * nearest_given_first(end, C, low, high)[0],
            0.5 * distance,
            start < mode[0] < end,
        )
        pieces, count, at = rule(end - start, scales[part], drop)
        step = (end - start) / pieces
        for piece in range(pieces):
            for i in range(at, at + count):
                x = start + step * (piece + NODES[i])
                nearest, x1, _ = nearest_given_first(x, C, low, high)
                depth = DEPTH - 0.5 * (nearest - distance)
                if depth <= 0.0:
                    continue
                given = b1 * x, b2 * x, s1, slope, s2
                about = mode[1], mode[2], x1, 0.5 * (distance - x * x), depth
                plane_moments(given, rectangle, about, inner)
                w = step * WEIGHTS[i]
                y = x - mode[0]
                sums[0] += w * inner[0]
                sums[1] += w * y * inner[0]
                sums[2] += w * inner[1]
                sums[3] += w * inner[2]
                sums[4] += w * y * y * inner[0]
                sums[5] += w * y * inner[1]
                sums[6] += w * y * inner[2]
                sums[7] += w * inner[3]
                sums[8] += w * inner[4]
                sums[9] += w * inner[5]
    return -0.5 * distance - 1.5 * _LOG_2PI - math.log(s1 * s2)


@kernel
def _outer_end(C, low, high, mode, distance, side: float) -> float:
    """End of the window of axis 0 on one side, where its best point lies DEPTH below the mode.

    Args:
        C: (3, 3), correlation matrix.
        low: (3,), the box's lower bounds in prior standard deviations from the mean.
        high: (3,), its upper bounds, likewise.
        mode: (3,), the point of the box nearest to zero.
        distance: squared Mahalanobis distance of the mode.
        side: -1.0 for the lower end, +1.0 for the upper one.
    """
    bound = high[0] if side > 0.0 else low[0]
    # Half the squared distance of the best point is convex, with at least the marginal's curvature.
    far = mode[0] + side * math.sqrt(2.0 * DEPTH)
    far = min(far, bound) if side > 0.0 else max(far, bound)
    fall_far = 0.5 * (nearest_given_first(far, C, low, high)[0] - distance)
    near, fall_near = mode[0], 0.0
    for _ in range(40):
        if fall_far <= DEPTH + 4.0:
            break
        # Secant step on the root of the fall, which is linear where the fall is a parabola.
        root = math.sqrt(fall_near)
        share = (math.sqrt(DEPTH + 2.0) - root) / (math.sqrt(fall_far) - root)
        middle = near + (far - near) * min(max(share, 0.05), 0.95)
        fall = 0.5 * (nearest_given_first(middle, C, low, high)[0] - distance)
        if fall < DEPTH:
            near, fall_near = middle, max(fall, 0.0)
        else:
            far, fall_far = middle, fall
    return far


@kernel(error_model="numpy")
def below_prior(C, cov) -> bool:
    """Whether C - cov (3, 3) is positive semidefinite but for rounding; C a correlation matrix."""
    a = C[0, 0] - cov[0, 0] + _ROUNDING
    b = C[1, 0] - cov[1, 0]
    c = C[2, 0] - cov[2, 0]
    d = C[1, 1] - cov[1, 1] + _ROUNDING - b * b / a
    e = C[2, 1] - cov[2, 1] - b * c / a
    f = C[2, 2] - cov[2, 2] + _ROUNDING - c * c / a - e * e / d
    return a > 0.0 and d > 0.0 and f > 0.0


@kernel(error_model="numpy")
def clip_to_prior(C, cov):
    """Reduce cov (3, 3), in place, to the correlation matrix C along the directions that exceed it.

    With C = L L^T, no eigenvalue of L^-1 cov L^-T is above one afterwards.
    """
    L = np.zeros((3, 3))
    for i in range(3):
        for j in range(i + 1):
            rest = C[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(rest) if i == j else rest / L[j, j]
    if not L[1, 1] * L[2, 2] > 0.0:
        return
    whitening = np.linalg.inv(L)
    values, vectors = np.linalg.eigh(whitening @ cov @ whitening.T)
    for k in range(3):
        if values[k] > 1.0:
            direction = L @ np.ascontiguousarray(vectors[:, k])
            for i in range(3):
                for j in range(3):
                    cov[i, j] -= (values[k] - 1.0) * direction[i] * direction[j]
