"""Box moments on a tensor grid of Gauss-Legendre nodes, with tables of pairs of axes.

On a grid, the density exp(-y^T Lambda y / 2 - g^T y) about the windows' centre is a product of
tables, f_i(y_i) f_j(y_j) f_k(y_k) e_ij(y_i, y_j) e_ik(y_i, y_k) e_jk(y_j, y_k). Only the n^2
exponentials of each need to be computed; the n^3 points are multiplications, which vectorise. Nodes
are symmetric, so one exponential serves four entries of a table.

An axis whose bounds lie outside its window is integrated exactly, without nodes.
"""

import math

import numpy as np

from surefoot.estimator.moments.faces import remaining
from surefoot.estimator.moments.quadrature import MOST, NODES, WEIGHTS
from surefoot.sim.common.copies import copy_corner
from surefoot.sim.common.kernels import kernel

_DEPTH = 30.0
"""Log of the density relative to its maximum below which it is neglected: exp(-30) = 1e-13."""
_LARGEST = 500.0
"""Bound on the exponents of all tables together, which prevents overflow and loss of digits."""
_MOST_POINTS = 60_000.0
_BAND = 30.0
"""Coupling above which a pair is a ridge, whose table is filled along the ridge only."""
_LOG_2PI = math.log(2.0 * math.pi)


