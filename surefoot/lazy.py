"""Names of a module that are imported when they are first used."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(
    module: dict[str, Any], homes: Mapping[str, tuple[str, ...]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a module.

    Args:
        module: its globals.
        homes: module below `surefoot` -> names that it has; "name as other" renames one.
    """
    found = {
        words.rpartition(" ")[2]: (home, words.partition(" ")[0])
        for home, names in homes.items()
        for words in names
    }

    def getattribute(name: str) -> Any:
        if name not in found:
            raise AttributeError(f"module '{module['__name__']}' has no attribute {name!r}")
        home, attribute = found[name]
        value = module[name] = getattr(import_module(f"surefoot.{home}"), attribute)
        return value

    return getattribute, lambda: sorted({*module, *found})
