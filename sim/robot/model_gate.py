"""Validation of a robot's XML before MuJoCo allocates memory or opens files.

MuJoCo itself would repeat a body a billion times if the file asks for it, and read any file that an
include names.
"""

import math
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
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_SIZES = {"": 1, "k": 2**10, "m": 2**20, "g": 2**30, "t": 2**40, "p": 2**50, "e": 2**60}
_COUNTS = {"nkey"}
"""Sizes that count items of more than a byte; so do those that begin with nuser."""
_NAMES = {"name", "class", "childclass", "file", "model", "joint", "body", "link", "site"}
_NUMBERS = {"mass", "density", "pos", "size", "friction", "diaginertia", "fullinertia", "armature"}


def check_model_file(file: Path) -> None:
    """Check a model file before it is compiled.

    Raises SurefootError, one line with the file, for a model that is too large, refers to files
    outside its folder, has entities, or invalid numbers.
    """
    try:
        _Scan(file).read(file, 1)
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
        above = self.folder.parent
        self.beside = above if above != above.parent else self.folder
        self.elements, self.files = 0, 0
        self.parts = 0.0

    def read(self, file: Path, times: float) -> None:
        """Scan one of its files, whose contents are repeated `times` times."""
        self.files += 1
        if self.files > INCLUDES:
            self.refuse(f"includes more than {INCLUDES} files, or itself")
        admitted(file, "text", "robot")
        protect(file)
        counts, folders, waiting = [times], dict[str, str](), list[tuple[str, str, float]]()

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
                folders.update({k: v for k, v in values.items() if k in _FOLDERS})
            self.check_values(tag, values)
            if "file" in values and file.suffix != ".urdf":
                waiting.append((tag, values["file"], count))

        parser = expat.ParserCreate()
        parser.StartElementHandler = start
        parser.EndElementHandler = lambda tag: counts.pop()
        parser.StartDoctypeDeclHandler = lambda *_: self.refuse("has a DOCTYPE, so entities")
        with file.open("rb") as stream:
            parser.ParseFile(stream)
        for tag, name, count in waiting:
            inside = self.inside(file, tag, name, folders)
            if tag == "include" or (tag == "model" and inside.suffix == ".xml"):
                self.read(inside, count)
            elif is_there(inside):
                admitted(inside, "piece", "robot")

    def inside(self, file: Path, tag: str, name: str, folders: dict[str, str]) -> Path:
        """Path of a file that the model names; it must lie in the model's folder, shapes and
        pictures in that or a folder beside it, such as `../meshes`.
        """
        own = {"mesh": "meshdir", "skin": "meshdir", "hfield": "meshdir", "texture": "texturedir"}
        folder = folders.get(own.get(tag, ""), folders.get("assetdir", "") if tag in own else "")
        path = (file.parent / folder / name).resolve()
        if path.is_relative_to(self.folder) or _installed(self.file):
            return path
        if tag in own and path.is_relative_to(self.beside) and path.parent != self.beside:
            return path
        self.refuse(f"{tag} file '{name}' lies outside of the model's folder")

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


def _installed(file: Path) -> bool:
    """Whether a model is part of an installed package, which may refer to adjacent folders."""
    return bool({"site-packages", "dist-packages"} & set(file.parts)) or (
        Path.home() / ".cache" / "robot_descriptions" in file.parents
    )
