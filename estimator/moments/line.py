"""Moments along the innermost line of a box: a one-dimensional Gaussian on an interval.

Its closed form needs Mills' ratio of the normal distribution, here by table: one division and a
short polynomial, to 15 digits.
"""

import math

import numpy as np
from scipy.special import erfcx

from surefoot.estimator.moments.quadrature import NODES, WEIGHTS, drop_between, rule
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


DEPTH = 28.0
"""Log of the density relative to its maximum below which it is neglected: exp(-28) = 7e-13."""
_NARROW = 0.1
_FEW, _FEW_AT = 6, 6
"""Nodes of a narrow interval, and the start of their rule in the table."""
_SQRT_2PI = math.sqrt(2.0 * math.pi)


@kernel(error_model="numpy")
def line_moments(a: float, b: float):
    """Scaled moments of the standard normal density on [a, b]: (shift, m0, m1, m2, origin).

    The integral of exp(-x^2/2) (x - origin)^n over [a, b] is exp(-shift) m_n. Closed form by Mills'
    ratio, which is accurate in both tails; quadrature on intervals so narrow that its differences
    cancel.
    """
    if a < 0.0 < b:
        if b - a < _NARROW:
            return _by_quadrature(a, b - a, 0.0, 1.0)
        density_a = math.exp(-0.5 * a * a)
        density_b = math.exp(-0.5 * b * b)
        m0 = m2 = _SQRT_2PI
        if density_a > 0.0:
            cut = density_a * mills(-a)[0]
            m0 -= cut
            m2 -= cut - a * density_a
        if density_b > 0.0:
            cut = density_b * mills(b)[0]
            m0 -= cut
            m2 -= cut + b * density_b
        return 0.0, m0, density_a - density_b, m2, 0.0
    near, far, sign = (a, b, 1.0) if a >= 0.0 else (-b, -a, -1.0)
    # Bounds so far away that they round to the same number still enclose an interval.
    length = max(far - near, 1e-100)
    if length * (1.0 + near) < _NARROW:
        return _by_quadrature(near, length, near, sign)
    m0, m1, m2 = mills(near)
    fall = length * (near + 0.5 * length)
    if fall < DEPTH:
        share = math.exp(-fall)
        r, d, e = mills(far)
        m0 -= share * r
        m1 -= share * (d + length * r)
        m2 -= share * (e + length * (2.0 * d + length * r))
    return 0.5 * near * near, m0, sign * m1, m2, sign * near


@kernel(error_model="numpy")
def _by_quadrature(near: float, length: float, origin: float, sign: float):
    """Moments of exp(-(x^2 - origin^2)/2) about the origin, from `near` on, mirrored by sign."""
    m0 = m1 = m2 = 0.0
    for i in range(_FEW_AT, _FEW_AT + _FEW):
        y = near - origin + length * NODES[i]
        w = WEIGHTS[i] * math.exp(-y * (origin + 0.5 * y))
        m0 += w
        m1 += w * y
        m2 += w * y * y
    return 0.5 * origin * origin, m0 * length, sign * m1 * length, m2 * length, sign * origin


@kernel(error_model="numpy")
def plane_moments(gaussian, rectangle, about, out):
    """Scaled moments of a two-dimensional Gaussian on a rectangle, into out (6,).

    Without the factor 1/(2 pi s1 s2); out receives the moments 1, 1', 2', 1'1', 1'2', 2'2'. Where
    the bounds of one axis lie outside the relevant range, only the other axis is integrated.

    Args:
        gaussian: (m1, m2, s1, slope, s2): axis 1 is N(m1, s1^2), and axis 2 given it N(m2 + slope
            (x1 - m1), s2^2).
        rectangle: (l1, u1, l2, u2), bounds of axes 1 and 2.
        about: (c1, c2, x1, log_scale, depth): origin (c1, c2) of the moments; x1 is axis 1 of the
            rectangle's nearest point; densities are exp(log_scale - distance^2 / 2), and are
            neglected below exp(-depth) of the largest.
        out: to fill.
    """
    m1, m2, s1, slope, s2 = gaussian
    l1, u1, l2, u2 = rectangle
    c1, c2, x1, log_scale, depth = about
    out[:] = 0.0
    left, right = _window(m1, m2, s1, slope, s2, l2, u2, x1, depth)
    reach = math.sqrt(2.0 * depth) * s2
    tilt = slope * (max(left, l1) - m1), slope * (min(right, u1) - m1)
    if l2 < m2 + min(tilt) - reach and m2 + max(tilt) + reach < u2:
        out[0], out[1], out[2], out[3], out[4], out[5] = _one_axis(
            m1, s1, l1, u1, c1, m2 - c2, slope, s2, log_scale
        )
        return
    if l1 < left and right < u1:
        # Axis 1 given axis 2.
        spread = math.sqrt(s2 * s2 + slope * slope * s1 * s1)
        share = s1 / spread
        out[0], out[2], out[1], out[5], out[4], out[3] = _one_axis(
            m2, spread, l2, u2, c2, m1 - c1, slope * share * share, s2 * share, log_scale
        )
        return
    left, right = max(left, l1), min(right, u1)
    if not right > left:
        return
    # Beyond the crossings the mean of axis 2 leaves its interval, and the curvature increases.
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
                shift, n0, n1, n2, about = line_moments((l2 - mean) / s2, (u2 - mean) / s2)
                w = step * WEIGHTS[i] * math.exp(log_scale - 0.5 * d * d - shift) * s2
                y1 = x - c1
                # Shift the line's moments, about mean + s2 * about, to c2.
                off = mean + s2 * about - c2
                k1 = off * n0 + s2 * n1
                out[0] += w * n0
                out[1] += w * y1 * n0
                out[2] += w * k1
                out[3] += w * y1 * y1 * n0
                out[4] += w * y1 * k1
                out[5] += w * (off * k1 + s2 * (off * n1 + s2 * n2))


