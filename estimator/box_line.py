"""Moments along the innermost line of a box: a one-dimensional Gaussian on an interval."""

import math

import numpy as np
from numba import njit

from estimator.quadrature import NODES, WEIGHTS, drop_between, rule

DEPTH = 36.0
"""Parts of a box whose density is below exp(-36) = 2e-16 of its largest are left out."""
_FAR = 4.0
_NARROW = 1.0
_SQRT_HALF = math.sqrt(0.5)
_SQRT_2PI = math.sqrt(2.0 * math.pi)


@njit(cache=True)
def line_moments(a: float, b: float, depth: float):
    """log-scaled moments of the standard normal density on [a, b]: (shift, m0, m1, m2, origin).

    The integral of exp(-x^2/2) (x - origin)^n over [a, b] is exp(-shift) m_n. Closed form (erfc)
    where its differences keep their digits; in tails and on narrow intervals, where they cancel,
    quadrature. What lies `depth` below the largest density is left out of a tail.
    """
    if a > 0.0:
        near, sign = a, 1.0
    elif b < 0.0:
        near, sign = -b, -1.0
    else:
        near, sign = 0.0, 1.0
    if near <= _FAR and b - a >= _NARROW:
        return _closed_form(a, b)
    if near == 0.0:
        return _by_quadrature(a, b - a, 0.0, 1.0)
    length = min(b - a, 2.0 * depth / (near + math.sqrt(near * near + 2.0 * depth)))
    # Bounds so far away that they round to the same number still leave an interval.
    return _by_quadrature(near, max(length, 1e-100), near, sign)


@njit(cache=True)
def _closed_form(a: float, b: float):
    density_a = math.exp(-0.5 * a * a)
    density_b = math.exp(-0.5 * b * b)
    if a > 0.0:
        m0 = math.erfc(a * _SQRT_HALF) - math.erfc(b * _SQRT_HALF)
    elif b < 0.0:
        m0 = math.erfc(-b * _SQRT_HALF) - math.erfc(-a * _SQRT_HALF)
    else:
        m0 = math.erf(b * _SQRT_HALF) - math.erf(a * _SQRT_HALF)
    m0 *= 0.5 * _SQRT_2PI
    m2 = m0
    if density_a > 0.0:
        m2 += a * density_a
    if density_b > 0.0:
        m2 -= b * density_b
    return 0.0, m0, density_a - density_b, m2, 0.0


@njit(cache=True)
def _by_quadrature(near: float, length: float, origin: float, sign: float):
    """Moments of exp(-(x^2 - origin^2)/2) about the origin from near on, mirrored by sign."""
    drop = length * (max(near, 0.0) + 0.5 * length)
    _, count, at = rule(length, 1.0, drop)
    m0 = m1 = m2 = 0.0
    for i in range(at, at + count):
        y = near - origin + length * NODES[i]
        w = WEIGHTS[i] * math.exp(-y * (origin + 0.5 * y))
        m0 += w
        m1 += w * y
        m2 += w * y * y
    shift = 0.5 * origin * origin
    return shift, m0 * length, sign * m1 * length, m2 * length, sign * origin


