"""Pages that list every key of a TOML file, made from the dataclasses that read it."""

import ast
import inspect
import re
import textwrap
from collections.abc import Sequence
from dataclasses import is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

_WORDS = {str: "text", float: "number", int: "whole number", bool: "true or false"}
_MOST = 2.0**53  # a limit of numbers themselves, which goes without saying
_BOUNDS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


def keys_page(title: str, words: str, sections: Sequence[tuple[str, type]]) -> str:
    """A page with a table for each section: its name and the dataclass that reads it."""
    parts = [f"# {title}", textwrap.dedent(words).strip()]
    for name, kind in sections:
        parts.append(f"## {name}")
        parts.append(_plain(inspect.getdoc(kind) or ""))
        rows = [
            f"| `{key}` | {kind} | {default} | {says} |" for key, kind, default, says in keys(kind)
        ]
        parts.append(
            "\n".join(["| key | value | left out | meaning |", "| --- | --- | --- | --- |", *rows])
        )
    return "\n\n".join(parts) + "\n"


def keys(kind: type) -> list[tuple[str, str, str, str]]:
    """Key, value, what holds where it is left out, and meaning of each field of a dataclass, the
    inherited ones last. The meaning is the text below a field, or the comment behind it."""
    source = textwrap.dedent(inspect.getsource(kind))
    lines = source.splitlines()
    (node,) = ast.parse(source).body
    assert isinstance(node, ast.ClassDef)
    found, kinds = [], get_type_hints(kind, include_extras=True)
    for field, after in zip(node.body, [*node.body[1:], None], strict=True):
        if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
            continue
        comment = lines[field.end_lineno - 1].partition("  # ")[2] if field.end_lineno else ""
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            comment = " ".join(str(after.value.value).split())
        if "bumps" in field.target.id or "ClassVar" in ast.unparse(field.annotation):
            continue
        default = "required" if field.value is None else _default(ast.unparse(field.value))
        value = _value(kinds[field.target.id])
        found.append((field.target.id, value, default, _plain(comment)))
    for base in kind.__bases__:
        if hasattr(base, "__dataclass_fields__"):
            own = {key for key, *_ in found}
            found += [row for row in keys(base) if row[0] not in own]
    return found


def _value(kind: Any) -> str:
    """What a file may have for a type, in words."""
    origin, parts = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _bounded(*parts)
    if origin is Literal:
        return ", ".join(f"`{choice}`" for choice in parts)
    if origin in (Union, UnionType):
        return " or ".join(_value(part) for part in parts if part is not NoneType)
    if origin is tuple:
        each = _value(parts[0]).replace("table", "tables")
        return f"array of {each}" if ... in parts else f"{len(parts)} numbers"
    if origin is dict and not is_dataclass(parts[1]):
        return f"table of {_value(parts[1])}"
    return _WORDS.get(kind, "table")


def _bounded(kind: type, limits: msgspec.Meta) -> str:
    if limits.pattern and not re.search(limits.pattern, "ab"):
        return "one character"
    named = {sign: getattr(limits, name) for name, sign in _BOUNDS.items()}
    words = [f"{sign} {x:.10g}" for sign, x in named.items() if x is not None and abs(x) < _MOST]
    return f"{_value(kind)} {' and '.join(words)}".strip()


def _default(value: str) -> str:
    if value in ("None", "()", "{}") or value.startswith("field(") or value.isupper():
        return "–"
    for ours, theirs in (("True", "true"), ("False", "false"), ("(", "["), (")", "]"), ("'", '"')):
        value = value.replace(ours, theirs)
    return f"`{value}`"


def _plain(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")
