"""One line of the bench's table, and the comparison of two run times."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

Progress = Callable[[float], None]
SAMPLES = 1000
"""The paper's N of randomized quasi-Monte Carlo, used for comparison."""


@dataclass(frozen=True)
class Ratio:
    """One line of the table: speed relative to the peer's, and the target.

    value is None where the peer is not installed, as the note says. target is None for lines that
    are for information.
    """

    what: str
    against: str
    value: float | None
    target: float | None
    note: str

    def as_row(self) -> dict[str, str]:
        verdict = "-"
        if self.value is not None and self.target is not None:
            verdict = "met" if self.value >= self.target else "missed"
        return {
            "what": self.what,
            "against": self.against,
            "times as fast": "-" if self.value is None else f"{self.value:.3g}",
            "target": "-" if self.target is None else f">= {self.target:g}",
            "": verdict,
            "note": self.note,
        }


def in_turn(
    ours: Callable[[], object],
    theirs: Callable[[], object],
    rounds: int,
    progress: Progress | None = None,
) -> tuple[float, float]:
    """Smallest times [s] of the two, run alternately `rounds` times after a warm-up."""
    times: list[tuple[float, float]] = []
    for i in range(rounds + 1):
        now = perf_counter()
        ours()
        between = perf_counter()
        theirs()
        times.append((between - now, perf_counter() - between))
        if progress:
            progress((i + 1) / (rounds + 1))
    return min(a for a, _ in times[1:]), min(b for _, b in times[1:])


def part_of(progress: Progress | None, part: int, parts: int) -> Progress | None:
    """`progress` for one of several parts."""
    if progress is None:
        return None
    return lambda share: progress((part + share) / parts)
