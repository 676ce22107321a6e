"""The model that a log stores for a robot that is known by its file only.

Path and SHA-256 of the file, and its text if it needs no other file: the log remains tied to that
model, even if the file is moved or changed.
"""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import cache_folder, file_digest, is_file, kept_file
from surefoot.sim.common.limits import limits
from surefoot.sim.robot.catalog import SUFFIXES, known_robots, robot_file

if TYPE_CHECKING:
    from surefoot.sim.log import Log


def model_metadata(name: str, file: Path) -> dict[str, dict[str, str]]:
    """Entries of `Meta.model` for a robot; empty if its name identifies it."""
    if known_robots().get(name) == file:
        return {}
    content = file.read_bytes()
    kept = {"path": str(file.resolve()), "sha256": hashlib.sha256(content).hexdigest()}
    # A URDF is read without its meshes; an MJCF refers to other files by this attribute only.
    if len(content) <= limits().text and (file.suffix == ".urdf" or b"file=" not in content):
        kept["text"] = content.decode("utf-8", errors="replace")
    return {"file": kept}


def robot_of_log(log: "Log") -> str | Path | None:
    """Name or file of a log's robot; None where it has none.

    Raises SurefootError where the file is needed and is missing or has changed.
    """
    kept = log.meta.model.get("file")
    if kept is None:
        return log.meta.robot
    path, digest, text = Path(kept["path"]), kept["sha256"], kept.get("text")
    if path.suffix in SUFFIXES and is_file(path) and file_digest(path) == digest:
        return path
    if text is None or path.suffix not in SUFFIXES:
        what = "has changed since" if is_file(path) else "is not there"
        raise SurefootError(f"{log.name}: the model of its robot, {path}, {what}: say which")
    content = text.encode()
    if hashlib.sha256(content).hexdigest() != digest:
        raise SurefootError(f"{log.name}: the model of its robot does not match its digest")
    copy = cache_folder() / "models" / digest / path.name
    if not copy.is_file() or file_digest(copy) != digest:
        with kept_file(copy) as temporary:
            temporary.write_bytes(content)
    return copy


def of_robot(log: "Log", robot: str | Path | None) -> "Log":
    """The log with this robot (name or file); unchanged if that is None.

    Raises SurefootError for an unknown robot.
    """
    if robot is None:
        return log
    file = robot_file(robot)
    model = {key: value for key, value in log.meta.model.items() if key != "file"}
    model |= model_metadata(file.stem, file)
    return replace(log, meta=replace(log.meta, robot=file.stem, model=model))
