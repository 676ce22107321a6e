"""Ground from a user's file: a grid of heights, or a mesh, of which the upper surface is used.

Either becomes a `HeightField`, which is used for collision, by the controller, and for the truth in
the log. MuJoCo collides a mesh as its convex hull, which is unsuitable as ground.
"""

import warnings
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import protect
from surefoot.sim.common.kernels import kernel
from surefoot.sim.common.limits import admitted, check_limit
from surefoot.sim.common.toml import Name
from surefoot.sim.ground.terrain import Extent, Friction, HeightField, Length

MESH_SPACING = 0.05
"""Default spacing of the heights taken from a mesh [m]: the width of a foot."""
_HEAD = 8  # bytes, rows and columns, of MuJoCo's own height fields
_SOLID, _FACET = 84, 50  # bytes, head and triangle of a binary STL


@dataclass(frozen=True)
class GroundFile:
    """Your own ground on floor and strips: a grid of heights, with rows along y and columns along
    x, or a mesh, of which the upper surface counts.
    """

    file: Name  # in the scenario's folder: .png, .npy, .csv or .hf (MuJoCo's), .obj or .stl
    center: tuple[float, float] = (0.0, 0.0)  # m, of a grid; where the origin of a mesh lies
    size: tuple[Length, Length] | None = None  # m, of a grid, along x and y
    heights: tuple[float, float] | None = None
    """m, of a grid's lowest and highest number; by default the numbers are metres. Required for
    a picture.
    """
    spacing: Length | None = None  # m, of the points at which a mesh's height is taken; 0.05
    mu: Friction | None = None  # friction coefficient; the ground's where left out


def ground_from_file(folder: Path, of: GroundFile) -> HeightField:
    """Read the ground from a file in the scenario's folder.

    Raises SurefootError, in one line with the file, if it cannot be read or is outside the folder.
    """
    try:
        path = (folder / of.file).resolve()
        if not path.is_relative_to(folder.resolve()):
            raise SurefootError("lies outside of the scenario's folder")
        if path.suffix not in _GRIDS and path.suffix not in _MESHES:
            raise SurefootError(f"is none of {', '.join([*_GRIDS, *_MESHES])}")
        admitted(path, "terrain")
        protect(path)
        if path.suffix in _MESHES:
            if of.size or of.heights:
                raise SurefootError("size and heights are those of the mesh: leave them out")
            mesh = _MESHES[path.suffix](path)
            return HeightField(*_from_above(*mesh, of.center, of.spacing or MESH_SPACING), of.mu)
        if of.size is None or of.spacing:
            raise SurefootError("a grid needs size [m], and no spacing")
        x, y, w, h = *of.center, 0.5 * of.size[0], 0.5 * of.size[1]
        grid = _scaled(_GRIDS[path.suffix](path), of.heights, path.suffix == ".png")
        return HeightField((x - w, x + w, y - h, y + h), grid.T, of.mu)
    except (SurefootError, OSError, ValueError, EOFError, SyntaxError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise SurefootError(f"file '{of.file}': {reason}") from None


def _scaled(grid: np.ndarray, heights: tuple[float, float] | None, is_picture: bool) -> np.ndarray:
    """Convert the numbers of a grid (rows along y, columns along x) to heights [m]."""
    if grid.ndim != 2 or grid.dtype.kind not in "fiu":
        raise SurefootError("needs numbers in rows and columns")
    grid = grid.astype(float)
    if heights is None:
        if is_picture:
            raise SurefootError("a picture needs heights [m], of its darkest and lightest point")
        return grid
    low, high = grid.min(), grid.max()
    return heights[0] + (heights[1] - heights[0]) * (grid - low) / max(high - low, 1e-300)


def _picture(path: Path) -> np.ndarray:
    """Grey levels of a PNG; its first row is at the largest y."""
    from PIL import Image

    bombs = Image.DecompressionBombWarning, Image.DecompressionBombError
    with warnings.catch_warnings(action="error", category=bombs[0]):
        try:
            image = Image.open(path, formats=("PNG",))
        except bombs as error:  # of more points than Pillow opens
            raise SurefootError(str(error)) from None
    with image:
        check_limit("cells", image.width * image.height, "points")
        if image.mode not in ("L", "I", "I;16"):
            raise SurefootError(f"must be a grey PNG of 8 or 16 bits, its mode is {image.mode}")
        return np.asarray(image)[::-1]


def _array(path: Path) -> np.ndarray:
    found = np.load(path, mmap_mode="r", allow_pickle=False)  # its size is known before it is read
    check_limit("cells", found.size, "points")
    return found


def _table(path: Path) -> np.ndarray:
    return np.loadtxt(path, delimiter=",", ndmin=2, encoding="utf-8-sig")


def _mujoco_field(path: Path) -> np.ndarray:
    """MuJoCo's format: numbers of rows and columns as int32, then the rows as float32."""
    with path.open("rb") as stream:
        rows, columns = np.frombuffer(stream.read(_HEAD).ljust(_HEAD, b"\0"), "<i4").tolist()
        if min(rows, columns) < 1 or path.stat().st_size != _HEAD + 4 * rows * columns:
            raise SurefootError(f"is not as long as a field of {rows} x {columns} points")
        return np.fromfile(stream, "<f4").reshape(rows, columns)


def _obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) [m] and triangles (F, 3) of a Wavefront OBJ; polygons are divided into
    fans.
    """
    vertices, triangles = array("d"), array("q")
    with path.open(encoding="utf-8", errors="replace") as stream:
        for line in stream:
            key, *words = line.split() or [""]
            if key == "v":
                if len(words) < 3:
                    raise SurefootError(f"a vertex needs three numbers: '{line.strip()[:40]}'")
                vertices.extend(map(float, words[:3]))
            elif key == "f":
                # Indices start at 1; negative ones count from the last vertex.
                own = [int(word.partition("/")[0]) for word in words]
                own = [k - 1 if k > 0 else len(vertices) // 3 + k for k in own]
                for b, c in pairwise(own[1:]):
                    triangles.extend((own[0], b, c))
    return np.array(vertices).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _stl(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (3 F, 3) [m] and triangles (F, 3) of an STL, binary or text."""
    with path.open("rb") as stream:
        head = stream.read(_SOLID)
        if len(head) == _SOLID:
            count = int.from_bytes(head[-4:], "little")
            if path.stat().st_size == _SOLID + count * _FACET:
                facets = np.fromfile(stream, np.dtype([("f", "<f4", 12), ("_", "<u2")]))
                vertices = facets["f"][:, 3:].astype(float).reshape(-1, 3)
                return vertices, np.arange(len(vertices)).reshape(-1, 3)
    vertices = array("d")
    with path.open(encoding="utf-8", errors="replace") as stream:
        for line in stream:
            key, *words = line.split() or [""]
            if key == "vertex":
                vertices.extend(map(float, words))
    if len(vertices) % 9:
        raise SurefootError("is no STL: a facet needs three vertices of three numbers")
    found = np.array(vertices).reshape(-1, 3)
    return found, np.arange(len(found)).reshape(-1, 3)


