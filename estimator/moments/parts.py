"""Subdivision of the outermost axis of a box where the integrand's curvature increases.

Over axis 0 the integrand is a standard normal density times the probability that axes 1 and 2 lie
in their intervals. That probability falls where a conditional mean leaves an interval: of axis j
alone, or of axis j with axis k fixed at a bound. Each such event is a half line, a zone, that
begins `reach` deviations before the crossing; inside it, the curvature of the logarithm is larger
by up to (slope/deviation)^2. The interval is split where a relevant zone begins.

With two axes at bounds, a corner, the curvature is larger only while both are past them: the zones
that share the corner must overlap. Once one of them has ended, the log bends as slowly as the
density falls along the edge. Far out that is fast as well, so there the half line is kept.
"""

import math

import numpy as np

from surefoot.estimator.moments.faces import remaining
from surefoot.estimator.moments.line import DEPTH
from surefoot.sim.common.kernels import kernel

_NEAR = 16.0
"""Squared distance up to which a density falls slowly along an edge."""


@kernel
def outer_parts(C, low, high, left: float, right: float, distance, cuts, scales) -> int:
    """Divide [left, right] of axis 0 into parts; returns their number.

    Zone 6 (j - 1) + 2 c + w is axis j past its lower (w = 0) or upper bound, alone (c = 0) or with
    the other axis at its lower (c = 1) or upper bound (c = 2).

    Args:
        C: (3, 3), correlation matrix.
        low: (3,), the box's lower bounds.
        high: (3,), its upper bounds.
        left: lower end of the window of axis 0.
        right: its upper end.
        distance: squared Mahalanobis distance of the box.
        cuts: (16,), receives the ends of the parts.
        scales: (16,), receives the smallest length scale of the integrand inside each part.
    """
    edges, sides, bends = np.zeros(12), np.zeros(12), np.zeros(12)
    _zones(C, low, high, edges, sides, bends)
    cuts[0] = left
    parts = 1
    for z in range(12):
        if bends[z] > 1.0 and left < edges[z] < right:
            at = parts
            while at > 1 and cuts[at - 1] > edges[z]:
                cuts[at] = cuts[at - 1]
                at -= 1
            cuts[at] = edges[z]
            parts += 1
    cuts[parts] = right
    v = remaining(1.0, C[1, 2], 1.0)
    given = remaining(1.0, C[0, 1], 1.0)
    most = 1.0 / remaining(given, C[0, 2] - C[1, 2] * C[0, 1], v)
    for part in range(parts):
        precision = 1.0
        for z in range(12):
            if _covers(z, cuts[part], cuts[part + 1], edges, sides):
                # A corner needs one of its axes past its bound, or both where the density falls
                # slowly.
                condition = (z % 6) // 2
                other = _corner(z) if distance < _NEAR else (6 if z < 6 else 0) + condition - 1
                if condition == 0 or _covers(other, cuts[part], cuts[part + 1], edges, sides):
                    precision += bends[z]
        scales[part] = 1.0 / math.sqrt(min(precision, most))
    return parts


@kernel
def _covers(z: int, start: float, end: float, edges, sides) -> bool:
    """Whether zone z reaches into the part.

    Args:
        z: index of the zone, as of `outer_parts`.
        start: lower end of the part along axis 0.
        end: its upper end.
        edges: (12,), where each zone begins.
        sides: (12,), direction of each zone: +1, -1, or 0 for none.
    """
    if sides[z] == 0.0:
        return False
    return end > edges[z] if sides[z] > 0.0 else start < edges[z]


@kernel
def _corner(z: int) -> int:
    """The zone that shares a corner with z: the other axis past its bound, z's axis at its own."""
    condition, which = (z % 6) // 2 - 1, z % 2
    return (6 if z < 6 else 0) + 2 * (which + 1) + condition


@kernel
def _zones(C, low, high, edges, sides, bends):
    """Start, direction (+1, -1; 0 for none) and curvature of the twelve zones.

    Args:
        C: (3, 3), correlation matrix.
        low: (3,), the box's lower bounds.
        high: (3,), its upper bounds.
        edges: (12,), filled with the start of each zone along axis 0.
        sides: (12,), filled with its direction.
        bends: (12,), filled with its curvature, (slope/deviation)^2.
    """
    reach = math.sqrt(2.0 * DEPTH)
    for j in range(1, 3):
        k = 3 - j
        v = remaining(1.0, C[0, k], 1.0)
        gain = (C[j, k] - C[0, j] * C[0, k]) / v
        alone = remaining(1.0, C[0, j], 1.0)
        rest = remaining(alone, C[j, k] - C[0, j] * C[0, k], v)
        for condition in range(3):
            slope, offset, deviation = C[0, j], 0.0, math.sqrt(alone)
            if condition > 0:
                bound = low[k] if condition == 1 else high[k]
                if not np.isfinite(bound):
                    continue
                slope, offset, deviation = C[0, j] - gain * C[0, k], gain * bound, math.sqrt(rest)
            for which in range(2):
                edge = low[j] if which == 0 else high[j]
                if np.isfinite(edge) and slope != 0.0:
                    z = 6 * (j - 1) + 2 * condition + which
                    side = math.copysign(1.0, slope) * (1.0 if which == 1 else -1.0)
                    edges[z] = (edge - offset) / slope - side * reach * deviation / abs(slope)
                    sides[z] = side
                    bends[z] = (slope / deviation) ** 2
