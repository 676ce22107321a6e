"""Mutants of sources, and those that a plan draws: small changes that a test should notice.

    sign        + for -, * for /, and the reverse; a minus or a `not` left out
    constant    a float by a tenth, a whole number by one
    comparison  the opposite one, `and` for `or`; where whole numbers are compared, < for <=
    swap        the first two arguments of a call
    left out    a statement, or a guard that raises, returns, breaks or continues

Text is replaced where the syntax tree says, so that all else stays as it is written. Left alone is
what cannot change a number: annotations, decorators, docstrings, and the words of errors.
"""

import ast
import hashlib
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from surefoot.sim.common.toml import read_typed

PLAN = Path(__file__).resolve().parent / "plan.toml"
SIGNS = {ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*")}
OPPOSITE = {
    ast.Lt: ("<", ">="),
    ast.GtE: (">=", "<"),
    ast.Gt: (">", "<="),
    ast.LtE: ("<=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}
BOUNDARY = {"<": "<=", "<=": "<", ">": ">=", ">=": ">"}
SYMMETRIC = {"min", "max", "minimum", "maximum", "hypot", "isinstance", "getattr", "zip", "print"}
"""Calls whose arguments may be swapped without a change, or with an error at once."""
SKIPPED = (ast.JoinedStr, ast.Raise, ast.Assert, ast.Import, ast.ImportFrom)
LEAVING = (ast.Raise, ast.Return, ast.Break, ast.Continue)
MODULE = "<module>"


@dataclass(frozen=True)
class Plan:
    """Fields as `plan.toml` explains them."""

    seed: int
    mutants: int
    each: int
    files: list[str]
    tests: list[str]
    nearest: int
    longest_test: float
    longest_file: float
    budget: float
    patience: float
    grace: float
    memory: int


def read_plan() -> Plan:
    return read_typed(PLAN, Plan, "plan")


@dataclass(frozen=True)
class Mutant:
    """One change of a file: bytes `start` to `end` become `after`.

    scope is the function that it lies in by its qualified name, MODULE outside of any; key stays
    the same while other lines of the file change.
    """

    file: str
    line: int
    scope: str
    kind: str
    before: str
    after: str
    start: int
    end: int
    key: str

    def apply(self, source: bytes) -> bytes:
        return source[: self.start] + self.after.encode() + source[self.end :]

    def lines(self, source: bytes) -> tuple[str, str]:
        """The line that begins the change, before and after it."""
        first = source.rfind(b"\n", 0, self.start) + 1
        changed = self.apply(source)
        before, after = (t[first:].decode().partition("\n")[0].strip() for t in (source, changed))
        return before, after


def mutants_of(file: str, source: bytes) -> list[Mutant]:
    """Every mutant of a source, in its order."""
    text = _Text(source)
    seen: Counter[str] = Counter()
    found = []
    for scope, kind, start, end, after in sorted(
        _changes(ast.parse(source), text, MODULE), key=lambda change: change[2:]
    ):
        before = source[start:end].decode()
        name = "|".join((file, scope, kind, before, after))
        seen[name] += 1
        key = hashlib.sha256(f"{name}|{seen[name]}".encode()).hexdigest()[:12]
        line = source.count(b"\n", 0, start) + 1
        found.append(Mutant(file, line, scope, kind, before, after, start, end, key))
    return found


def drawn(plan: Plan, root: Path) -> list[Mutant]:
    """The mutants of a plan, in turns over the files, so that the first of them are a fair sample
    of all: each file by its share, none sooner by its name or size.

    A mutant is drawn by the digest of the seed and its key, so that a line that changes redraws
    no other.
    """
    files = sorted({path for pattern in plan.files for path in root.glob(pattern)})
    ranked: dict[str, list[Mutant]] = {}
    for path in files:
        name = path.relative_to(root).as_posix()
        every = mutants_of(name, path.read_bytes())
        if every:
            ranked[name] = sorted(every, key=lambda mutant: _rank(plan.seed, mutant))
    shares = quotas({name: len(every) for name, every in ranked.items()}, plan.mutants, plan.each)
    turns = [
        (
            (place + int(_rank(plan.seed, mutant)[-8:], 16) / 16**8) / shares[name],
            mutant.key,
            mutant,
        )
        for name, every in ranked.items()
        for place, mutant in enumerate(every[: shares[name]])
    ]
    return [mutant for *_, mutant in sorted(turns, key=lambda turn: turn[:2])]


def quotas(counts: dict[str, int], total: int, each: int) -> dict[str, int]:
    """How many of each file: `each`, and of what is left a share by its count, largest
    remainders first."""
    total = min(total, sum(counts.values()))
    shares = {name: min(each, count) for name, count in counts.items()}
    left = total - sum(shares.values())
    spare = {name: counts[name] - shares[name] for name in counts}
    exact = {name: left * n / max(sum(spare.values()), 1) for name, n in spare.items()}
    shares = {name: shares[name] + int(exact[name]) for name in counts}
    rest = sorted(counts, key=lambda name: (int(exact[name]) - exact[name], name))
    for name in rest[: total - sum(shares.values())]:
        shares[name] += 1
    return shares


def _rank(seed: int, mutant: Mutant) -> str:
    return hashlib.sha256(f"{seed}|{mutant.key}".encode()).hexdigest()


class _Text:
    """Bytes of a source by line and column, as the syntax tree counts them."""

    def __init__(self, source: bytes):
        self.source = source
        self.starts = [0]
        for line in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))

    def span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return (
            self.starts[node.lineno - 1] + node.col_offset,
            self.starts[node.end_lineno - 1] + node.end_col_offset,
        )

    def of(self, node: ast.expr | ast.stmt) -> str:
        start, end = self.span(node)
        return self.source[start:end].decode()

    def between(self, left: ast.expr, right: ast.expr, word: str) -> tuple[int, int] | None:
        """Where an operator stands between its operands; None beside a comment."""
        start, end = self.span(left)[1], self.span(right)[0]
        gap = self.source[start:end].decode()
        pattern = r"\s+".join(map(re.escape, word.split()))
        match = re.search(rf"\b{pattern}\b" if word[0].isalpha() else pattern, gap)
        if match is None or "#" in gap:
            return None
        return start + match.start(), start + match.end()


_Change = tuple[str, str, int, int, str]


def _changes(
    node: ast.AST, text: _Text, scope: str, assigned: Counter | None = None
) -> Iterator[_Change]:
    """All changes below a node."""
    for child in _mutable_children(node):
        inner = scope
        names = assigned
        if isinstance(child, ast.FunctionDef | ast.ClassDef):
            outer = "" if scope == MODULE else scope + "."
            inner = outer + child.name
            if isinstance(child, ast.FunctionDef):
                names = Counter()
                if isinstance(node, ast.FunctionDef):
                    inner = f"{scope}.<locals>.{child.name}"
        function = names is not None
        for kind, start, end, after in _own_changes(child, node, text, names):
            yield (inner if function else MODULE), kind, start, end, after
        yield from _changes(child, text, inner, names)


def _mutable_children(node: ast.AST) -> Iterator[ast.AST]:
    """Children but annotations, decorators, docstrings and words of errors."""
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params", "bases"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, SKIPPED):
                continue
            if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
                continue
            yield child


def _own_changes(
    node: ast.AST, parent: ast.AST, text: _Text, assigned: Counter | None
) -> Iterator[tuple[str, int, int, str]]:
    if isinstance(node, ast.BinOp) and type(node.op) in SIGNS:
        word, other = SIGNS[type(node.op)]
        place = text.between(node.left, node.right, word)
        if place and not any(map(_textual, (node.left, node.right))):
            yield "sign", *place, other
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        start, end = text.span(node)
        word = "-" if isinstance(node.op, ast.USub) else "not"
        yield "sign", start, end, text.of(node)[len(word) :].lstrip()
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield from _constant(node, parent, text)
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        yield from _comparison(node, text)
    if isinstance(node, ast.BoolOp):
        word = "and" if isinstance(node.op, ast.And) else "or"
        place = text.between(node.values[0], node.values[1], word)
        if place:
            yield "comparison", *place, "or" if word == "and" else "and"
    if isinstance(node, ast.Call) and len(node.args) > 1:
        yield from _swap(node, text)
    if assigned is not None and isinstance(node, ast.stmt) and _can_go(node, assigned):
        yield "left out", *text.span(node), "pass"


def _textual(node: ast.expr) -> bool:
    """Whether + and / of it are of text, lists or paths, where another sign is an error at once."""
    if isinstance(node, ast.BinOp):
        return _textual(node.left) or _textual(node.right)
    if isinstance(node, ast.Constant):
        return isinstance(node.value, str | bytes)
    return isinstance(node, ast.JoinedStr | ast.List | ast.ListComp | ast.Tuple)


def _constant(node: ast.Constant, parent: ast.AST, text: _Text):
    if isinstance(parent, ast.Subscript | ast.Slice | ast.Tuple):
        return  # an index or a shape: another is an error at once
    if isinstance(parent, ast.keyword) and parent.arg in ("axis", "ndmin", "limit", "version"):
        return
    start, end = text.span(node)
    if isinstance(node.value, float):
        yield "constant", start, end, repr(float(f"{node.value * 1.1:.12g}") or 0.1)
    elif isinstance(node.value, int):
        yield "constant", start, end, str(node.value + 1)


def _comparison(node: ast.Compare, text: _Text):
    word, other = OPPOSITE[type(node.ops[0])]
    place = text.between(node.left, node.comparators[0], word)
    if place is None:
        return
    yield "comparison", *place, other
    if word in BOUNDARY and any(map(_whole, (node.left, node.comparators[0]))):
        yield "comparison", *place, BOUNDARY[word]


def _whole(node: ast.expr) -> bool:
    """Whether an expression is seen to be a whole number."""
    if isinstance(node, ast.Constant):
        return type(node.value) is int and node.value != 0
    called = isinstance(node, ast.Call) and ast.unparse(node.func) == "len"
    return called or (isinstance(node, ast.Attribute) and node.attr in ("size", "ndim"))


def _swap(node: ast.Call, text: _Text):
    name = node.func.attr if isinstance(node.func, ast.Attribute) else text.of(node.func)
    first, second = node.args[:2]
    if name in SYMMETRIC or any(isinstance(a, ast.Starred | ast.Constant) for a in node.args[:2]):
        return
    (start, a), (b, end) = text.span(first), text.span(second)
    # Its own parentheses are no part of an expression, so that a generator is left alone.
    if text.of(first) != text.of(second) and not isinstance(second, ast.GeneratorExp):
        gap = text.source[a:b].decode()
        if gap.strip() == ",":
            yield "swap", start, end, text.of(second) + gap + text.of(first)


def _can_go(node: ast.stmt, assigned: Counter) -> bool:
    """Whether a statement can be left out without an error of names at once."""
    if isinstance(node, ast.Assign):
        if not all(isinstance(t, ast.Name) for t in node.targets):
            return all(isinstance(t, ast.Subscript | ast.Attribute) for t in node.targets)
        names = [t.id for t in node.targets if isinstance(t, ast.Name)]
        again = all(assigned[name] for name in names)
        assigned.update(names)
        return again
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Call)
    if isinstance(node, ast.If):
        return not node.orelse and len(node.body) == 1 and isinstance(node.body[0], LEAVING)
    return isinstance(node, ast.AugAssign | ast.Break | ast.Continue)
