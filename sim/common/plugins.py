"""What users add in packages of their own, found by the entry points of installed distributions.

A package offers one by a line of its metadata, in pyproject.toml

    [project.entry-points."surefoot.effects"]
    tilt = "my_package:Tilt"

and from then on it stands in every list beside those that come with surefoot.
"""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from surefoot.sim.common.errors import SurefootError


@cache
def plugins(group: str) -> dict[str, EntryPoint]:
    """Name -> entry point of what users add to `group`, sorted by name, nothing imported yet.

    Raises SurefootError where two packages use one name.
    """
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        other = found.setdefault(point.name, point)
        if other.value != point.value:
            raise SurefootError(
                f"plugin {point.name} ({group}): is both {other.value} and {point.value}"
            )
    return found


def plugin_names(group: str, bundled: Mapping[str, Any] | None = None) -> tuple[str, ...]:
    """Names of a group's members, the bundled ones first: nothing is imported to list them."""
    return (*(bundled or {}), *plugins(group))


def load_plugins(
    group: str, bundled: Mapping[str, Any] | None = None, needs: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Name -> object of all members of a group: the bundled ones, then those that users add.

    Args:
        group: of entry points, such as "surefoot.effects".
        bundled: name -> object of those that come with surefoot.
        needs: attributes that each object added must have.

    Raises SurefootError, one line that names the plugin, where one cannot be imported, lacks an
    attribute, or bears the name of another.
    """
    found: dict[str, Any] = dict(bundled or {})
    for name, point in plugins(group).items():
        what = f"plugin {name} = {point.value} ({group})"
        if name in found:
            raise SurefootError(f"{what}: surefoot has one of that name; choose another")
        try:
            found[name] = point.load()
        except Exception as error:  # whatever a module of a user's own raises
            raise SurefootError(
                f"{what}: cannot be imported ({type(error).__name__}: {error})"
            ) from error
        missing = [attribute for attribute in needs if not hasattr(found[name], attribute)]
        if missing:
            raise SurefootError(f"{what}: lacks {', '.join(missing)}")
    return found
