"""The gait of simulated walks: the controller's plain one, or one measured on a real robot.

The one whose walks are more like the log, by the realism card, is chosen. No error of a filter is
used.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from surefoot.scenarios.experiments.as_walked import load_as_walked
from surefoot.scenarios.trace.realism import SimulatedRobot, card_table, compare_walks
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import Effect
from surefoot.sim.gait.options import PLAIN_GAIT, GaitOptions
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot


@dataclass(frozen=True)
class GaitChoice:
    """A choice between the two gaits.

    Attributes:
        walked: whether the measured gait was chosen.
        words: the reason.
        rows: of the chosen gait's realism card; empty if the log is too short for one.
    """

    walked: bool
    words: str
    rows: list[dict[str, Any]]

    @property
    def gait(self) -> GaitOptions:
        return load_as_walked().gait if self.walked else PLAIN_GAIT


def choose_gait(
    log: Log,
    robot: Robot,
    effects: Sequence[Effect],
    seed: int,
    progress: Callable[[float], None] = lambda share: None,
) -> GaitChoice:
    """Choose the gait by realism cards.

    The score of a card is its number of `like` rows minus that of `unlike` ones; on a tie the plain
    gait is chosen.

    Args:
        log: the measured log.
        robot: as declared.
        effects: of the simulated robot.
        seed: of the walks.
        progress: called with the share done, 0 to 1.
    """
    gaits = {"the plain gait": None, "the gait as walked": replace(load_as_walked(), size=())}
    try:
        plain, walked = (
            compare_walks(
                log,
                robot,
                SimulatedRobot(words, effects, gait),
                seed,
                lambda share, k=k: progress(0.5 * (k + share)),
            )
            for k, (words, gait) in enumerate(gaits.items())
        )
    except SurefootError as error:
        return GaitChoice(False, f"The plain gait; no realism card: {error}.", [])
    score = [one.card.counts["like"] - one.card.counts["unlike"] for one in (plain, walked)]
    taken = walked if score[1] > score[0] else plain
    counts = [
        f"{one.words} has {one.card.counts['like']} quantities like the log's and "
        f"{one.card.counts['unlike']} unlike"
        for one in (plain, walked)
    ]
    words = f"Of the simulated walks, {counts[0]}; {counts[1]}. Taken: {taken.words}."
    return GaitChoice(taken is walked, words, card_table(taken.card))
