"""Names of a module that are imported when they are first used."""

import ast
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any


def lazy_names(module: dict[str, Any]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a module for the names that it imports for type checkers, in
    an `if TYPE_CHECKING:` at its top level; they are its `__all__` too.

    Args:
        module: its globals.
    """
    name_of_module = module["__name__"]

    @cache
    def homes() -> dict[str, tuple[str, str]]:
        """Name -> module and attribute."""
        tree = ast.parse(module["__loader__"].get_source(name_of_module))
        return {
            alias.asname or alias.name: (node.module or "", alias.name)
            for block in tree.body
            if isinstance(block, ast.If)
            for node in block.body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }

    def getattribute(name: str) -> Any:
        if name == "__all__":  # of `from ... import *`
            return sorted(homes())
        # Python itself asks for names such as __path__.
        if name.startswith("__") or name not in homes():
            raise AttributeError(f"module {name_of_module!r} has no attribute {name!r}")
        home, attribute = homes()[name]
        value = module[name] = getattr(import_module(home), attribute)
        return value

    return getattribute, lambda: sorted({*module, *homes()})
