"""Plug-ins: classes of users, found by the entry points of installed packages.

A package offers a plug-in by a line in its pyproject.toml,

    [project.entry-points."surefoot.effects"]
    tilt = "my_package:Tilt"

and from then on it appears in every list, like the bundled ones. A single file offers plug-ins for
one run, `surefoot --plugin FILE.py ...`, by a dictionary of groups:

    PLUGINS = {"surefoot.effects": {"tilt": Tilt}}
"""

import os
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import module_from_spec, spec_from_file_location
from inspect import getfile, getsourcelines
from pathlib import Path
from shlex import join
from typing import Any

from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.common.files import is_file


class Registry(Mapping[str, Any]):
    """Name -> member of a group: the bundled ones, then the plug-ins.

    Names are listed without importing. A member is imported when it is looked up, so a broken
    plug-in affects only those who use it.
    """

    def __init__(
        self,
        group: str,
        bundled: dict[str, Any],
        needs: tuple[str, ...] = (),
        check: Callable[[Any], None] = lambda member: None,
    ):
        """Define a group.

        Args:
            group: of entry points, such as "surefoot.effects".
            bundled: name -> bundled member, or its "module:attribute".
            needs: attributes that each plug-in must have.
            check: raises SurefootError for an invalid plug-in.
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

        Raises KeyError if there is none. Raises SurefootError, in one line that names the plug-in,
        if it cannot be imported, lacks an attribute, calls itself differently, fails the check, or
        has the name of another member.
        """
        points = plugins(self.group).get(name, ())
        if name in self.bundled:
            if points:
                raise SurefootError(f"{_what(points[0])}: surefoot has one of that name")
            member = self.bundled[name]
            return _imported(member) if type(member) is str else member
        if not points:
            raise KeyError(name)
        point, *others = points
        if others:
            raise SurefootError(f"{_what(point)}: {others[0].value} has that name too")
        with of_plugin(f"{_what(point)}: cannot be imported"):
            member = point.load()
        with errors_in(_what(point)), of_plugin("it is not valid", (point,)):
            self.check_member(name, member)
        _IN_USE[point.value] = point
        return member

    def check_member(self, name: str, member: Any) -> None:
        """Raise SurefootError where a member is not valid, or calls itself differently."""
        if not isinstance(member, type):
            raise SurefootError(f"must be a class, is {member!r:.60}")
        missing = [attribute for attribute in self.needs if not hasattr(member, attribute)]
        if missing:
            raise SurefootError(f"lacks {', '.join(missing)}")
        if "name" in self.needs and member.name != name:
            raise SurefootError(f"its class calls itself {member.name}")
        self.check(member)

    def running(self, name: str) -> AbstractContextManager[None]:
        """Context in which code of that member runs (`naming_plugins`); a bundled one's is our
        own.
        """
        points = plugins(self.group).get(name)
        return naming_plugins(points) if points else nullcontext()

    def usable(self) -> tuple[dict[str, Any], dict[str, str]]:
        """Name -> member, of those that can be used, and name -> reason, of the others."""
        members, broken = {}, {}
        for name in self:
            try:
                members[name] = self[name]
            except SurefootError as error:
                broken[name] = str(error)
        return members, broken


@cache
def _imported(member: str) -> Any:
    """A bundled "module:attribute"."""
    return EntryPoint("", member, "").load()


