"""The ground at many points."""

import numpy as np

from surefoot.sim.ground.height_map import HeightMap, height, normal


def surfaces(height_map: HeightMap, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights (N,) [m] and unit normals (N, 3) at the points x, y (N,) [m]."""
    points = [(float(a), float(b)) for a, b in zip(x, y, strict=True)]
    heights = np.array([height(height_map, *point) for point in points])
    return heights, np.array([normal(height_map, *point) for point in points])
