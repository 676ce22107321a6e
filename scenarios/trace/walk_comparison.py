"""A measured walk beside simulated ones: what a report of their realism is written from."""

from dataclasses import dataclass

from surefoot.models.realism.card import Card
from surefoot.models.realism.walk_view import WalkView


@dataclass(frozen=True)
class WalkComparison:
    """A measured walk, simulated walks in its manner, and the realism card that compares them.

    words: which simulated robot it is, such as "as drawn"; pace: the share of the measured speed at
    which it walks.
    """

    words: str
    measured: WalkView
    simulated: tuple[WalkView, ...]
    card: Card
    pace: float