_GRIDS: dict[str, Callable[[Path], np.ndarray]] = {
    ".png": _picture,
    ".npy": _array,
    ".csv": _table,
    ".hf": _mujoco_field,
}
_MESHES: dict[str, Callable[[Path], tuple[np.ndarray, np.ndarray]]] = {".obj": _obj, ".stl": _stl}


def _from_above(
    vertices: np.ndarray, triangles: np.ndarray, origin: tuple[float, float], spacing: float
) -> tuple[Extent, np.ndarray]:
    """The rectangle around a mesh, and the height (nx, ny) [m] of its upper surface at points about
    `spacing` apart; 0, the floor's height, where the mesh has none.

    Args:
        vertices: (V, 3) [m], relative to the origin.
        triangles: (F, 3), indices of vertices.
        origin: position of the origin in G [m].
        spacing: between points [m].
    """
    if not len(triangles):
        raise SurefootError("has no faces")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise SurefootError(f"a face names a vertex that is none of its {len(vertices)}")
    if not np.isfinite(vertices).all():
        raise SurefootError("a vertex is not a finite number")
    corners = vertices[triangles]  # (F, 3, 3)
    low, high = corners[..., :2].min(axis=(0, 1)), corners[..., :2].max(axis=(0, 1))
    cells = np.maximum(np.round((high - low) / spacing), 1.0)
    check_limit("cells", float(np.prod(cells + 1.0)), "points")
    step = (high - low) / cells
    if step.min() <= 0.0:
        raise SurefootError("its faces have no surface seen from above")
    corners[..., :2] -= low
    first = np.ceil(corners[..., :2].min(axis=1) / step - 1e-9).astype(np.int64)
    last = np.floor(corners[..., :2].max(axis=1) / step + 1e-9).astype(np.int64)
    inside = np.prod(np.maximum(last - first + 1, 0).astype(float), axis=1)
    check_limit("cells", float(inside.sum()), "points below its triangles")
    top = np.full(cells.astype(int) + 1, -np.inf)
    _raise_to(top, corners, first, np.minimum(last, np.array(top.shape) - 1), step)
    top[np.isinf(top)] = 0.0
    (x0, y0), (x1, y1) = low + origin, high + origin
    return (float(x0), float(x1), float(y0), float(y1)), top


@kernel
def _raise_to(top, corners, first, last, step):
    """Raise the heights of a grid to the triangles above them.

    Args:
        top: heights (nx, ny) [m], changed.
        corners: of the triangles, relative to the grid's first point (F, 3, 3) [m].
        first, last: indices of the grid points that may lie in each triangle (F, 2).
        step: spacing of the grid (2,) [m].
    """
    for k in range(len(corners)):
        a, b, c = corners[k]
        ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]
        area = ux * vy - uy * vx
        if abs(area) < 1e-12:
            continue  # upright: seen from above it is a line
        for i in range(first[k, 0], last[k, 0] + 1):
            for j in range(first[k, 1], last[k, 1] + 1):
                x, y = i * step[0] - a[0], j * step[1] - a[1]
                p, q = (x * vy - y * vx) / area, (ux * y - uy * x) / area
                if p >= -1e-9 and q >= -1e-9 and p + q <= 1.0 + 1e-9:
                    top[i, j] = max(top[i, j], a[2] + p * (b[2] - a[2]) + q * (c[2] - a[2]))
