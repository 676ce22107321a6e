"""Pages that list every key of a TOML file, made from the dataclasses that read it."""

import ast
import inspect
import re
import textwrap
from collections.abc import Sequence

_WORDS = {
    "Annotated[int, msgspec.Meta(ge=0)]": "whole number >= 0",
    "NonNegativeCount": "whole number >= 0",
    "Count": "whole number >= 1",
    "NonNegative": "number >= 0",
    "Positive": "number > 0",
    "Length": "number > 0",
    "Speed": "number",
    "Role": "text",
    "FileName": "text",
    "Friction": "number",
    "OneCharacter": "one character",
    "Name": "text",
    "str": "text",
    "float": "number",
    "int": "whole number",
    "bool": "true or false",
    "Entries": "columns",
    "ColumnEntry": "column",
}


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
    found = []
    for field, after in zip(node.body, [*node.body[1:], None], strict=True):
        if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
            continue
        comment = lines[field.end_lineno - 1].partition("  # ")[2] if field.end_lineno else ""
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            comment = " ".join(str(after.value.value).split())
        if "bumps" in field.target.id or "ClassVar" in ast.unparse(field.annotation):
            continue
        default = "required" if field.value is None else _default(ast.unparse(field.value))
        found.append(
            (field.target.id, _value(ast.unparse(field.annotation)), default, _plain(comment))
        )
    for base in kind.__bases__:
        if hasattr(base, "__dataclass_fields__"):
            own = {key for key, *_ in found}
            found += [row for row in keys(base) if row[0] not in own]
    return found


def _value(annotation: str) -> str:
    text = annotation.replace(" | None", "")
    if text.startswith("Literal"):
        return ", ".join(f"`{choice}`" for choice in re.findall(r"'([^']*)'", text))
    array = re.match(r"tuple\[(.*), \.\.\.\]$", text)
    if array:
        inner = _value(array[1].strip("'\""))
        return "array of tables" if inner.startswith(("_", "table")) else f"array of {inner}"
    if text.startswith("tuple["):
        return f"{text.count(',') + 1} numbers"
    for name, word in _WORDS.items():
        text = re.sub(rf"(?<![A-Za-z]){re.escape(name)}(?![A-Za-z])", word, text)
    text = re.sub(r"dict\[text, ([^\]]*)\]", r"table of \1", text).replace(" | ", " or ")
    return "table" if re.fullmatch(r"_?[A-Z]\w*|table of [A-Z]\w*", text) else text


def _default(value: str) -> str:
    if value in ("None", "()", "{}") or value.startswith("field(") or value.isupper():
        return "–"
    for ours, theirs in (("True", "true"), ("False", "false"), ("(", "["), (")", "]"), ("'", '"')):
        value = value.replace(ours, theirs)
    return f"`{value}`"


def _plain(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")