@kernel(error_model="numpy")
def grid_moments(C, low, high, mode, distance, mean, cov) -> float:
    """Moments of N(0, C) on a box; returns the log probability, or NaN.

    NaN means that the box is unsuitable for a grid: correlations are too near to one for its
    exponents or its number of nodes.

    Args:
        C: (3, 3), correlation matrix.
        low: (3,), the box's lower bounds.
        high: (3,), its upper bounds.
        mode: (3,), the point of the box nearest to zero.
        distance: its squared Mahalanobis distance.
        mean: (3,), filled.
        cov: (3, 3), filled.
    """
    information, centre, half = np.empty((3, 3)), np.empty(3), np.empty(3)
    free = np.zeros(3, dtype=np.bool_)
    steep = np.empty(3)
    determinant = _inverse(C, information)
    _windows(C, information, low, high, mode, distance, centre, half, steep, free)
    frees = int(free[0]) + int(free[1]) + int(free[2])
    if frees == 3:
        mean[:] = 0.0
        copy_corner(C, cov)
        return 0.0
    if frees > 0:
        determinant = _marginal_inverse(C, free, information)
    # The two most strongly coupled axes are the inner ones.
    i = 0
    strongest = -1.0
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        coupling = abs(information[b, c]) * half[b] * half[c]
        if coupling > strongest:
            strongest, i = coupling, a
    j, k = (i + 1) % 3, (i + 2) % 3
    ridge = strongest > _BAND
    g = np.zeros(3)
    sizes, pieces = np.ones(3, dtype=np.int64), np.ones(3, dtype=np.int64)
    largest = 0.0
    constant = 0.0
    for a in range(3):
        if free[a]:
            continue
        for b in range(3):
            if not free[b]:
                g[a] += information[a, b] * centre[b]
        constant += g[a] * centre[a]
        # Next to a singular correlation, rounding may leave no window or no curvature.
        if not (half[a] >= 0.0 and information[a, a] > 0.0):
            return np.nan
        z = half[a] * math.sqrt(information[a, a])
        count = max(5.0 + 3.3 * z, 4.5 + 2.7 * math.sqrt(2.0 * steep[a] * half[a] + 0.5 * z * z))
        if not count < _MOST_POINTS:
            return np.nan
        pieces[a] = 1 + int(count / MOST)
        pairs = math.ceil(0.5 * count / pieces[a])
        sizes[a] = 2 * pairs * pieces[a]
        largest += abs(g[a]) * half[a]
        if a == i or not ridge:
            largest += 0.5 * information[a, a] * half[a] ** 2
    constant = 0.5 * (distance - constant)
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        if not (ridge and a == i):
            largest += abs(information[b, c]) * half[b] * half[c]
    if not largest < _LARGEST:
        return np.nan
    if sizes[0] * sizes[1] * sizes[2] > _MOST_POINTS:
        return np.nan
    ni, nj, nk = sizes[i], sizes[j], sizes[k]
    blocks = (nj + 3) // 4
    wide = 4 * blocks
    tables = np.zeros((2, 3, max(ni, wide, nk)))
    nodes, weights = tables[0], tables[1]
    for row, a in ((0, i), (1, j), (2, k)):
        bend = 0.0 if ridge and a != i else information[a, a]
        _axis(sizes[a], pieces[a], half[a], free[a], g[a], bend, nodes[row], weights[row])
    yi, yj, yk = nodes[0], nodes[1], nodes[2]
    fi, fj, fk = weights[0], weights[1], weights[2]
    products = np.empty((3, nk))
    b0, b1, b2 = products[0], products[1], products[2]
    eij, eik = np.zeros((ni, wide)), np.empty((ni, nk))
    _pair(yi, ni, yj, nj, information[i, j], eij.reshape(ni, wide, 1))
    _pair(yi, ni, yk, nk, information[i, k], eik.reshape(ni, nk, 1))
    ejk = np.zeros((blocks, nk, 4))
    first, last = np.zeros(blocks, dtype=np.int64), np.full(blocks, nk)
    if ridge:
        dj, dk = information[j, j], information[k, k]
        shift = (abs(information[i, k]) * half[i] + abs(g[k])) / dk
        _ridge(yj, nj, dj, yk, nk, dk, information[j, k], shift, ejk, first, last)
    else:
        _pair(yj, nj, yk, nk, information[j, k], ejk)
    s, lanes = np.zeros(10), np.empty((6, 4))
    for p in range(ni):
        x = yi[p]
        for q in range(nk):
            b = fk[q] * eik[p, q]
            b0[q] = b
            b1[q] = b * yk[q]
            b2[q] = b1[q] * yk[q]
        r0 = r1 = r2 = rk = rjk = rkk = 0.0
        for block in range(blocks):
            # Twelve numbers, since sums in an array would take three times as long.
            u0 = u1 = u2 = u3 = v0 = v1 = v2 = v3 = w0 = w1 = w2 = w3 = 0.0
            for q in range(first[block], last[block]):
                e, c0, c1, c2 = ejk[block, q], b0[q], b1[q], b2[q]
                e0, e1, e2, e3 = e[0], e[1], e[2], e[3]
                u0 += e0 * c0
                u1 += e1 * c0
                u2 += e2 * c0
                u3 += e3 * c0
                v0 += e0 * c1
                v1 += e1 * c1
                v2 += e2 * c1
                v3 += e3 * c1
                w0 += e0 * c2
                w1 += e1 * c2
                w2 += e2 * c2
                w3 += e3 * c2
            _fill(lanes[0], u0, u1, u2, u3)
            _fill(lanes[1], v0, v1, v2, v3)
            _fill(lanes[2], w0, w1, w2, w3)
            for lane in range(4):
                at = 4 * block + lane
                a, y = fj[at] * eij[p, at], yj[at]
                u, v, w = lanes[0, lane] * a, lanes[1, lane] * a, lanes[2, lane] * a
                lanes[0, lane], lanes[1, lane], lanes[2, lane] = u, v, w
                lanes[3, lane], lanes[4, lane], lanes[5, lane] = v * y, u * y, u * y * y
            r0 += _pairwise(lanes[0])
            rk += _pairwise(lanes[1])
            rkk += _pairwise(lanes[2])
            rjk += _pairwise(lanes[3])
            r1 += _pairwise(lanes[4])
            r2 += _pairwise(lanes[5])
        f = fi[p]
        s[0] += f * r0
        s[1] += f * x * r0
        s[2] += f * r1
        s[3] += f * rk
        s[4] += f * x * x * r0
        s[5] += f * x * r1
        s[6] += f * x * rk
        s[7] += f * r2
        s[8] += f * rjk
        s[9] += f * rkk
    total = s[0]
    if not 1e-250 < total < np.inf:
        return np.nan
    mi, mj, mk = s[1] / total, s[2] / total, s[3] / total
    mean[i], mean[j], mean[k] = centre[i] + mi, centre[j] + mj, centre[k] + mk
    cov[i, i], cov[j, j] = s[4] / total - mi * mi, s[7] / total - mj * mj
    cov[k, k] = s[9] / total - mk * mk
    cov[i, j] = cov[j, i] = s[5] / total - mi * mj
    cov[i, k] = cov[k, i] = s[6] / total - mi * mk
    cov[j, k] = cov[k, j] = s[8] / total - mj * mk
    if frees > 0:
        _extend(C, free, mean, cov)
    log_scale = -0.5 * (3 - frees) * _LOG_2PI - 0.5 * math.log(determinant)
    return log_scale - 0.5 * distance + constant + math.log(total)


@kernel
def _fill(x, a, b, c, d):
    """x = (a, b, c, d)."""
    x[0], x[1], x[2], x[3] = a, b, c, d


