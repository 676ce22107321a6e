"""A measured walk with simulated ones, from which a realism report is written."""

from dataclasses import dataclass

from surefoot.models.realism.card import Card
from surefoot.models.realism.walk_view import WalkView


@dataclass(frozen=True)
class WalkComparison:
    """A measured walk, simulated walks in its style, and the realism card that compares them.

    Attributes:
        words: name of the simulated robot, such as "as drawn".
        measured: the measured walk.
        simulated: the simulated walks.
        card: the comparison.
        pace: speed of the simulated walks relative to the measured one.
    """

    words: str
    measured: WalkView
    simulated: tuple[WalkView, ...]
    card: Card
    pace: float
