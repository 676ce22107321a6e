"""The error for bad input, and the check of whole numbers."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from math import inf
from pathlib import Path

LARGEST_WHOLE = 2**53
"""Whole number up to which a float is exact."""


class SurefootError(ValueError):
    """Bad input: a message of one line that names the file, column or option at fault."""


@contextmanager
def errors_in(where: str) -> Iterator[None]:
    """Context whose SurefootErrors begin with the file, table or part that they are about."""
    try:
        yield
    except SurefootError as error:
        raise SurefootError(f"{where}: {error}") from None


@contextmanager
def parsed_as(what: str, path: Path, remedy: str = "") -> Iterator[None]:
    """Raise SurefootError, in one line, for whatever a parser raises on a broken file."""
    try:
        yield
    except SurefootError as error:
        raise SurefootError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        raise SurefootError(
            f"{path}: not {what} ({type(error).__name__}: {reason}){remedy}"
        ) from error


def check_seed(seed: int) -> None:
    """Raise SurefootError for a seed that generators do not accept."""
    if seed < 0:
        raise SurefootError(f"seed {seed}: must not be negative")
    if seed > LARGEST_WHOLE:
        raise SurefootError("seed: must not be beyond 2^53")


def check_within(
    values: Mapping[str, float], ranges: Mapping[str, tuple[float, float]], most: float = inf
) -> None:
    """Raise SurefootError for a value outside the range of its name or, without one, outside 0 to
    `most`.
    """
    for name, value in values.items():
        low, high = ranges.get(name, (0.0, most))
        if not low <= value <= high:
            raise SurefootError(f"{name} must lie between {low:g} and {high:g}, is {value:g}")


def check_known(
    what: str, name: object, known: Collection[str], error: type[SurefootError] = SurefootError
) -> None:
    """Raise `error` with the text of `unknown` for a name that is not among those known."""
    if name not in known:
        raise error(unknown(what, name, known))


def unknown(what: str, name: object, known: Iterable[str]) -> str:
    """`unknown effect 'wings'; known: ...`, with a similar name if there is one."""
    names = list(known)
    return f"unknown {what} '{name}'; known: {', '.join(names)}{did_you_mean(name, names)}"


def shortened(text: str, most: int = 100) -> str:
    """A text of at most about `most` characters, without the middle of a longer one."""
    return text if len(text) <= most else f"{text[: most * 2 // 3]}...{text[-most // 6 :]}"


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """`; did you mean 'go1'?` if a known name is similar, else ""."""
    near = get_close_matches(str(name)[:100], list(known), n=1)
    return f"; did you mean '{near[0]}'?" if near else ""
