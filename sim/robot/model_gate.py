"""Validation of a robot's XML before MuJoCo allocates memory or opens files.

MuJoCo itself would repeat a body a billion times if the file asks for it, and read any file that an
include names.
"""

import math
import os
import site
import sysconfig
from collections import Counter
from functools import cache
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree

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
POINTS = 200_000
"""Maximum number of points of a mesh, whose hull MuJoCo computes in some 7 s. The largest known
of a robot has 183 181, on the Unitree B2; most have less than 100 000.
"""
ATTRIBUTES = 1000
"""Maximum number of attributes of an element; MuJoCo's parser takes quadratic time in them."""
INCLUDES = 100
"""Maximum number of files in a model, counting nested includes each time."""
MOST_FILES = 10_000
"""Maximum number of shapes and pictures that a model names, times that of folders for them."""
LARGEST = 1e10
"""Largest number with which MuJoCo computes, its mjMAXVAL."""
_PARTS = {"body", "geom", "site", "joint", "freejoint", "light", "flexcomp", "composite"}
_PARTS |= {"link", "visual", "collision"}
_COPIED = {"replicate", "composite", "flexcomp"}
"""Elements that repeat their contents, or are a body each time."""
_COUNTED = {"count", "cellcount", "nrow", "ncol", "width", "height", "nchannel"}
_COUNTED |= {"dim", "num", "nsample", "actdim"}
"""Attributes whose product is how many copies, points or readings an element asks for."""
_ASSETS = {".stl", ".obj", ".msh", ".ply", ".dae", ".png", ".jpg", ".jpeg", ".ktx", ".bin"}
"""Suffixes of shapes and pictures."""
_BYTES_OF_POINT = 50
"""Least size of a point in a file of a flexible body, with its share of triangles [bytes]."""
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_UNITS = {"k": 2**10, "m": 2**20, "g": 2**30, "t": 2**40, "p": 2**50, "e": 2**60}
_SIZES = {"memory": "arena", "nstack": "cells"}
"""Limits of the attributes of <size>; the others count items."""
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
        scan.check_rows()
        scan.check_named()
    except SurefootError:
        raise
    except (SyntaxError, ValueError, LookupError) as error:  # the others are of encodings
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


class _Builder(ElementTree.TreeBuilder):
    """Builds the tree of a file, with bounds on what takes long before the tree is there."""

    def __init__(self, scan: "_Scan"):
        super().__init__()
        self._scan = scan

    def start(self, tag: str, attrs: dict[str, str], /) -> ElementTree.Element:
        self._scan.elements += 1
        check_limit("items", self._scan.elements, f"robot {self._scan.file}: elements")
        if len(attrs) > ATTRIBUTES:
            self._scan.refuse(f"{tag} has more than {ATTRIBUTES} attributes")
        return super().start(tag.rpartition("}")[2], attrs)  # MuJoCo ignores namespaces

    def doctype(self, *_: object) -> None:
        self._scan.refuse("has a DOCTYPE, so entities")


