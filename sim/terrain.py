"""Flat ground with rectangles of other friction, laid as abutting coplanar tiles."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

THICKNESS = 0.5  # m, of a tile below the walking surface
# The ground decides how a foot touches it: MuJoCo takes these from the geom of higher priority.
PRIORITY = 3
SOLREF = (0.004, 1.0)
SOLIMP = (0.98, 0.995, 0.0005, 0.5, 2.0)
TORSION, ROLLING = 0.005, 0.0001  # m


@dataclass(frozen=True)
class Patch:
    """A rectangle along the world's axes with its own friction."""

    center_x: float  # m
    center_y: float  # m
    size_x: float  # m, full length
    size_y: float  # m, full width
    mu: float

    def contains(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Which of the points x, y [m] lie on the patch."""
        return (np.abs(x - self.center_x) <= 0.5 * self.size_x) & (
            np.abs(y - self.center_y) <= 0.5 * self.size_y
        )


@dataclass(frozen=True)
class Ground:
    """Level ground of friction `mu` with patches on it; where patches overlap the last one counts."""

    mu: float
    patches: tuple[Patch, ...] = ()
    half_size: float = 100.0  # m

    def friction(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Coefficient of sliding friction at the points x, y [m]."""
        mu = np.full(np.shape(x), self.mu)
        for patch in self.patches:
            mu[patch.contains(x, y)] = patch.mu
        return mu


def add_ground(spec: mujoco.MjSpec, ground: Ground) -> None:
    """Lay the ground into `spec`. Tiles abut: a patch over a plane would be two contacts."""
    edges_x = _edges([(p.center_x, p.size_x) for p in ground.patches], ground.half_size)
    edges_y = _edges([(p.center_y, p.size_y) for p in ground.patches], ground.half_size)
    for x0, x1 in zip(edges_x[:-1], edges_x[1:], strict=True):
        column: list[list[float]] = []  # y0, y1, mu of the tiles in this strip, merged where alike
        for y0, y1 in zip(edges_y[:-1], edges_y[1:], strict=True):
            mu = float(ground.friction(np.array([x0 + x1]) / 2, np.array([y0 + y1]) / 2)[0])
            if column and column[-1][2] == mu:
                column[-1][1] = y1
            else:
                column.append([y0, y1, mu])
        for y0, y1, mu in column:
            _tile(spec, x0, x1, y0, y1, mu, slippery=mu < ground.mu)


def _edges(spans: Sequence[tuple[float, float]], half_size: float) -> list[float]:
    edges = {-half_size, half_size}
    for center, size in spans:
        edges |= {center - size / 2, center + size / 2}
    return sorted(edge for edge in edges if abs(edge) <= half_size)


def _tile(
    spec: mujoco.MjSpec, x0: float, x1: float, y0: float, y1: float, mu: float, slippery: bool
) -> None:
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[(x0 + x1) / 2, (y0 + y1) / 2, -THICKNESS / 2],
        size=[(x1 - x0) / 2, (y1 - y0) / 2, THICKNESS / 2],
        friction=[mu, TORSION, ROLLING],
        condim=3,
        priority=PRIORITY,
        solref=list(SOLREF),
        solimp=list(SOLIMP),
        rgba=[0.55, 0.75, 0.9, 1] if slippery else [0.5, 0.5, 0.48, 1],
    )
