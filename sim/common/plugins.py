"""What users add in packages of their own, found by the entry points of installed distributions.

A package offers one by a line of its metadata, in pyproject.toml

    [project.entry-points."surefoot.effects"]
    tilt = "my_package:Tilt"

and from then on it stands in every list beside those that come with surefoot.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from surefoot.sim.common.errors import SurefootError


class Registry(Mapping[str, Any]):
    """Name -> member of a group: those that come with surefoot, then those that users add.

    Names are listed without an import; a member is imported when it is looked up, so that one that
    is broken stops only what uses it.
    """

    def __init__(self, group: str, bundled: Mapping[str, Any], needs: tuple[str, ...] = ()):
        """What a group holds.

        Args:
            group: of entry points, such as "surefoot.effects".
            bundled: name -> member that comes with surefoot, or "module:attribute" of it.
            needs: attributes that each member added must have.
        """
        self.group, self.bundled, self.needs = group, bundled, needs

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self.bundled, *plugins(self.group))))

    def __len__(self) -> int:
        return len(self.bundled.keys() | plugins(self.group).keys())

    def __contains__(self, name: object) -> bool:
        return name in self.bundled or name in plugins(self.group)

    def __getitem__(self, name: str) -> Any:
        """The member of that name.

        Raises KeyError where there is none, and SurefootError, one line that names the plugin,
        where it cannot be imported, lacks an attribute, or bears the name of another.
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
        return member


def load_plugins(
    group: str, bundled: Mapping[str, Any] | None = None, needs: tuple[str, ...] = ()
) -> dict[str, Any]:
    """All members of a group, imported: arguments and errors as of `Registry`."""
    return dict(Registry(group, bundled or {}, needs))


@cache
def plugins(group: str) -> dict[str, tuple[EntryPoint, ...]]:
    """Name -> entry points of what users add to `group`, sorted by name, nothing imported yet.

    More than one where packages disagree on what the name means.
    """
    found: dict[str, dict[str, EntryPoint]] = {}
    for point in sorted(entry_points(group=group), key=lambda point: (point.name, point.value)):
        found.setdefault(point.name, {})[point.value] = point
    return {name: tuple(points.values()) for name, points in found.items()}


def _what(point: EntryPoint) -> str:
    return f"plugin {point.name} = {point.value} ({point.group})"