class _Scan:
    """A scan of a model and all that it includes and attaches."""

    def __init__(self, file: Path):
        self.file, self.urdf = file, file.suffix == ".urdf"
        self.folder = file.resolve().parent
        self.elements, self.files = 0, 0
        self.parts, self.flexible, self.cells = 0.0, 0.0, 0.0
        self.keyframes, self.rows = 0, 0.0
        self.places, self.folders = {self.folder}, {""}
        self.named = Counter[tuple[str, str]]()

    def read(self, file: Path, times: float, depth: int) -> None:
        """Scan a model, then those that it attaches.

        Args:
            file: the model's own, or one that it attaches.
            times: how often the contents are repeated.
            depth: number of elements that enclose them.
        """
        root, attached = self.parsed(file, file.parent), list[tuple[str, float, int]]()
        is_urdf = root.tag.lower() == "robot"  # MuJoCo knows a root in capitals, too
        if file == self.file and is_urdf != self.urdf:
            self.refuse("a URDF's name ends in .urdf, and it begins with <robot>")
        if is_urdf:
            self.check_chains(root)
        self.walk(root, times, depth + 1, attached)
        for model in root.iter("model") if not self.urdf else ():
            name = model.get("name")
            uses = [(n, d) for to, n, d in attached if not name or to == name] or [(1.0, 0)]
            copies, deepest = sum(n for n, _ in uses), max(d for _, d in uses)
            self.read(Path(model.get("file", "")), copies, deepest)

    def parsed(self, file: Path, home: Path) -> ElementTree.Element:
        """The tree of a file of the model in the folder `home`.

        Elements that include a file hold what is in it; those of attached models name a path.
        """
        self.files += 1
        if self.files > INCLUDES:
            self.refuse(f"includes more than {INCLUDES} files, or itself")
        protect(admitted(file, "text", "robot"))
        self.places.add(file.parent.absolute())
        with file.open("rb") as stream:
            root = ElementTree.parse(stream, ElementTree.XMLParser(target=_Builder(self))).getroot()
        for element in list(root.iter()) if not self.urdf else ():
            if element.tag == "include":
                element.append(self.parsed(self.file_of(element, home, file.parent), home))
            elif element.tag == "model":
                element.set("file", str(self.file_of(element, home, file.parent)))
        return root

    def file_of(self, element: ElementTree.Element, *folders: Path) -> Path:
        """The file that an element includes or attaches: in the first of the folders that has it,
        as MuJoCo searches them.
        """
        name = _plain_name(element.get("file", ""))
        paths = [folder / name for folder in folders]
        if not all(self.may_read(path, beside=False) for path in paths):
            self.refuse(f"{element.tag} file '{name}' lies outside of the model's folder")
        return next(filter(is_there, paths), paths[0])

    def walk(
        self,
        element: ElementTree.Element,
        times: float,
        depth: int,
        attached: list[tuple[str, float, int]],
    ) -> None:
        """Scan an element, `times` and `depth` as in `read`, and all in it; models that it attaches
        are added with their number and depth.
        """
        if depth > DEEPEST:
            self.refuse(f"elements are nested deeper than {DEEPEST}, or a file includes itself")
        tag, values = element.tag, dict(element.attrib)
        self.check_values(tag, values)
        inside = self.count(tag, values, times)
        if tag == "compiler":
            self.folders.update(_plain_name(values[key]) for key in _FOLDERS if key in values)
        if tag == "attach":
            attached.append((values.get("model", ""), inside, depth))
        if tag not in ("include", "model") and not self.urdf:  # whose meshes are not read
            self.named.update((tag, _plain_name(values[k])) for k in values if k.startswith("file"))
        for child in element:
            self.walk(child, inside, depth + 1, attached)

    def check_chains(self, robot: ElementTree.Element) -> None:
        """Raise for a URDF whose links are nested too deeply."""
        joints = ((joint.find("child"), joint.find("parent")) for joint in robot.iter("joint"))
        parents = {
            child.get("link", ""): parent.get("link", "")
            for child, parent in joints
            if child is not None and parent is not None
        }
        for above in parents:
            for _ in range(DEEPEST):
                above = parents.get(above, "")
            if above:
                self.refuse(f"links of the URDF are nested deeper than {DEEPEST}, or in a circle")

    def check_rows(self) -> None:
        """Raise if keyframes, or numbers of the user's, take too much memory for all elements."""
        numbers = max(self.rows, self.keyframes) * (self.elements + self.parts)
        check_limit("cells", numbers, f"robot {self.file}: numbers of nkey or nuser")

    def check_named(self) -> None:
        """Check the shapes and pictures that the model names.

        MuJoCo takes a name from the model's folder or that of a `<compiler>`, whichever comes last
        in any of the files; here it must be within bounds from each of them.
        """
        if len(self.named) * len(self.folders) * len(self.places) > MOST_FILES:
            self.refuse(f"names more than {MOST_FILES} files, in all its folders")
        size, pixels = 0, 0
        for (tag, name), times in self.named.items():
            for path in {one / folder / name for one in self.places for folder in self.folders}:
                if not self.may_read(path, beside=True):
                    where = "model's folder and the folders beside it"
                    self.refuse(f"{tag} file '{name}' lies outside of the {where}")
                if not name or not is_there(path):
                    continue
                found = admitted(path, "terrain", "robot").stat().st_size
                if tag == "flexcomp" and found > _BYTES_OF_POINT * FLEXIBLE:
                    self.refuse(f"{tag} file '{name}' has more than {FLEXIBLE} points")
                if tag == "mesh" and _points(path) > POINTS:
                    self.refuse(f"{tag} file '{name}' has more than {POINTS} points")
                size += times * found
                # A height takes ten times the memory of a colour.
                pixels += times * _pixels(path) * (10 if tag == "hfield" else 1)
        check_limit("piece", size, f"robot {self.file}: bytes of its shapes and pictures")
        check_limit("pixels", pixels, f"robot {self.file}: pixels of its pictures")

    def may_read(self, path: Path, beside: bool) -> bool:
        """Whether a path lies in the model's folder or, if `beside` and it is a shape or picture,
        in a folder beside it, such as `../meshes`. Folders of users are not beside each other.

        Symbolic links are resolved before `..`, as by the system, and after, as MuJoCo may do; a
        file of the model itself must be the same in both.
        """
        above = self.folder.parent
        beside = beside and path.suffix.lower() in _ASSETS
        beside = beside and above not in (*Path.home().parents, Path.home())
        readings = {path.resolve(), Path(os.path.normpath(path)).resolve()}
        for one in readings:
            if one.is_relative_to(self.folder) and (beside or len(readings) == 1):
                continue
            parts = one.relative_to(above).parts if one.is_relative_to(above) else ()
            hidden = any(part.startswith(".") for part in parts)
            if not beside or len(parts) < 2 or hidden:
                return _installed(self.file)
        return True

    def count(self, tag: str, values: dict[str, str], times: float) -> float:
        """Number of copies of an element's contents, where it itself is there `times` times.

        Raises if the model has too many bodies and shapes, or points and readings in all.
        """
        if tag == "config" and values.get("key") == "size":  # of a plugin, such as a grid of touch
            values = {"count": values.get("value", "")}
        asked = math.prod(
            max(1.0, self.number(tag, key, one))
            for key in _COUNTED & values.keys()
            for one in values[key].split()[:3]
        )
        if tag == "texture" and "height" not in values:
            asked *= 6 * asked  # a square for each side of a cube
        if tag == "mesh" and "params" in values:  # triangles along an edge of a built-in shape
            asked = max(self.number(tag, "params", one) for one in values["params"].split()) ** 2
        copies = asked if tag in _COPIED else 1.0
        if tag in ("composite", "flexcomp", "flex"):
            listed = values.get("point", values.get("vertex", ""))
            copies = max(copies, len(listed.split()) / 3)
        if tag == "composite" and copies > DEEPEST:
            self.refuse(f"a composite is a chain of more than {DEEPEST} bodies")
        if tag in ("flexcomp", "flex"):
            grid = tag == "flexcomp" and not {"count", "point", "file"} & values.keys()
            self.flexible += times * max(copies, FLEXIBLE if grid else 0.0)
            if self.flexible > FLEXIBLE:
                self.refuse(f"{tag} has more than {FLEXIBLE} points")
        if tag in _PARTS:
            self.parts += times * copies
            check_limit("bodies", self.parts, f"robot {self.file}: bodies and shapes")
        elif tag not in _COPIED:
            self.cells += times * asked
            check_limit("cells", self.cells, f"robot {self.file}: points or readings with {tag}")
        self.keyframes += tag == "key"
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
        for key, text in values.items() if tag == "size" else ():
            unit = _UNITS.get(text[-1:].lower(), 1)
            amount = unit * self.number(tag, key, text if unit == 1 else text[:-1])
            check_limit(_SIZES.get(key, "items"), amount, f"robot {self.file}: size {key}")
            if key == "nkey" or key.startswith("nuser_"):
                self.rows = max(self.rows, amount)

    def number(self, tag: str, key: str, text: str) -> float:
        """Parse a number of the file."""
        try:
            return float(text)
        except ValueError:
            self.refuse(f"{tag} {key} must be a number, is '{text[:40]}'")

    def refuse(self, why: str) -> NoReturn:
        """Raise SurefootError with the model's file."""
        raise SurefootError(f"robot {self.file}: {why}")


