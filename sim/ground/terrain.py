"""The ground: a floor, strips along the world's axes (level, sloping, stepped or rough), and height
fields.

Where strips overlap, the last one counts. Friction patches change the friction of the surface on
top. `sim.ground.height_map` computes heights and normals from this description, `sim.ground.tiles`
the geoms for MuJoCo.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, ClassVar, TypeVar

import msgspec
import numpy as np
from scipy.ndimage import gaussian_filter

from surefoot.sim.common.errors import SurefootError, check_within
from surefoot.sim.common.limits import check_limit
from surefoot.sim.ground.height_map import LATTICE, HeightMap

HIGHEST_STRIP, ROUGHEST = 1e3, 1.0
"""Largest height of a strip's ends, and of its bumps, beyond any leg's reach [m]."""
FINEST_SPACING = 0.002
"""Least spacing of a height field's points [m]: a foot of 2 cm covers hundreds of its cells."""
COARSEST = 100.0
"""Largest grain [m]: bumps of a hundred metres are slopes."""
Friction = Annotated[float, msgspec.Meta(ge=0.01, le=3.0)]
Length = Annotated[float, msgspec.Meta(gt=0.0, le=1e5)]
Extent = tuple[float, float, float, float]  # x0, x1, y0, y1 [m]
Facet = tuple[Extent, float, float]  # and the heights [m] of its lower and upper end along the axis


def rectangles_overlap(a: Extent, b: Extent) -> bool:
    """Whether two rectangles have more than edges in common."""
    return a[0] < b[1] and b[0] < a[1] and a[2] < b[3] and b[2] < a[3]


