"""Validation of a robot's XML before MuJoCo allocates memory or opens files.

MuJoCo itself would repeat a body a billion times if the file asks for it, and read any file that an
include names.
"""

import math
import os
import site
import struct
import sysconfig
from functools import cache
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import is_there, protect
from surefoot.sim.common.limits import admitted, check_limit

DEEPEST = 100
"""Maximum depth of elements, of a URDF's links and of a composite's bodies, enough for a centipede
of fifty segments.
"""
FLEXIBLE = 1000
"""Maximum number of points of flexible bodies in a model, which MuJoCo compiles in a second; its
time grows with their square.
"""
ATTRIBUTES = 1000
"""Maximum number of attributes of an element; MuJoCo's parser takes quadratic time in them."""
INCLUDES = 100
"""Maximum number of files in a model, counting nested includes each time."""
MOST_FILES, MOST_FOLDERS = 10_000, 20
"""Maximum number of shapes and pictures that a model names, and of folders for them."""
LARGEST = 1e10
"""Largest number with which MuJoCo computes, its mjMAXVAL."""
_PARTS = {"body", "geom", "site", "joint", "freejoint", "light", "flexcomp", "composite"}
_PARTS |= {"link", "visual", "collision"}
_ASSETS = {".stl", ".obj", ".msh", ".ply", ".dae", ".png", ".jpg", ".jpeg", ".ktx", ".bin"}
"""Suffixes of shapes and pictures."""
_BYTES_OF_POINT = 50
"""Least size of a point in a file of a flexible body, with its share of triangles [bytes]."""
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_SIZES = {"": 1, "k": 2**10, "m": 2**20, "g": 2**30, "t": 2**40, "p": 2**50, "e": 2**60}
_COUNTS = {"nkey"}
"""Sizes that count items of more than a byte; so do those that begin with nuser."""
_NAMES = {"name", "class", "childclass", "file", "model", "joint", "body", "link", "site"}
_NUMBERS = {"mass", "density", "pos", "size", "friction", "diaginertia", "fullinertia", "armature"}


def check_model_file(file: Path) -> None:
    """Check a model file before it is compiled.

    Like MuJoCo, it takes a file for MJCF or URDF by its root element. Raises SurefootError, one
    line with the file, for a model that is too large, includes files outside its folder, names
    shapes or pictures outside that and the folders beside it, has entities, or invalid numbers.
    """
    try:
        scan = _Scan(file)
        scan.read(file, 1.0, 0)
        scan.check_named()
    except SurefootError:
        raise
    except (expat.ExpatError, ValueError, LookupError) as error:  # the others are of encodings
        raise SurefootError(f"robot {file}: cannot read it, not XML: {error}") from None


def check_compiled(file: Path, model: mujoco.MjModel) -> None:
    """Raise SurefootError for a compiled model with masses, lengths, springs, friction or keyframes
    with which MuJoCo cannot compute.

    Args:
        file: named in the message.
        model: as MuJoCo compiled it.
    """
    checked = "body_mass", "body_inertia", "body_pos", "body_quat", "geom_size", "geom_friction"
    checked += "dof_armature", "dof_damping", "dof_frictionloss", "jnt_stiffness", "key_qpos"
    for name in checked:
        values = np.asarray(getattr(model, name))
        if not (np.abs(values) <= LARGEST).all():
            raise SurefootError(f"robot {file}: {name} is not finite, or larger than {LARGEST:g}")
        if name not in ("body_pos", "body_quat", "key_qpos") and (values < 0).any():
            raise SurefootError(f"robot {file}: {name} is negative")


