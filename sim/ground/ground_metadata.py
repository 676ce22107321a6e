"""Ground in the metadata of a log, so that it can be drawn without its files.

It is the ground as drawn by the seed, with rough strips as height fields. Heights are stored in
16 bits of their range, and thinned out where there are many.
"""

import base64
import json
import zlib
from dataclasses import asdict, astuple, dataclass, replace
from math import ceil, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import map_coordinates

from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.common.limits import check_limit
from surefoot.sim.common.toml import typed
from surefoot.sim.ground.terrain import Extent, Ground, HeightField, Patch, Strip

if TYPE_CHECKING:
    from surefoot.sim.log import Log

GROUND_KEY = "ground"
MOST_POINTS = 2**18
"""Largest number of height field points for drawing: half a megabyte of metadata, and a mesh that
can be rotated smoothly.
"""
_LEVELS = 2**16 - 1
_OF_STRIPS = ("start", "end", "width", "heights", "steps", "mu")


@dataclass(frozen=True)
class _Field:
    rectangle: Extent
    shape: tuple[int, int]
    range: tuple[float, float]
    levels: str
    mu: float | None = None


@dataclass(frozen=True)
class _Kept:
    mu: float
    half_size: float
    patches: tuple[tuple[float, float, float, float, float], ...] = ()
    strips: tuple[Strip, ...] = ()
    fields: tuple[_Field, ...] = ()

    def __post_init__(self):
        if any(strip.rough for strip in self.strips):
            raise SurefootError("strips: a rough one is a field")


def ground_metadata(ground: Ground) -> dict[str, Any]:
    """Entries of `Meta.model` for a ground."""
    rough = [HeightField(s.rectangle, s.nodes(), s.mu) for s in ground.strips if s.rough]
    drawn = thinned(replace(ground, fields=(*rough, *ground.fields)))
    patches = tuple(astuple(patch) for patch in ground.patches)
    kept = _Kept(ground.mu, ground.half_size, patches, fields=tuple(map(_written, drawn.fields)))
    strips = [
        {name: getattr(strip, name) for name in _OF_STRIPS}
        for strip in ground.strips
        if not strip.rough
    ]
    # Plain numbers and lists, as they come back from a file.
    return {GROUND_KEY: json.loads(json.dumps(asdict(kept) | {"strips": strips}))}


def ground_of_log(log: "Log") -> Ground | None:
    """The ground in a log's metadata, for drawing; None if there is none.

    Raises SurefootError if it cannot be read.
    """
    if GROUND_KEY not in log.meta.model:
        return None
    with errors_in(f"{log.name}: metadata"):
        kept = typed({GROUND_KEY: log.meta.model[GROUND_KEY]}, dict[str, _Kept])[GROUND_KEY]
        return Ground(
            kept.mu,
            tuple(Patch(*numbers) for numbers in kept.patches),
            kept.half_size,
            kept.strips,
            fields=tuple(_read(field) for field in kept.fields),
        )


def thinned(ground: Ground) -> Ground:
    """The ground with its height fields reduced to about MOST_POINTS in total, for drawing."""
    points = sum(field.heights.size for field in ground.fields)
    if points <= MOST_POINTS:
        return ground
    every = ceil(sqrt(points / MOST_POINTS))
    return replace(ground, fields=tuple(_thinned(field, every) for field in ground.fields))


def _thinned(field: HeightField, every: int) -> HeightField:
    nx, ny = field.heights.shape
    x, y = (np.linspace(0.0, n - 1, max(2, ceil(n / every))) for n in (nx, ny))
    at = np.meshgrid(x, y, indexing="ij")
    return replace(field, heights=map_coordinates(field.heights, at, order=1))


def _written(field: HeightField) -> _Field:
    low, high = float(field.heights.min()), float(field.heights.max())
    levels = np.round((field.heights - low) / max(high - low, 1e-300) * _LEVELS).astype("<u2")
    text = base64.b64encode(zlib.compress(levels.tobytes())).decode()
    return _Field(field.rectangle, (len(levels), levels.shape[1]), (low, high), text, field.mu)


def _read(field: _Field) -> HeightField:
    nx, ny = field.shape
    if min(nx, ny) < 2:
        raise SurefootError(f"[{GROUND_KEY}] shape {nx} x {ny}: 2 x 2 at least")
    check_limit("cells", nx * ny, f"[{GROUND_KEY}] points of a height field")
    try:
        packed = base64.b64decode(field.levels, validate=True)
        numbers = zlib.decompressobj().decompress(packed, 2 * nx * ny + 1)
        levels = np.frombuffer(numbers, "<u2").reshape(nx, ny)
    except (ValueError, zlib.error) as error:
        raise SurefootError(f"[{GROUND_KEY}] levels: damaged ({error})") from None
    low, high = field.range
    return HeightField(field.rectangle, low + (high - low) / _LEVELS * levels, field.mu)