@kernel
def _pairwise(x) -> float:
    """Sum of four numbers."""
    return (x[0] + x[1]) + (x[2] + x[3])


@kernel(error_model="numpy")
def _inverse(C, out) -> float:
    """Inverse of a correlation matrix (3, 3), by conditioning; returns its determinant."""
    b1, b2 = C[0, 1], C[0, 2]
    v1 = remaining(1.0, b1, 1.0)
    slope = (C[1, 2] - b1 * b2) / v1
    v2 = remaining(remaining(1.0, b2, 1.0), C[1, 2] - b1 * b2, v1)
    t = b2 - slope * b1
    out[2, 2] = 1.0 / v2
    out[1, 2] = out[2, 1] = -slope / v2
    out[0, 2] = out[2, 0] = -t / v2
    out[1, 1] = 1.0 / v1 + slope * slope / v2
    out[0, 1] = out[1, 0] = -b1 / v1 + slope * t / v2
    out[0, 0] = 1.0 + b1 * b1 / v1 + t * t / v2
    return v1 * v2


@kernel(error_model="numpy")
def _marginal_inverse(C, free, out) -> float:
    """Inverse of C on the axes that are not free, zero elsewhere; returns the determinant."""
    out[:] = 0.0
    determinant = 1.0
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        if not free[a]:
            out[a, a] = 1.0
        if free[a] and not free[b] and not free[c]:
            determinant = remaining(1.0, C[b, c], 1.0)
            out[b, b] = out[c, c] = 1.0 / determinant
            out[b, c] = out[c, b] = -C[b, c] / determinant
            return determinant
    return determinant


@kernel(error_model="numpy")
def _windows(C, information, low, high, mode, distance, centre, half, steep, free):
    """Window of integration of each axis: centre and half length; whether the axis is free.

    Half the squared distance of the best point with x_a fixed is convex, with at least the
    marginal's curvature, so beyond the mode it rises at least by slope t + t^2 / 2. Where the
    density matters, x_a also lies near its regression on any other axis.

    Args:
        C: (3, 3), correlation matrix.
        information: (3, 3), its inverse.
        low: (3,), the box's lower bounds.
        high: (3,), its upper bounds.
        mode: (3,), the point of the box nearest to zero.
        distance: its squared Mahalanobis distance.
        centre: (3,), filled with the windows' centres.
        half: (3,), filled with their half lengths.
        steep: (3,), filled with the slope of the log density at a mode on a bound, else 0.
        free: (3,) bool, filled.
    """
    left, right = np.empty(3), np.empty(3)
    for a in range(3):
        row = information[a]
        slope = row[0] * mode[0] + row[1] * mode[1] + row[2] * mode[2]
        up = slope if mode[a] <= low[a] else 0.0
        down = -slope if mode[a] >= high[a] else 0.0
        up, down = max(up, 0.0), max(down, 0.0)
        steep[a] = max(up, down)
        left[a] = mode[a] - 2.0 * _DEPTH / (down + math.sqrt(down * down + 2.0 * _DEPTH))
        right[a] = mode[a] + 2.0 * _DEPTH / (up + math.sqrt(up * up + 2.0 * _DEPTH))
        free[a] = False
    level = math.sqrt(distance + 2.0 * _DEPTH)
    for a in range(3):
        for b in range(3):
            if a != b:
                c = C[a, b]
                reach = level * math.sqrt(remaining(1.0, c, 1.0))
                from_b, to_b = max(left[b], low[b]), min(right[b], high[b])
                left[a] = max(left[a], min(c * from_b, c * to_b) - reach)
                right[a] = min(right[a], max(c * from_b, c * to_b) + reach)
    for a in range(3):
        free[a] = low[a] < left[a] and right[a] < high[a]
        left[a], right[a] = max(left[a], low[a]), min(right[a], high[a])
        centre[a] = 0.5 * (left[a] + right[a])
        half[a] = 0.5 * (right[a] - left[a])
        if free[a]:
            half[a] = 0.0