@contextmanager
def of_plugin(what: str, points: Sequence[EntryPoint] = ()) -> Iterator[None]:
    """Context in which code of a user's own is loaded: whatever else than a SurefootError it
    raises, or an exit, becomes one, in a line that starts with `what` and names the place in these
    plug-ins, else where it was raised.
    """
    try:
        with exits_raised():
            yield
    except (SurefootError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise SurefootError(f"{what} {_reason(error, points)}") from error


@contextmanager
def naming_plugins(points: Sequence[EntryPoint] = ()) -> Iterator[None]:
    """Context in which plug-ins run, by default those in use: an error or exit in their code
    becomes a SurefootError that names them and the place. So does surefoot's own error, since a
    plug-in may have returned what is invalid; a SurefootError names them too.
    """
    try:
        yield
    except (BrokenPipeError, KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:
        among = points or tuple(_IN_USE.values())
        raised_in = {package for package, *_ in _places(error)}
        named = [point for point in among if _package(point.module) in raised_in]
        names = ", ".join(map(_what, named or among))
        if isinstance(error, SurefootError):
            if not names or names in str(error):
                raise
            raise SurefootError(f"{error} (with {names})") from error
        what = "failed"
        if not named and not isinstance(error, SystemExit | OSError | MemoryError | ImportError):
            named, what = among, "may have returned something invalid"
        if not named:
            raise
        raise SurefootError(f"{names}: {what} {_reason(error, named)}") from error


@contextmanager
def exits_raised() -> Iterator[None]:
    """Context in which `os._exit`, which would end the process without a word, exits like
    `sys.exit`, so that an exit in code of a plug-in is an error that names it.
    """
    before = os._exit
    os._exit = sys.exit
    try:
        yield
    finally:
        os._exit = before


def _reason(error: BaseException, points: Sequence[EntryPoint]) -> str:
    """What was raised and where: in the innermost frame in a package of these plug-ins; without
    one, where surefoot could not use what the first of them returned, and where its class is.
    """
    places, packages = _places(error), {_package(point.module) for point in points}
    of_packages = [place for place in places if place[0] in packages]
    _, file, line = (of_packages or places)[-1]
    where = f"{file}, line {line}"
    if points and not of_packages:
        with suppress(TypeError, OSError):  # no Python source
            kind = points[0].load()
            of_class = f"{Path(getfile(kind)).name}, line {getsourcelines(kind)[1]}"
            where += f", with {points[0].attr} of {of_class}"
    return f"({type(error).__name__}: {error}; {where})"


def _places(error: BaseException) -> list[tuple[str, str, int]]:
    """Package, file and line of each frame of a traceback, the innermost last."""
    return [
        (_package(str(frame.f_globals.get("__name__"))), Path(frame.f_code.co_filename).name, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
    ]


def _package(module: str) -> str:
    return module.partition(".")[0]


@cache
def plugins(group: str) -> dict[str, tuple[EntryPoint, ...]]:
    """Name -> entry points of the plug-ins in `group`, sorted by name, without importing them.

    There is more than one if packages use the same name.
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
"""Environment variable: plug-in files that every process loads, separated by os.pathsep."""
_LOADED: dict[str, str] = {}
"""Path of each plug-in file of this process -> the file as it was given."""
_IN_USE: dict[str, EntryPoint] = {}
"""Value -> entry point of the plug-ins that were looked up."""
_OF_FILES: dict[str, list[EntryPoint]] = {}
"""Group -> entry points from the plug-in files of this process."""
PLUGIN_GROUPS = tuple(
    f"surefoot.{kind}"
    for kind in ("estimators", "effects", "channels", "architectures", "calibrators", "gaits")
)


def load_plugin(file: str | Path) -> None:
    """Run a user's Python file and register the members of its PLUGINS.

    Only users name such files; logs, scenarios and maps cannot. Raises SurefootError if the file
    cannot be run or has no plug-ins.
    """
    path = Path(file)
    if not is_file(path) or path.suffix != ".py":
        raise SurefootError(f"--plugin {file}: no such Python file")
    module_name = f"surefoot_plugin_{path.stem}"
    spec = spec_from_file_location(module_name, path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[module_name] = module_from_spec(spec)
    with of_plugin(f"--plugin {file}: cannot be run"):
        spec.loader.exec_module(module)
    with errors_in(f"--plugin {file}"):
        _register(module_name, getattr(module, "PLUGINS", None))
    _LOADED[str(path.resolve())] = str(file)
    # Workers of this process are given the same files.
    os.environ[FILES] = os.pathsep.join(sorted(_LOADED))
    plugins.cache_clear()


def _register(module: str, offered: Any) -> None:
    """Register what a plug-in file offers. Raises SurefootError for what cannot be one."""
    if not isinstance(offered, dict) or not offered:
        raise SurefootError('needs PLUGINS = {"surefoot.estimators": {...}}')
    for group, members in offered.items():
        if group not in PLUGIN_GROUPS:
            raise SurefootError(f"no group '{group}'; known: {', '.join(PLUGIN_GROUPS)}")
        if not isinstance(members, dict):
            raise SurefootError(f"{group} must be a dict of classes by name")
        for name, member in members.items():
            if not (isinstance(name, str) and re.fullmatch(r"\w[\w.-]*", name)):
                raise SurefootError(f"{group}: {name!r} is no name")
            if not isinstance(member, type):
                raise SurefootError(f"{name} must be a class, is {member!r:.60}")
            value = f"{module}:{member.__qualname__}"
            _OF_FILES.setdefault(group, []).append(EntryPoint(name, value, group))


def with_plugins(arguments: Sequence[str]) -> list[str]:
    """Load the files of `--plugin FILE` options, and return the other arguments."""
    others, rest = [], iter(arguments)
    for one in rest:
        if one == "--plugin" or one.startswith("--plugin="):
            load_plugin(one.partition("=")[2] or next(rest, ""))
        else:
            others.append(one)
    return others


def next_command(name: str, *arguments: str | Path) -> str:
    """A command that continues this one, quoted for a shell, with the same plug-in files."""
    files = [word for file in _LOADED.values() for word in ("--plugin", file)]
    return join(["surefoot", name, *map(str, arguments), *files])


def _what(point: EntryPoint) -> str:
    return f"plugin {point.name} = {point.value} ({point.group})"