@dataclass(frozen=True)
class Patch:
    """A rectangle along the world's axes with its own friction."""

    center_x: float  # m
    center_y: float  # m
    size_x: float  # m, full length
    size_y: float  # m, full width
    mu: float

    @property
    def rectangle(self) -> Extent:
        x, y, w, h = self.center_x, self.center_y, 0.5 * self.size_x, 0.5 * self.size_y
        return x - w, x + w, y - h, y + h

    def snapped(self, layer: "Layer") -> "Patch":
        """The patch with its edges moved to the lattice of a layer of heights."""
        x0, x1, y0, y1 = (layer.on_lattice(e, k // 2) for k, e in enumerate(self.rectangle))
        return Patch(0.5 * (x0 + x1), 0.5 * (y0 + y1), x1 - x0, y1 - y0, self.mu)


@dataclass(frozen=True)
class Strip:
    """Ground from the middle of one edge of a rectangle to the middle of the opposite one, along x
    or y.

    Its surface is a plane from the first height to the second, or has `steps` equal risers; the
    tread at the upper end has the upper height. With `rough` > 0, the plane has bumps of up to that
    height, drawn by the seed (`roughened`). `mu` is None for the floor's. Raises SurefootError for
    an impossible strip.
    """

    start: tuple[float, float]  # m
    end: tuple[float, float]  # m
    width: float  # m
    heights: tuple[float, float] = (0.0, 0.0)  # m, at start and end
    steps: int = 0  # risers from one height to the other; none: a plane
    rough: float = 0.0  # m, height of the highest bump
    grain: float = 0.4  # m, distance between bumps
    mu: float | None = None  # friction coefficient, the floor's where left out
    bumps: np.ndarray | None = field(default=None, compare=False, repr=False)  # (nx, ny) m

    def __post_init__(self):
        (x0, y0), (x1, y1) = self.start, self.end
        if (x0 == x1) == (y0 == y1):
            raise SurefootError("start and end must differ along x or along y, not both")
        if self.width <= 0:
            raise SurefootError(f"width must be positive, is {self.width}")
        if self.steps < 0 or self.steps != round(self.steps):
            raise SurefootError(f"steps must be a whole number, is {self.steps}")
        (x0, x1, y0, y1), bumpy = self.rectangle, float(self.rough > 0)
        points = bumpy * (abs(x1 - x0) / LATTICE + 1) * (abs(y1 - y0) / LATTICE + 1)
        check_limit("cells", points, "points of a rough strip")
        check_limit("bodies", self.steps, "steps")
        if max(map(abs, self.heights)) > HIGHEST_STRIP:
            raise SurefootError(f"heights must not exceed {HIGHEST_STRIP:g} m")
        grains = 2 * LATTICE, COARSEST
        check_within({"rough": self.rough, "grain": self.grain}, {"grain": grains}, ROUGHEST)
        if self.steps and self.rough:
            raise SurefootError("a strip cannot have both steps and rough")
        if self.rough and any(abs(e / LATTICE - round(e / LATTICE)) > 1e-6 for e in self.rectangle):
            raise SurefootError(f"a rough strip's edges must lie on multiples of {LATTICE} m")

    @property
    def axis(self) -> int:
        """0 if the strip runs along x, 1 along y."""
        return int(self.start[0] == self.end[0])

    @property
    def rectangle(self) -> Extent:
        lower = np.minimum(self.start, self.end)
        upper = np.maximum(self.start, self.end)
        lower[1 - self.axis] -= 0.5 * self.width
        upper[1 - self.axis] += 0.5 * self.width
        return float(lower[0]), float(upper[0]), float(lower[1]), float(upper[1])

    def facets(self) -> Iterator[Facet]:
        """Its rectangles, each with the heights of its lower and upper end along the axis."""
        x0, x1, y0, y1 = self.rectangle
        low, high = (x0, x1) if self.axis == 0 else (y0, y1)
        z_low, z_high = self.ends
        cuts = np.linspace(low, high, max(self.steps, 1) + 1)
        for k in range(len(cuts) - 1):
            a, b = float(cuts[k]), float(cuts[k + 1])
            if self.steps:
                # Counted from the lower end: the first tread is one riser up.
                risen = k + 1 if z_high > z_low else k
                z_a = z_b = z_low + (z_high - z_low) * risen / self.steps
            else:
                z_a, z_b = z_low, z_high
            yield ((a, b, y0, y1) if self.axis == 0 else (x0, x1, a, b)), z_a, z_b

    @property
    def ends(self) -> tuple[float, float]:
        """Heights [m] at the ends with the smaller and the larger coordinate."""
        first, last = self.heights
        forward = self.start[self.axis] < self.end[self.axis]
        return (first, last) if forward else (last, first)

    def roughened(self, rng: np.random.Generator) -> "Strip":
        """The strip with bumps drawn from `rng`, which vanish at its edges."""
        if not self.rough:
            return self
        x0, x1, y0, y1 = self.rectangle
        nx, ny = round((x1 - x0) / LATTICE) + 1, round((y1 - y0) / LATTICE) + 1
        noise = gaussian_filter(rng.normal(size=(nx, ny)), 0.5 * self.grain / LATTICE)
        bumps = np.clip(0.5 + noise / (4.0 * noise.std()), 0.0, 1.0)
        fade = max(2, round(self.grain / LATTICE))
        for axis, n in enumerate((nx, ny)):
            edge = np.minimum(np.arange(n), np.arange(n)[::-1]) / fade
            bumps *= np.clip(edge, 0.0, 1.0).reshape((-1, 1) if axis == 0 else (1, -1))
        return replace(self, bumps=self.rough * bumps)

    def nodes(self) -> np.ndarray:
        """Heights (nx, ny) [m] on a rough strip's lattice: plane plus bumps."""
        if self.bumps is None:
            raise SurefootError("a rough strip has no bumps yet: draw them with roughened(rng)")
        u = np.linspace(0.0, 1.0, self.bumps.shape[self.axis])
        plane = self.ends[0] + (self.ends[1] - self.ends[0]) * u
        return self.bumps + (plane[:, None] if self.axis == 0 else plane[None, :])

    @property
    def on_grid(self) -> bool:
        """Whether its heights are given by `nodes`."""
        return self.rough > 0.0

    def on_lattice(self, edge: float, _axis: int) -> float:
        """The nearest line of the lattice that all rough strips share [m]."""
        return round(edge / LATTICE) * LATTICE


@dataclass(frozen=True)
class HeightField:
    """Ground given by heights at equally spaced points of a rectangle, including its edges. Each
    cell is two triangles, as in MuJoCo's height fields.

    Fields with the same digest are equal. Raises SurefootError for an impossible field.
    """

    rectangle: Extent
    heights: np.ndarray = field(compare=False, repr=False)  # (nx, ny) m, x and y rising
    mu: float | None = None  # friction coefficient, the floor's where left out
    digest: str = field(init=False)  # SHA-256 of the heights
    on_grid: ClassVar[bool] = True
    axis: ClassVar[int] = 0  # along which its one facet lies

    def __post_init__(self):
        heights = np.ascontiguousarray(self.heights, dtype=float)
        check_limit("cells", heights.size, "points of a height field")
        if heights.ndim != 2 or min(heights.shape) < 2:
            shape = " x ".join(map(str, heights.shape))
            raise SurefootError(f"a height field has 2 x 2 points at least, this one {shape}")
        if not np.isfinite(heights).all():
            raise SurefootError("a height is not a finite number")
        if np.abs(heights).max() > HIGHEST_STRIP:
            raise SurefootError(f"heights must not exceed {HIGHEST_STRIP:g} m")
        object.__setattr__(self, "heights", heights)
        if min(self.spacing) < FINEST_SPACING:
            raise SurefootError(f"points of a height field lie {FINEST_SPACING:g} m apart at least")
        object.__setattr__(self, "digest", hashlib.sha256(heights.tobytes()).hexdigest())

    @property
    def spacing(self) -> tuple[float, float]:
        """Spacing of its points along x and y [m]."""
        (x0, x1, y0, y1), (nx, ny) = self.rectangle, self.heights.shape
        return (x1 - x0) / (nx - 1), (y1 - y0) / (ny - 1)

    def facets(self) -> Iterator[Facet]:
        """Its only rectangle; the heights are those of `nodes`."""
        yield self.rectangle, 0.0, 0.0

    def nodes(self) -> np.ndarray:
        """Heights (nx, ny) [m]."""
        return self.heights

    def on_lattice(self, edge: float, axis: int) -> float:
        """The nearest line [m] along which the field can be divided, also outside its edges."""
        low, step = self.rectangle[2 * axis], self.spacing[axis]
        return low + round((edge - low) / step) * step


Layer = Strip | HeightField
Part = TypeVar("Part", Patch, Strip, HeightField)


@dataclass(frozen=True)
class Ground:
    """A floor of friction `mu` at height zero, with strips on it, height fields on these, and
    patches of other friction.
    """

    mu: float
    patches: tuple[Patch, ...] = ()
    half_size: float = 100.0  # m, of the floor
    strips: tuple[Strip, ...] = ()
    softness: float = 0.0  # s, what contacts take longer to push back than on hard ground
    fields: tuple[HeightField, ...] = ()

    def friction(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Coefficient of sliding friction at the points x, y [m]."""
        mu = np.full(np.shape(x), self.mu)
        for part in (*self.strips, *self.fields, *self.patches):
            x0, x1, y0, y1 = part.rectangle
            inside = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
            mu[inside] = self.mu if part.mu is None else part.mu
        return mu

    def with_friction(self, factor: float) -> "Ground":
        """The ground with this factor on every coefficient of friction."""

        def changed(parts: tuple[Part, ...]) -> tuple[Part, ...]:
            return tuple(p if p.mu is None else replace(p, mu=p.mu * factor) for p in parts)

        return replace(
            self,
            mu=self.mu * factor,
            patches=changed(self.patches),
            strips=changed(self.strips),
            fields=changed(self.fields),
        )

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The floor, the strips and the height fields, from the bottom up."""
        h = self.half_size
        return (Strip((-h, 0.0), (h, 0.0), 2 * h), *self.strips, *self.fields)

    @cached_property
    def height_map(self) -> HeightMap:
        """Heights and normals of this ground, for compiled code."""
        rows, nodes, used = [], [], 0
        for layer in self.layers:
            shape, offset = (0, 0), -1
            if layer.on_grid:
                heights = layer.nodes()
                shape, offset = heights.shape, used
                nodes.append(heights.ravel())
                used += heights.size
            plane = (*layer.ends, layer.steps) if isinstance(layer, Strip) else (0.0, 0.0, 0)
            rows.append([*layer.rectangle, layer.axis, *plane, offset, *shape])
        return HeightMap(np.array(rows, dtype=float), np.concatenate([*nodes, np.zeros(1)]))
