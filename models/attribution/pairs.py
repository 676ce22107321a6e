"""Effects that fake each other alone are fitted jointly: pairs of candidates.

Feet that roll on one side only look like an IMU that is mounted askew beside feet that all roll.
Alone each of these explains less than what stands for all of them, and a search that adds one at a
time starts with that.
"""

from collections.abc import Collection, Sequence
from itertools import combinations

import numpy as np

from surefoot.models.attribution.evidence import Key
from surefoot.models.attribution.fit import NormalEquations, fit
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.attribution.priors import surprise
from surefoot.models.attribution.selection import (
    Candidate,
    faked_share,
    least_clear,
    left_unseen,
)
from surefoot.models.attribution.split import REPORT
from surefoot.sim.effects import known_effects
from surefoot.sim.robot.limbs import Limbs


def joint_pairs(
    data: NormalEquations,
    floor: NoiseFloor,
    candidates: Sequence[Candidate],
    chosen: Sequence[Key],
    limbs: Limbs,
    certain: Collection[Key] = (),
) -> list[tuple[Candidate, Candidate]]:
    """The pairs that explain unseen blocks better than any one, by a price for each, best first.

    Each member must earn its place beside the other, by its gain, its size's error and its floor.

    Args:
        data: normal equations of the blocks.
        floor: noise floor.
        candidates: of this round, those that earn a place first.
        chosen: keys of the effects found so far.
        limbs: of the machine.
        certain: keys of effects that every machine has and the model lacks.
    """
    s = data.settings
    if not candidates or not candidates[0].earned:
        return []
    channels = {c.key: set(known_effects()[c.key[0]].channels) for c in candidates}
    rivals = [c for c in candidates if channels[c.key] & channels[candidates[0].key]]
    few = sorted((c for c in rivals if c.interval[0] > 0), key=lambda c: -c.score)[: s.pair_pool]
    plain = float(left_unseen(data, chosen).sum())
    used = data.rows(data.part != REPORT)
    alone = few[0].score if few else 0.0
    price = np.log(max(2, len(used.G))) + 2.0 * np.log(len(data.keys))
    found = []
    for pair in combinations(few, 2):
        keys = [c.key for c in pair]
        gain = plain - float(left_unseen(data, [*chosen, *keys]).sum())
        if gain - max(c.score for c in pair) <= price:
            continue
        fitted = fit(used, [*chosen, *keys])
        sizes, errors = fitted.sizes[-2:], np.sqrt(2.0 * np.diag(fitted.covariance)[-2:])
        score = gain - sum(
            surprise(*key, float(size), limbs) for key, size in zip(keys, sizes, strict=True)
        )
        if score - alone > price and all(
            _stands(floor, [*chosen, other], key, float(size), float(error), data, certain)
            for key, other, size, error in zip(keys, keys[::-1], sizes, errors, strict=True)
        ):
            found.append((score, pair))
    return [pair for _, pair in sorted(found, key=lambda one: -one[0])]


def _stands(
    floor: NoiseFloor,
    beside: Sequence[Key],
    key: Key,
    size: float,
    error: float,
    data: NormalEquations,
    certain: Collection[Key],
) -> bool:
    """Whether a size is inside its bounds, and large against its error and its floor.

    Args:
        floor: noise floor.
        beside: keys of the effects that are fitted with it.
        key: of the effect.
        size: in its unit.
        error: its standard error.
        data: has the settings.
        certain: keys of effects that every machine has and the model lacks.
    """
    offset, spread = floor.sizes(beside, key)
    doubt = np.sqrt(spread**2 + (faked_share(key, data.settings) * offset) ** 2 + error**2)
    low, high = known_effects()[key[0]].inside(key[1])
    size = size - offset
    return bool(abs(size) > least_clear(key, certain, data.settings) * doubt and low < size < high)