@kernel(error_model="numpy")
def _axis(count, pieces, half, free, g, d, y, f):
    """Nodes of one axis, and their weights times exp(-g y - d y^2 / 2); a free axis has one node at
    zero.

    Args:
        count: number of nodes.
        pieces: of equal length that the window is divided into.
        half: half the window's length.
        free: whether the axis is free of its bounds.
        g: slope of half the squared distance at the centre.
        d: its second derivative.
        y: (count or more,), filled with the nodes about the centre.
        f: (count or more,), filled with their weights.
    """
    if free:
        y[0], f[0] = 0.0, 1.0
        return
    each = count // pieces
    pairs = each // 2
    table = pairs * (pairs - 1)
    step = 2.0 * half / pieces
    for piece in range(pieces):
        for n in range(each):
            y[piece * each + n] = -half + step * (piece + NODES[table + n])
            f[piece * each + n] = step * WEIGHTS[table + n]
    # Exactly symmetric, as the tables require.
    for n in range(count // 2):
        y[count - 1 - n] = -y[n]
    for n in range(count):
        f[n] *= math.exp(-y[n] * (g + 0.5 * d * y[n]))


@kernel(error_model="numpy")
def _pair(x, nx, y, ny, coupling, out):
    """exp(-coupling x_p y_q) in blocks along x, one exponential for four entries.

    Args:
        x: (nx or more,), symmetric nodes of one axis.
        nx: their number, even where coupled.
        y: (ny or more,), symmetric nodes of the other axis.
        ny: their number, even where coupled.
        coupling: element of the information matrix that couples the two axes.
        out: (blocks, ny or more, n), filled at [p // n, q, p % n].
    """
    n = out.shape[2]
    if coupling == 0.0:
        for p in range(nx):
            for q in range(ny):
                out[p // n, q, p % n] = 1.0
        return
    for p in range(nx // 2):
        c = -coupling * x[p]
        o = nx - 1 - p
        for q in range(ny // 2):
            e = math.exp(c * y[q])
            r = 1.0 / e
            out[p // n, q, p % n] = out[o // n, ny - 1 - q, o % n] = e
            out[o // n, q, o % n] = out[p // n, ny - 1 - q, p % n] = r


@kernel(error_model="numpy")
def _ridge(x, nx, dx, y, ny, dy, coupling, shift, out, first, last):
    """Density table of a strongly coupled pair, filled only where it is not negligible.

    Args:
        x: (nx,), symmetric nodes of one axis.
        nx: their number.
        dx: element of the information matrix of the axis of x.
        y: (ny,), symmetric nodes of the other axis.
        ny: their number.
        dy: element of the information matrix of the axis of y.
        coupling: element that couples the two.
        shift: length by which the window along y is widened on both sides.
        out: (blocks, ny, 4), filled with the densities in the layout of `_pair`.
        first: (blocks,), filled with the first column of each block that is not zero.
        last: (blocks,), filled with the end of those columns.
    """
    deviation = 1.0 / math.sqrt(dy)
    for p in range((nx + 1) // 2):
        o = nx - 1 - p
        middle = -coupling * x[p] / dy
        rest = 0.5 * (dx - coupling * coupling / dy) * x[p] * x[p]
        reach = deviation * math.sqrt(2.0 * _DEPTH) + shift
        for q in range(ny):
            off = y[q] - middle
            if abs(off) < reach:
                e = math.exp(-0.5 * dy * off * off - rest)
                out[p // 4, q, p % 4] = e
                out[o // 4, ny - 1 - q, o % 4] = e
    for block in range(out.shape[0]):
        first[block] = last[block] = ny
        for q in range(ny):
            if out[block, q, 0] + out[block, q, 1] + out[block, q, 2] + out[block, q, 3] > 0.0:
                first[block], last[block] = min(first[block], q), q + 1


@kernel(error_model="numpy")
def _extend(C, free, mean, cov):
    """Moments of the free axes from those of the others, by regression."""
    for a in range(3):
        if not free[a]:
            continue
        b, c = (a + 1) % 3, (a + 2) % 3
        if free[b] or free[c]:
            o = 3 - a - b if free[b] else 3 - a - c
            slope = C[a, o]
            mean[a] = slope * mean[o]
            cov[a, a] = remaining(1.0, slope, 1.0) + slope * slope * cov[o, o]
            cov[a, o] = cov[o, a] = slope * cov[o, o]
            other = b if free[b] else c
            cov[a, other] = cov[other, a] = C[a, other] - slope * C[o, other] * (1.0 - cov[o, o])
        else:
            rho = C[b, c]
            v = remaining(1.0, rho, 1.0)
            sb, sc = (C[a, b] - rho * C[a, c]) / v, (C[a, c] - rho * C[a, b]) / v
            mean[a] = sb * mean[b] + sc * mean[c]
            ab = sb * cov[b, b] + sc * cov[c, b]
            ac = sb * cov[b, c] + sc * cov[c, c]
            given = remaining(1.0, C[a, b], 1.0)
            given = remaining(given, C[a, c] - rho * C[a, b], v)
            cov[a, b] = cov[b, a] = ab
            cov[a, c] = cov[c, a] = ac
            cov[a, a] = given + sb * ab + sc * ac
