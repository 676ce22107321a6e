"""A measured walk beside simulated ones: what a report of their realism is written from."""

from dataclasses import dataclass

from surefoot.models.realism.card import Card
from surefoot.models.realism.walk_view import WalkView


@dataclass(frozen=True)
class WalkComparison:
    """A measured walk, simulated ones and the card of the two.

    pace: share of the measured speed at which the simulated robot walks; words: what it was.
    """

    words: str
    measured: WalkView
    simulated: tuple[WalkView, ...]
    card: Card
    pace: float