def _plain_name(name: str) -> str:
    """A file's name with the separators that MuJoCo takes for such on any system."""
    return name.replace("\\", "/")


def _points(path: Path) -> int:
    """Points of a mesh by its content, as MSH, whose first word counts them, or as OBJ, with a line
    for each; 0 for STL, of which MuJoCo reads no more than 200 000 triangles.
    """
    content = path.read_bytes()
    counted = int.from_bytes(content[:4], "little")
    listed = content.count(b"v ") + content.count(b"v\t")
    return max(listed, counted if 12 * counted <= len(content) else 0)


def _pixels(path: Path) -> int:
    """Pixels of a PNG picture by its header, which may unpack a thousandfold, twice for those of
    two bytes a colour; of other pictures 0.
    """
    with path.open("rb") as stream:
        head = stream.read(25)
    if len(head) < 24 or not head.startswith(b"\x89PNG"):
        return 0
    width, height = int.from_bytes(head[16:20]), int.from_bytes(head[20:24])
    return width * height * (2 if head[24:] > b"\x08" else 1)


@cache
def _installed(file: Path) -> bool:
    """Whether a model is part of an installed package, which may refer to adjacent folders."""
    folders = [sysconfig.get_path(name) for name in ("purelib", "platlib")]
    folders += [site.getusersitepackages(), str(Path.home() / ".cache" / "robot_descriptions")]
    return any(file.resolve().is_relative_to(Path(folder).resolve()) for folder in folders)
