"""Validation of a robot's XML before MuJoCo allocates memory or opens files.

MuJoCo itself would repeat a body a billion times if the file asks for it, and read any file that an
include names.
"""

import math
import os
import site
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
"""Maximum depth of elements, enough for a centipede of fifty segments."""
ATTRIBUTES = 1000
"""Maximum number of attributes of an element; MuJoCo's parser takes quadratic time in them."""
INCLUDES = 100
"""Maximum number of files in a model, counting nested includes each time."""
FILES, FOLDERS = 10_000, 20
"""Maximum number of shapes and pictures that a model names, and of folders for them."""
_PARTS = {
    "flexcomp",
    "composite",
    "body",
    "geom",
    "site",
    "joint",
    "freejoint",
    "link",
    "visual",
    "collision",
    "light",
}
_ASSETS = {".stl", ".obj", ".msh", ".ply", ".dae", ".png", ".jpg", ".jpeg", ".ktx", ".bin"}
"""Suffixes of shapes and pictures."""
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_SIZES = {"": 1, "k": 2**10, "m": 2**20, "g": 2**30, "t": 2**40, "p": 2**50, "e": 2**60}
_COUNTS = {"nkey"}
"""Sizes that count items of more than a byte; so do those that begin with nuser."""
_NAMES = {"name", "class", "childclass", "file", "model", "joint", "body", "link", "site"}
_NUMBERS = {"mass", "density", "pos", "size", "friction", "diaginertia", "fullinertia", "armature"}


def check_model_file(file: Path) -> None:
    """Check a model file before it is compiled.

    Raises SurefootError, one line with the file, for a model that is too large, includes files
    outside its folder, names shapes or pictures outside that and the folders beside it, has
    entities, or invalid numbers.
    """
    try:
        scan = _Scan(file)
        scan.read(file, 1)
        scan.check_named()
    except SurefootError:
        raise
    except (expat.ExpatError, ValueError, LookupError) as error:  # the others are of encodings
        raise SurefootError(f"robot {file}: cannot read it, not XML: {error}") from None


def check_compiled(file: Path, model: mujoco.MjModel) -> None:
    """Raise SurefootError for a compiled model with unphysical masses, positions or friction.

    Args:
        file: named in the message.
        model: as MuJoCo compiled it.
    """
    checked = "body_mass", "body_inertia", "body_pos", "body_quat", "geom_size", "geom_friction"
    checked += "dof_armature", "dof_damping", "jnt_stiffness"
    for name in checked:
        values = np.asarray(getattr(model, name))
        if not np.isfinite(values).all():
            raise SurefootError(f"robot {file}: {name} is not finite")
        if name not in ("body_pos", "body_quat") and (values < 0).any():
            raise SurefootError(f"robot {file}: {name} is negative")


class _Scan:
    """A scan of a model and all that it includes."""

    def __init__(self, file: Path):
        self.file = file
        self.folder = file.resolve().parent
        self.elements, self.files = 0, 0
        self.parts = 0.0
        self.folders = {""}
        self.named: list[tuple[Path, str, str]] = []

    def read(self, file: Path, times: float) -> None:
        """Scan one of its files, whose contents are repeated `times` times."""
        self.files += 1
        if self.files > INCLUDES:
            self.refuse(f"includes more than {INCLUDES} files, or itself")
        admitted(file, "text", "robot")
        protect(file)
        counts, included = [times], list[tuple[str, str, float]]()

        def start(tag: str, values: dict[str, str]) -> None:
            self.elements += 1
            check_limit("items", self.elements, f"robot {self.file}: elements")
            if len(values) > ATTRIBUTES:
                self.refuse(f"{tag} has more than {ATTRIBUTES} attributes")
            if len(counts) > DEEPEST:
                self.refuse(f"elements are nested deeper than {DEEPEST}")
            count = counts[-1] * self.repeated(tag, values)
            counts.append(count)
            self.parts += count if tag in _PARTS else 0.0
            check_limit("bodies", self.parts, f"robot {self.file}: bodies and shapes")
            if tag == "compiler":
                self.folders.update(values[key] for key in _FOLDERS if key in values)
            self.check_values(tag, values)
            if file.suffix == ".urdf":
                return
            if tag == "robot":
                self.refuse("a URDF's name ends in .urdf")
            for name in (values[key] for key in values if key.startswith("file") and values[key]):
                if tag in ("include", "model"):
                    included.append((tag, name, count))
                else:
                    self.named.append((file.parent, tag, name))

        parser = expat.ParserCreate()
        parser.StartElementHandler = start
        parser.EndElementHandler = lambda tag: counts.pop()
        parser.StartDoctypeDeclHandler = lambda *_: self.refuse("has a DOCTYPE, so entities")
        with file.open("rb") as stream:
            parser.ParseFile(stream)
        for tag, name, count in included:
            path = file.parent / name
            if not (self.within(path, self.folder) or _installed(self.file)):
                self.refuse(f"{tag} file '{name}' lies outside of the model's folder")
            if tag == "include" or path.suffix == ".xml":
                self.read(path.resolve(), count)
            elif is_there(path):
                admitted(path, "piece", "robot")

    def check_named(self) -> None:
        """Check the shapes and pictures that the model names.

        MuJoCo takes a name from the model's folder or that of a `<compiler>`, whichever comes last
        in any of the files; here it must be within bounds from each of them.
        """
        named = dict.fromkeys(self.named)
        if len(named) > FILES or len(self.folders) > FOLDERS:
            self.refuse(f"names more than {FILES} files or {FOLDERS} folders")
        for included, tag, name in named:
            for base in {self.folder, included}:
                for folder in self.folders:
                    path = base / folder / name
                    if not (self.is_asset(path) or _installed(self.file)):
                        where = "model's folder and the folders beside it"
                        self.refuse(f"{tag} file '{name}' lies outside of the {where}")
                    if is_there(path):
                        admitted(path, "piece", "robot")

    def is_asset(self, path: Path) -> bool:
        """Whether a path lies in the model's folder or, as a shape or picture, in a folder beside
        it, such as `../meshes`. Folders of users are not beside each other.
        """
        if self.within(path, self.folder):
            return True
        above = self.folder.parent
        if path.suffix.lower() not in _ASSETS or above in (*Path.home().parents, Path.home()):
            return False
        if not self.within(path, above):
            return False
        parts = [one.relative_to(above).parts for one in self.readings(path)]
        hidden = any(part.startswith(".") for part in (*parts[0], *parts[1]))
        return min(map(len, parts)) > 1 and not hidden

    @staticmethod
    def readings(path: Path) -> tuple[Path, Path]:
        """A path with symbolic links resolved before `..`, as by the system, and after."""
        return path.resolve(), Path(os.path.normpath(path)).resolve()

    def within(self, path: Path, folder: Path) -> bool:
        """Whether a path lies in a folder, in either reading."""
        return all(one.is_relative_to(folder) for one in self.readings(path))

    def repeated(self, tag: str, values: dict[str, str]) -> float:
        """Number of copies that an element makes of its contents."""
        if tag not in ("replicate", "composite", "flexcomp"):
            return 1.0
        product = 1.0
        for count in values.get("count", "1").split()[:3]:
            product *= max(1.0, self.number(tag, "count", count))
        return product

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


@cache
def _installed(file: Path) -> bool:
    """Whether a model is part of an installed package, which may refer to adjacent folders."""
    folders = [sysconfig.get_path(name) for name in ("purelib", "platlib")]
    folders += [site.getusersitepackages(), str(Path.home() / ".cache" / "robot_descriptions")]
    return any(file.resolve().is_relative_to(Path(folder).resolve()) for folder in folders)