@kernel(error_model="numpy")
def _one_axis(m, s, lower, upper, c, off, slope, rest, log_scale):
    """Moments on an axis N(m, s^2) truncated to [lower, upper], and on a free one that depends on
    it.

    Returns the moments 1, x, free, x x, x free, free free.

    Args:
        m: mean of the truncated axis.
        s: its standard deviation.
        lower: its lower bound.
        upper: its upper bound.
        c: origin of its moments.
        off: mean of the free axis at x = m, from the origin of its moments.
        slope: of the free axis's mean along the truncated one.
        rest: standard deviation of the free axis, given the truncated one.
        log_scale: log of a factor of all moments.
    """
    shift, n0, n1, n2, about = line_moments((lower - m) / s, (upper - m) / s)
    w = math.exp(log_scale - shift) * s * rest * _SQRT_2PI
    away = m + s * about - c
    first = w * (away * n0 + s * n1)
    second = away * first + w * s * (away * n1 + s * n2)
    n0 *= w
    start = off + slope * (c - m)
    free = start * n0 + slope * first
    both = start * first + slope * second
    return n0, first, free, second, both, rest * rest * n0 + start * free + slope * both


@kernel
def _window(m1, m2, s1, slope, s2, l2, u2, x1, depth):
    """Range of axis 1 in which the log density of the best point is within `depth` of the largest.

    The profile is a concave parabola in three pieces: axis 2 at its lower bound, inside, at its
    upper one. Its exact end on either side is the root of the piece that it ends in.

    Args:
        m1: mean of axis 1.
        m2: mean of axis 2 at x1 = m1.
        s1: standard deviation of axis 1.
        slope: of axis 2's mean along axis 1.
        s2: standard deviation of axis 2, given axis 1.
        l2: lower bound of axis 2.
        u2: upper bound of axis 2.
        x1: axis 1 of the rectangle's nearest point.
        depth: fall of the log density at the window's ends.
    """
    level = 2.0 * (_fall(x1, m1, m2, s1, slope, s2, l2, u2) + depth)
    left = _end(m1, m2, s1, slope, s2, l2, u2, level, -1.0)
    right = _end(m1, m2, s1, slope, s2, l2, u2, level, 1.0)
    return left, right


@kernel
def _fall(x, m1, m2, s1, slope, s2, l2, u2) -> float:
    """Half the squared distance of the best point at x along axis 1.

    Args:
        x: along axis 1.
        m1: mean of axis 1.
        m2: mean of axis 2 at x = m1.
        s1: standard deviation of axis 1.
        slope: of axis 2's mean along axis 1.
        s2: standard deviation of axis 2, given axis 1.
        l2: lower bound of axis 2.
        u2: upper bound of axis 2.
    """
    mean = m2 + slope * (x - m1)
    off = (mean - min(max(mean, l2), u2)) / s2
    along = (x - m1) / s1
    return 0.5 * (along * along + off * off)


@kernel
def _end(m1, m2, s1, slope, s2, l2, u2, level, side):
    """The point x1 on one side (+1, -1) at which the squared distance reaches `level`.

    Args:
        m1: mean of axis 1.
        m2: mean of axis 2 at x1 = m1.
        s1: standard deviation of axis 1.
        slope: of axis 2's mean along axis 1.
        s2: standard deviation of axis 2, given axis 1.
        l2: lower bound of axis 2.
        u2: upper bound of axis 2.
        level: squared distance.
        side: +1.0 or -1.0.
    """
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
