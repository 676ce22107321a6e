"""The whole course at once, and the ground's heights and normals at many points."""

from collections.abc import Sequence

import numpy as np

from surefoot.sim.gait.course import Course, Segment, integrate_course, stretches
from surefoot.sim.ground.height_map import height, normal


def whole_course(
    segments: Sequence[Segment], dt: float, stand: float, laps: int = 1, lead: float = 0.0
) -> Course:
    """The course in one piece."""
    return integrate_course(stretches(segments, dt, stand, laps, lead), dt)


def surfaces(height_map, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights (N,) [m] and unit normals (N, 3) at the points x, y (N,) [m]."""
    points = list(zip(x, y, strict=True))
    z = np.array([height(height_map, *point) for point in points])
    return z, np.array([normal(height_map, *point) for point in points])
