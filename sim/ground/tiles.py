"""The ground as MuJoCo geoms: tiles that touch but never overlap, each of one friction.

Overlapping geoms would give two contacts, so strips are divided along the edges of patches and of
the strips that cover them.
"""

from collections.abc import Sequence
from itertools import pairwise

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.ground.terrain import Extent, Facet, Ground, Layer, rectangles_overlap

THICKNESS = 0.5  # m, of a tile below the walking surface
# MuJoCo takes contact parameters from the geom of higher priority: here, from the ground.
PRIORITY = 3
SOLREF = (0.004, 1.0)
SOLIMP = (0.98, 0.995, 0.0005, 0.5, 2.0)
TORSION, ROLLING = 0.005, 0.0001  # m
ANYTHING = 2**31 - 1  # contact bits: whatever can touch at all touches the ground
GREY, ICY = (0.5, 0.5, 0.48, 1), (0.55, 0.75, 0.9, 1)


def add_ground(spec: mujoco.MjSpec, ground: Ground) -> None:
    """Add the ground to `spec`. Raises SurefootError if a strip or a height field covers a part of
    a rough strip or of another height field.
    """
    layers = ground.layers
    for k, layer in enumerate(layers):
        hidden = [later.rectangle for later in layers[k + 1 :]]
        if layer.on_grid and any(rectangles_overlap(layer.rectangle, other) for other in hidden):
            raise SurefootError(
                "a strip must not overlap a rough one listed before it, "
                "nor a height field another or a rough strip"
            )
        mu = ground.mu if layer.mu is None else layer.mu
        patches = [(patch.rectangle, patch.mu) for patch in ground.patches]
        for facet in layer.facets():
            for tile, tile_mu in _cut(layer, facet[0], mu, hidden, patches):
                # Set every attribute that the robot's default for geoms could change.
                geom = {
                    "contype": ANYTHING,
                    "conaffinity": ANYTHING,
                    "margin": 0.0,
                    "gap": 0.0,
                    "friction": [tile_mu, TORSION, ROLLING],
                    "condim": 3,
                    "priority": PRIORITY,
                    "solref": [SOLREF[0] + ground.softness, SOLREF[1]],
                    "solimp": list(SOLIMP),
                    "rgba": list(ICY if tile_mu < ground.mu else GREY),
                }
                if layer.on_grid:
                    _add_field(spec, layer, tile, geom)
                else:
                    _add_box(spec, facet, layer.axis, tile, geom)


def _add_box(spec: mujoco.MjSpec, facet: Facet, axis: int, tile: Extent, geom: dict) -> None:
    """Add a box whose upper face is one tile of a facet.

    The box of a slope is tilted, so its upper end must overlap a neighbour of the same
    height.

    Args:
        spec: of the world, edited.
        facet: of a layer.
        axis: along which it rises: 0 for x, 1 for y.
        tile: part of its rectangle.
        geom: further attributes of the geom.
    """
    rectangle, z_low, z_high = facet
    x0, x1, y0, y1 = tile
    low, high = rectangle[2 * axis : 2 * axis + 2]
    slope = (z_high - z_low) / (high - low)
    middle = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)])
    top = np.array([*middle, z_low + slope * (middle[axis] - low)])
    angle = np.arctan(slope)
    half = np.array([0.5 * (x1 - x0), 0.5 * (y1 - y0), 0.5 * THICKNESS])
    half[axis] /= np.cos(angle)
    if slope == 0.0:
        half[2] = 0.5 * (THICKNESS + max(z_low, 0.0))  # steps and platforms stand on the floor
    up = np.array([0.0, 0.0, np.cos(angle)])
    up[axis] = -np.sin(angle)
    turn = np.zeros(4)
    about = np.array([0.0, -1.0, 0.0]) if axis == 0 else np.array([1.0, 0.0, 0.0])
    mujoco.mju_axisAngle2Quat(turn, about, angle)
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, pos=top - half[2] * up, size=half, quat=turn, **geom
    )


def _add_field(spec: mujoco.MjSpec, layer: Layer, tile: Extent, geom: dict) -> None:
    """Add the part `tile` of a layer of heights, on the layer's own lattice."""
    x0, x1, y0, y1 = tile
    nodes = layer.nodes()
    left, right, front, back = layer.rectangle
    dx, dy = (right - left) / (nodes.shape[0] - 1), (back - front) / (nodes.shape[1] - 1)
    i0, i1 = round((x0 - left) / dx), round((x1 - left) / dx)
    j0, j1 = round((y0 - front) / dy), round((y1 - front) / dy)
    nodes = nodes[i0 : i1 + 1, j0 : j1 + 1]
    low, high = nodes.min(), nodes.max()
    name = f"field_{len(spec.hfields)}"
    spec.add_hfield(
        name=name,
        nrow=nodes.shape[1],
        ncol=nodes.shape[0],
        size=[0.5 * (x1 - x0), 0.5 * (y1 - y0), max(high - low, 1e-3), THICKNESS],
        userdata=((nodes.T - low) / max(high - low, 1e-3)).ravel(),
    )
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=name,
        pos=[0.5 * (x0 + x1), 0.5 * (y0 + y1), low],
        **geom,
    )


def _cut(
    layer: Layer,
    rectangle: Extent,
    mu: float,
    hidden: Sequence[Extent],
    patches: Sequence[tuple[Extent, float]],
) -> list[tuple[Extent, float]]:
    """Divide the visible part of a layer's rectangle into adjacent tiles, each with its friction.

    Args:
        layer: along whose lattice it is divided, if it has one.
        rectangle: (x0, x1, y0, y1) in G [m].
        mu: friction outside the patches.
        hidden: rectangles covered by others.
        patches: rectangles with their own friction; the last one counts.
    """
    hidden = [r for r in hidden if rectangles_overlap(rectangle, r)]
    patches = [(r, m) for r, m in patches if rectangles_overlap(rectangle, r)]
    edges_x, edges_y = (
        _edges(layer, [*hidden, *(r for r, _ in patches)], rectangle, axis) for axis in (0, 1)
    )
    tiles: list[tuple[Extent, float]] = []
    for x0, x1 in pairwise(edges_x):
        column: list[list[float]] = []  # y0, y1, mu, merged where alike
        for y0, y1 in pairwise(edges_y):
            x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
            if any(_inside(x, y, r) for r in hidden):
                continue
            mu_here = next((m for r, m in reversed(patches) if _inside(x, y, r)), mu)
            if column and column[-1][1:] == [y0, mu_here]:
                column[-1][1] = y1
            else:
                column.append([y0, y1, mu_here])
        tiles += [((x0, x1, y0, y1), m) for y0, y1, m in column]
    return tiles


def _edges(layer: Layer, rectangles: Sequence[Extent], within: Extent, axis: int) -> list[float]:
    low, high = within[2 * axis], within[2 * axis + 1]
    edges = {e for r in rectangles for e in r[2 * axis : 2 * axis + 2] if low < e < high}
    if layer.on_grid:
        edges = {layer.on_lattice(e, axis) for e in edges}
    inner = [e for e in sorted(edges) if low + 1e-9 < e < high - 1e-9]
    return [low, *inner, high]


def _inside(x: float, y: float, r: Extent) -> bool:
    return r[0] <= x <= r[1] and r[2] <= y <= r[3]
