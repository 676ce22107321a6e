"""What the values of an import map must be; each fault is one line with its section and key."""

from typing import Any

from surefoot.sim.common.errors import SurefootError


def check_keys(
    section: str,
    table: dict[str, Any],
    required: tuple[str, ...] = (),
    optional: tuple[str, ...] = (),
) -> None:
    """Raise SurefootError for a key that is unknown or missing."""
    for key in table:
        if key not in required + optional:
            raise SurefootError(
                f"[{section}] unknown key {key!r} (known: {', '.join(required + optional)})"
            )
    for key in required:
        if key not in table:
            raise SurefootError(f"[{section}] {key} is missing")


def checked_text(section: str, key: str, value: Any) -> str:
    """The value, a text that is not empty. Raises SurefootError."""
    if not isinstance(value, str) or not value:
        raise SurefootError(f"[{section}] {key} is not a text")
    return value


def checked_number(
    section: str, key: str, value: Any, above: float | None = None, least: float | None = None
) -> float:
    """The value, a finite number above `above` and at least `least`. Raises SurefootError."""
    good = isinstance(value, int | float) and not isinstance(value, bool)
    if not good or not abs(value) < float("inf"):
        raise SurefootError(f"[{section}] {key} is {value!r}, not a number")
    if (above is not None and value <= above) or (least is not None and value < least):
        raise SurefootError(f"[{section}] {key} is {value!r}, too small")
    return float(value)


def checked_vector(section: str, key: str, value: Any, length: int) -> list[float]:
    """The value, so many finite numbers. Raises SurefootError."""
    if not isinstance(value, list) or len(value) != length:
        raise SurefootError(f"[{section}] {key} is not a list of {length} numbers")
    return [checked_number(section, f"{key}[{i}]", item) for i, item in enumerate(value)]


def checked_by_name(section: str, key: str, value: Any) -> dict[str, float]:
    """The value, a table of finite numbers. Raises SurefootError."""
    if not isinstance(value, dict):
        raise SurefootError(f"[{section}] {key} is not a table by joint")
    return {name: checked_number(section, f"{key}.{name}", item) for name, item in value.items()}
