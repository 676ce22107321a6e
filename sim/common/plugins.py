"""What users add in packages of their own, found by the entry points of installed distributions.

A package offers one by a line of its metadata, in pyproject.toml

    [project.entry-points."surefoot.effects"]
    tilt = "my_package:Tilt"

and from then on it stands in every list beside those that come with surefoot. A single file offers
its own for one run, `surefoot --plugin FILE.py ...`, by a dict of groups:

    PLUGINS = {"surefoot.effects": {"tilt": Tilt}}
"""

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import is_file


class Registry(Mapping[str, Any]):
    """Name -> member of a group: those that come with surefoot, then those that users add.

    Names are listed without an import; a member is imported when it is looked up, so that one that
    is broken stops only what uses it.
    """

    def __init__(
        self,
        group: str,
        bundled: Mapping[str, Any],
        needs: tuple[str, ...] = (),
        check: Callable[[str, Any], None] = lambda name, member: None,
    ):
        """What a group holds.

        Args:
            group: of entry points, such as "surefoot.effects".
            bundled: name -> member that comes with surefoot, or "module:attribute" of it.
            needs: attributes that each member added must have.
            check: raises SurefootError saying what is wrong with a name and the member added.
        """
        self.group, self.bundled, self.needs, self.check = group, bundled, needs, check

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self.bundled, *plugins(self.group))))

    def __len__(self) -> int:
        return len(self.bundled.keys() | plugins(self.group).keys())

    def __contains__(self, name: object) -> bool:
        return name in self.bundled or name in plugins(self.group)

    def __getitem__(self, name: str) -> Any:
        """The member of that name.

        Raises KeyError where there is none, and SurefootError, one line that names the plugin,
        where it cannot be imported, lacks an attribute, fails the check, or bears the name of
        another.
        """
        points = plugins(self.group).get(name, ())
        if name in self.bundled:
            if points:
                raise SurefootError(f"{_what(points[0])}: surefoot has one of that name")
            member = self.bundled[name]
            return EntryPoint(name, member, self.group).load() if type(member) is str else member
        if not points:
            raise KeyError(name)
        point, *others = points
        if others:
            raise SurefootError(f"{_what(point)}: {others[0].value} has that name too")
        try:
            member = point.load()
        except Exception as error:  # whatever a module of a user's own raises
            reason = f"{type(error).__name__}: {error}"
            raise SurefootError(f"{_what(point)}: cannot be imported ({reason})") from error
        missing = [attribute for attribute in self.needs if not hasattr(member, attribute)]
        if missing:
            raise SurefootError(f"{_what(point)}: lacks {', '.join(missing)}")
        try:
            self.check(name, member)
        except SurefootError as error:
            raise SurefootError(f"{_what(point)}: {error}") from None
        return member

    def usable(self) -> tuple[dict[str, Any], dict[str, str]]:
        """Name -> member of those that can be used, and name -> what is wrong with any other."""
        members, broken = {}, {}
        for name in self:
            try:
                members[name] = self[name]
            except SurefootError as error:
                broken[name] = str(error)
        return members, broken


@cache
def plugins(group: str) -> dict[str, tuple[EntryPoint, ...]]:
    """Name -> entry points of what users add to `group`, sorted by name, nothing imported yet.

    More than one where packages disagree on what the name means.
    """
    for file in filter(None, os.environ.get(FILES, "").split(os.pathsep)):
        if file not in _LOADED:
            load_plugin(file)
    found: dict[str, dict[str, EntryPoint]] = {}
    points = [*entry_points(group=group), *_OF_FILES.get(group, ())]
    for point in sorted(points, key=lambda point: (point.name, point.value)):
        found.setdefault(point.name, {})[point.value] = point
    return {name: tuple(points.values()) for name, points in found.items()}


FILES = "SUREFOOT_PLUGINS"
"""Environment variable: plugin files that every process loads, between os.pathsep."""
_LOADED: set[str] = set()
_OF_FILES: dict[str, list[EntryPoint]] = {}
"""Group -> entry points of the files that this process was given."""
PLUGIN_GROUPS = tuple(
    f"surefoot.{kind}"
    for kind in ("estimators", "effects", "channels", "architectures", "calibrators", "gaits")
)


def load_plugin(file: str | Path) -> None:
    """Run a Python file of the user's and list what its PLUGINS name.

    Only a person names such a file: nothing that is read from a log, a scenario or a map does.
    Raises SurefootError where it cannot be run, or offers nothing.
    """
    path = Path(file)
    if not is_file(path) or path.suffix != ".py":
        raise SurefootError(f"--plugin {file}: no such Python file")
    module_name = f"surefoot_plugin_{path.stem}"
    spec = spec_from_file_location(module_name, path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[module_name] = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever a file of a user's own raises
        reason = f"{type(error).__name__}: {error}"
        raise SurefootError(f"--plugin {file}: cannot be run ({reason})") from error
    offered = getattr(module, "PLUGINS", None)
    if not isinstance(offered, dict) or not offered:
        raise SurefootError(f'--plugin {file}: needs PLUGINS = {{"surefoot.estimators": {{...}}}}')
    for group, members in offered.items():
        if group not in PLUGIN_GROUPS:
            raise SurefootError(
                f"--plugin {file}: no group '{group}'; known: {', '.join(PLUGIN_GROUPS)}"
            )
        for name, member in members.items():
            value = f"{module_name}:{member.__qualname__}"
            _OF_FILES.setdefault(group, []).append(EntryPoint(name, value, group))
    _LOADED.add(str(path.resolve()))
    # Workers of this process are given the same files.
    os.environ[FILES] = os.pathsep.join(sorted(_LOADED))
    plugins.cache_clear()


def with_plugins(arguments: Sequence[str]) -> list[str]:
    """The arguments of a command without `--plugin FILE`, whose files are loaded."""
    others, rest = [], iter(arguments)
    for one in rest:
        if one == "--plugin" or one.startswith("--plugin="):
            load_plugin(one.partition("=")[2] or next(rest, ""))
        else:
            others.append(one)
    return others


def _what(point: EntryPoint) -> str:
    return f"plugin {point.name} = {point.value} ({point.group})"
