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

    Names are listed without an import; a member is imported when it is first looked up, so that one
    that is broken stops only what uses it.
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
        yield from self.bundled
        for name, point in plugins(self.group).items():
            if name in self.bundled:
                raise SurefootError(f"{_what(point)}: surefoot has one of that name")
            yield name

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return any(name == one for one in self)

    def __getitem__(self, name: str) -> Any:
        """The member of that name.

        Raises KeyError where there is none, and SurefootError, one line that names the plugin,
        where it cannot be imported, lacks an attribute, or bears the name of another.
        """
        if name not in self:
            raise KeyError(name)
        if name in self.bundled:
            member = self.bundled[name]
            return EntryPoint(name, member, self.group).load() if type(member) is str else member
        point = plugins(self.group)[name]
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
def plugins(group: str) -> dict[str, EntryPoint]:
    """Name -> entry point of what users add to `group`, sorted by name, nothing imported yet.

    Raises SurefootError where two packages use one name.
    """
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        other = found.setdefault(point.name, point)
        if other.value != point.value:
            raise SurefootError(f"{_what(point)}: {other.value} has that name too")
    return found


def _what(point: EntryPoint) -> str:
    return f"plugin {point.name} = {point.value} ({point.group})"
