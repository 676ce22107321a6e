"""Height and normal of the ground at a point, compiled; used by the controller and for logs
alike.
"""

from typing import NamedTuple

import numpy as np

from surefoot.sim.common.kernels import kernel

LATTICE = 0.1  # m, between the nodes of rough ground


class HeightMap(NamedTuple):
    """Strips as arrays; where they overlap, the last one counts.

    A row of `strips`: x0, x1, y0, y1, axis (0: x, 1: y), heights at the lower and upper end of that
    axis, number of steps, offset into `nodes` (-1: smooth), nodes along x, nodes along y.
    """

    strips: np.ndarray  # (M, 11) m
    nodes: np.ndarray  # (K,) m


@kernel
def surface(height_map, x, y):
    """Height [m] and slopes along x and y at the point (x, y) [m]; zeros outside the floor."""
    for k in range(len(height_map.strips) - 1, -1, -1):
        s = height_map.strips[k]
        if s[0] <= x <= s[1] and s[2] <= y <= s[3]:
            if s[8] >= 0.0:
                return _rough(height_map.nodes, s, x, y)
            along_x = s[4] == 0.0
            length = s[1] - s[0] if along_x else s[3] - s[2]
            u = (x - s[0]) / length if along_x else (y - s[2]) / length
            rise, steps = s[6] - s[5], s[7]
            if steps > 0.0:
                tread = min(np.floor(u * steps), steps - 1.0) + (1.0 if rise > 0.0 else 0.0)
                return s[5] + rise * tread / steps, 0.0, 0.0
            slope = rise / length
            return s[5] + rise * u, slope if along_x else 0.0, 0.0 if along_x else slope
    return 0.0, 0.0, 0.0


@kernel
def height(height_map, x, y):
    """Height [m] of the ground at (x, y) [m]."""
    return surface(height_map, x, y)[0]


@kernel
def normal(height_map, x, y):
    """Unit normal of the ground at (x, y) [m], three numbers in G."""
    _, a, b = surface(height_map, x, y)
    scale = 1.0 / np.sqrt(1.0 + a * a + b * b)
    return -a * scale, -b * scale, scale


@kernel
def _rough(nodes, s, x, y):
    """Height and slopes on a lattice whose cells are two triangles each, as in MuJoCo's height
    fields.
    """
    nx, ny = int(s[9]), int(s[10])
    dx, dy = (s[1] - s[0]) / (nx - 1), (s[3] - s[2]) / (ny - 1)
    i = min(int((x - s[0]) / dx), nx - 2)
    j = min(int((y - s[2]) / dy), ny - 2)
    u, v = (x - s[0]) / dx - i, (y - s[2]) / dy - j
    at = int(s[8]) + i * ny + j
    z00, z01, z10, z11 = nodes[at], nodes[at + 1], nodes[at + ny], nodes[at + ny + 1]
    if u >= v:
        a, b = z10 - z00, z11 - z10
    else:
        a, b = z11 - z01, z01 - z00
    return z00 + a * u + b * v, a / dx, b / dy