class _Scan:
    """A scan of a model and all that it includes."""

    def __init__(self, file: Path):
        self.file = file
        self.folder = file.resolve().parent
        self.elements, self.files = 0, 0
        self.parts, self.flexible = 0.0, 0.0
        self.folders = {""}
        self.named = dict[tuple[Path, str, str], None]()

    def read(self, file: Path, times: float, depth: int) -> None:
        """Scan one of its files.

        Args:
            file: the model's own, or one that it includes or attaches.
            times: how often the contents are repeated.
            depth: number of elements that enclose them.
        """
        self.files += 1
        if self.files > INCLUDES:
            self.refuse(f"includes more than {INCLUDES} files, or itself")
        admitted(file, "text", "robot")
        protect(file)
        counts, included = [times], list[tuple[str, float, int]]()
        tags, ends, parents = list[str](), dict[str, str](), dict[str, str]()

        def start(tag: str, values: dict[str, str]) -> None:
            self.elements += 1
            check_limit("items", self.elements, f"robot {self.file}: elements")
            if len(values) > ATTRIBUTES:
                self.refuse(f"{tag} has more than {ATTRIBUTES} attributes")
            if depth + len(counts) > DEEPEST:
                self.refuse(f"elements are nested deeper than {DEEPEST}, or a file includes itself")
            counts.append(self.count(tag, values, counts[-1]))
            self.check_values(tag, values)
            tags.append(tag)
            urdf, own = tags[0] == "robot", file == self.file
            if (own and urdf != (file.suffix == ".urdf")) or (tag == "robot" and len(tags) > 1):
                self.refuse("a URDF's name ends in .urdf, and it begins with <robot>")
            if urdf and tag == "joint":
                ends.clear()
            if urdf and tag in ("parent", "child"):
                ends[tag] = values.get("link", "")
                if len(ends) == 2:
                    parents[ends["child"]] = ends["parent"]
            if urdf and own:
                return  # its reader opens none of the files that it names
            if tag == "compiler":
                self.folders.update(values[key] for key in _FOLDERS if key in values)
            for name in (values[key] for key in values if key.startswith("file") and values[key]):
                if tag in ("include", "model"):
                    if not self.may_read(file.parent / name, beside=False):
                        self.refuse(f"{tag} file '{name}' lies outside of the model's folder")
                    nested = depth + len(counts) if tag == "include" else 0
                    included.append((name, counts[-1], nested))
                else:
                    self.named[file.parent, tag, name] = None

        parser = expat.ParserCreate()
        parser.StartElementHandler = start
        parser.EndElementHandler = lambda tag: counts.pop()
        parser.StartDoctypeDeclHandler = lambda *_: self.refuse("has a DOCTYPE, so entities")
        with file.open("rb") as stream:
            parser.ParseFile(stream)
        self.check_chains(parents)
        for name, count, nested in included:
            self.read((file.parent / name).resolve(), count, nested)

    def check_chains(self, parents: dict[str, str]) -> None:
        """Raise for the links of a URDF, each with its parent, that are nested too deeply."""
        for link in parents:
            above: str | None = link
            for _ in range(DEEPEST):
                above = parents.get(above) if above is not None else None
            if above is not None:
                self.refuse(f"links of the URDF are nested deeper than {DEEPEST}, or in a circle")

    def check_named(self) -> None:
        """Check the shapes and pictures that the model names.

        MuJoCo takes a name from the model's folder or that of a `<compiler>`, whichever comes last
        in any of the files; here it must be within bounds from each of them.
        """
        if len(self.named) > MOST_FILES or len(self.folders) > MOST_FOLDERS:
            self.refuse(f"names more than {MOST_FILES} files or {MOST_FOLDERS} folders")
        pixels = dict[Path, int]()
        for included, tag, name in self.named:
            for path in {
                base / folder / name for base in (self.folder, included) for folder in self.folders
            }:
                if not self.may_read(path, beside=True):
                    where = "model's folder and the folders beside it"
                    self.refuse(f"{tag} file '{name}' lies outside of the {where}")
                if not is_there(path):
                    continue
                admitted(path, "piece", "robot")
                if tag == "flexcomp" and path.stat().st_size > _BYTES_OF_POINT * FLEXIBLE:
                    self.refuse(f"{tag} file '{name}' has more than {FLEXIBLE} points")
                pixels[path.resolve()] = _pixels(path)
        check_limit("pixels", sum(pixels.values()), f"robot {self.file}: pixels of its pictures")

    def may_read(self, path: Path, beside: bool) -> bool:
        """Whether a path lies in the model's folder or, if `beside` and it is a shape or picture,
        in a folder beside it, such as `../meshes`. Folders of users are not beside each other.

        Symbolic links are resolved before `..`, as by the system, and after, as MuJoCo may do.
        """
        above = self.folder.parent
        beside = beside and path.suffix.lower() in _ASSETS
        beside = beside and above not in (*Path.home().parents, Path.home())
        for one in (path.resolve(), Path(os.path.normpath(path)).resolve()):
            if one.is_relative_to(self.folder):
                continue
            parts = one.relative_to(above).parts if one.is_relative_to(above) else ()
            hidden = any(part.startswith(".") for part in parts)
            if not beside or len(parts) < 2 or hidden:
                return _installed(self.file)
        return True

    def count(self, tag: str, values: dict[str, str], times: float) -> float:
        """Number of copies of an element's contents, where it itself is there `times` times.

        Raises if the model has too many bodies and shapes.
        """
        copies = 1.0
        if tag in ("replicate", "composite", "flexcomp"):
            for count in values.get("count", "1").split()[:3]:
                copies *= max(1.0, self.number(tag, "count", count))
        if tag == "composite" and copies > DEEPEST:
            self.refuse(f"a composite is a chain of more than {DEEPEST} bodies")
        if tag == "flexcomp":
            copies = max(copies, len(values.get("point", "").split()) / 3)
            self.flexible += times * copies
            if self.flexible > FLEXIBLE:
                self.refuse(f"flexcomp has more than {FLEXIBLE} points")
        if tag in _PARTS:
            self.parts += times * copies
            check_limit("bodies", self.parts, f"robot {self.file}: bodies and shapes")
        return times * copies

    def check_values(self, tag: str, values: dict[str, str]) -> None:
        """Raise for invalid numbers, and for sizes that MuJoCo would allocate."""
        for key, text in values.items():
            if key not in _NAMES and "nan" in text.lower().split():
                self.refuse(f"{tag} {key} is nan")
        for key in _NUMBERS & values.keys():
            for number in values[key].split():
                if not math.isfinite(self.number(tag, key, number)):
                    self.refuse(f"{tag} {key} is {number}")
        if tag == "size":
            for key, text in values.items():
                unit = text[-1:].lower() if text[-1:].isalpha() else ""
                amount = self.number(tag, key, text[: len(text) - len(unit)])
                limit = "items" if key in _COUNTS or key.startswith("nuser") else "arena"
                check_limit(limit, amount * _SIZES.get(unit, 1), f"robot {self.file}: size {key}")
        for rows, columns in (("nrow", "ncol"), ("height", "width")):
            if tag in ("hfield", "texture") and rows in values and columns in values:
                points = self.number(tag, rows, values[rows])
                points *= self.number(tag, columns, values[columns])
                check_limit("cells", points, f"robot {self.file}: points of {tag}")

    def number(self, tag: str, key: str, text: str) -> float:
        """Parse a number of the file."""
        try:
            return float(text)
        except ValueError:
            self.refuse(f"{tag} {key} must be a number, is '{text[:40]}'")

    def refuse(self, why: str) -> NoReturn:
        """Raise SurefootError with the model's file."""
        raise SurefootError(f"robot {self.file}: {why}")


def _pixels(path: Path) -> int:
    """Pixels of a PNG picture by its header, which may unpack a thousandfold; of others 0."""
    with path.open("rb") as stream:
        head = stream.read(24)
    if len(head) < 24 or not head.startswith(b"\x89PNG"):
        return 0
    width, height = struct.unpack(">II", head[16:])
    return width * height


@cache
def _installed(file: Path) -> bool:
    """Whether a model is part of an installed package, which may refer to adjacent folders."""
    folders = [sysconfig.get_path(name) for name in ("purelib", "platlib")]
    folders += [site.getusersitepackages(), str(Path.home() / ".cache" / "robot_descriptions")]
    return any(file.resolve().is_relative_to(Path(folder).resolve()) for folder in folders)