@njit(cache=True)
def plane_moments(
    m1: float, m2: float, s1: float, slope: float, s2: float,
    l1: float, u1: float, l2: float, u2: float,
    c1: float, c2: float, x1: float, log_scale: float, depth: float, out,
):  # fmt: skip
    """Moments of a two-dimensional Gaussian on a rectangle, about (c1, c2), scaled; into out (6,).

    Axis 1 is N(m1, s1^2); axis 2 given it N(m2 + slope (x1 - m1), s2^2). x1 is axis 1 of the
    rectangle's nearest point. The densities are exp(log_scale - distance^2 / 2), without the
    factor 1/(2 pi s1 s2); out holds the moments 1, 1', 2', 1'1', 1'2', 2'2'.
    """
    out[:] = 0.0
    left, right = _window(m1, m2, s1, slope, s2, l1, u1, l2, u2, x1, depth)
    if not right > left:
        return
    # Beyond the crossings the mean of axis 2 leaves its interval, and the integrand bends faster.
    sharp = 1.0 / math.sqrt(1.0 / (s1 * s1) + (slope / s2) ** 2)
    first, second = left, left
    if sharp < 0.5 * s1:
        reach = math.sqrt(2.0 * depth) * s2 / abs(slope)
        at_lower = m1 + (l2 - m2) / slope
        at_upper = m1 + (u2 - m2) / slope
        first = min(max(min(at_lower, at_upper) + reach, left), right)
        second = min(max(max(at_lower, at_upper) - reach, left), right)
        if second <= first:
            first, second = left, left
    for part in range(3):
        start = left if part == 0 else (first if part == 1 else second)
        end = first if part == 0 else (second if part == 1 else right)
        if not end > start:
            continue
        drop = drop_between(
            _fall(start, m1, m2, s1, slope, s2, l2, u2),
            _fall(end, m1, m2, s1, slope, s2, l2, u2),
            _fall(x1, m1, m2, s1, slope, s2, l2, u2),
            start < x1 < end,
        )
        pieces, count, at = rule(end - start, s1 if part == 1 else sharp, drop)
        step = (end - start) / pieces
        for piece in range(pieces):
            origin = start + piece * step
            for i in range(at, at + count):
                x = origin + step * NODES[i]
                d = (x - m1) / s1
                mean = m2 + slope * (x - m1)
                shift, n0, n1, n2, about = line_moments((l2 - mean) / s2, (u2 - mean) / s2, depth)
                w = step * WEIGHTS[i] * math.exp(log_scale - 0.5 * d * d - shift) * s2
                y1 = x - c1
                # Moments about c2: the line's own come about mean + s2 * about.
                off = mean + s2 * about - c2
                k1 = off * n0 + s2 * n1
                out[0] += w * n0
                out[1] += w * y1 * n0
                out[2] += w * k1
                out[3] += w * y1 * y1 * n0
                out[4] += w * y1 * k1
                out[5] += w * (off * k1 + s2 * (off * n1 + s2 * n2))


@njit(cache=True)
def _window(m1, m2, s1, slope, s2, l1, u1, l2, u2, x1, depth):
    """Where along axis 1 the log density of the best point lies within `depth` of the largest.

    The profile is a concave parabola in three pieces: axis 2 at its lower bound, inside, at its
    upper one. Its exact end on either side is the root of the piece that it ends in.
    """
    level = 2.0 * (_fall(x1, m1, m2, s1, slope, s2, l2, u2) + depth)
    left = _end(m1, m2, s1, slope, s2, l2, u2, level, -1.0)
    right = _end(m1, m2, s1, slope, s2, l2, u2, level, 1.0)
    return max(left, l1), min(right, u1)


@njit(cache=True)
def _fall(x, m1, m2, s1, slope, s2, l2, u2) -> float:
    """Half the squared distance of the best point at x along axis 1."""
    mean = m2 + slope * (x - m1)
    off = (mean - min(max(mean, l2), u2)) / s2
    along = (x - m1) / s1
    return 0.5 * (along * along + off * off)


@njit(cache=True)
def _end(m1, m2, s1, slope, s2, l2, u2, level, side):
    """The point x1 on one side (+1, -1) at which the squared distance reaches `level`."""
    reach = s1 * math.sqrt(level)
    if slope == 0.0:
        return m1 + side * reach
    # Going outward, axis 2's mean passes the bound `behind` and then the bound `ahead`.
    ahead, behind = (u2, l2) if side * slope > 0.0 else (l2, u2)
    ratio = slope / s2
    precision = 1.0 / (s1 * s1) + ratio * ratio
    for bound, outer in ((ahead, True), (behind, False)):
        if not np.isfinite(bound):
            continue
        crossing = m1 + (bound - m2) / slope
        distance = (m1 - crossing) ** 2 / (s1 * s1 + 1.0 / (ratio * ratio))
        centre = (m1 / (s1 * s1) + crossing * ratio * ratio) / precision
        root = centre + side * math.sqrt(max(level - distance, 0.0) / precision)
        if outer and distance <= level and side * (root - crossing) >= 0.0:
            return root
        if not outer and side * (crossing - (m1 + side * reach)) > 0.0:
            return root
    return m1 + side * reach
