"""What each candidate is worth beside those chosen before it, and whether it earns its place."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from surefoot.models.attribution.evidence import Key
from surefoot.models.attribution.fit import NormalEquations, fit, loss
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.attribution.priors import surprise
from surefoot.models.attribution.run_offsets import of_each_run
from surefoot.models.attribution.split import FIT, SELECT
from surefoot.models.bootstrap import block_draws
from surefoot.models.residuals.registry import channels
from surefoot.sim.effects import known_effects
from surefoot.sim.robot.limbs import Limbs


@dataclass(frozen=True)
class Candidate:
    """One candidate, fitted with what was chosen before it.

    size and error [its unit], less the size it has on walks that lack it; floor: how far that
    varies [its unit]; gain: squared error it takes off the unseen blocks, in units of noise, with
    its 95 % interval; share: the same as a share of what there is to explain; surprise: what its
    prior takes off the gain (`priors.surprise`).
    """

    key: Key
    size: float
    error: float
    floor: float
    gain: float
    interval: tuple[float, float]
    share: float
    at_bound: bool
    earned: bool
    surprise: float = 0.0

    @property
    def score(self) -> float:
        """What candidates are ranked by: -2 log of likelihood and prior."""
        return self.gain - self.surprise


def judge(
    data: NormalEquations,
    floor: NoiseFloor,
    chosen: Sequence[Key],
    explained: Mapping[str, float],
    limbs: Limbs,
    rng: np.random.Generator,
    certain: Collection[Key] = (),
    among: int = 0,
) -> tuple[Candidate, ...]:
    """Every candidate that is not chosen yet, those that earn a place first, by score.

    Args:
        data: normal equations of the blocks.
        floor: noise floor.
        chosen: keys of the effects found so far.
        explained: channel -> what they take off its squared error, in units of noise.
        limbs: of the machine.
        rng: draws the bootstrap's blocks.
        certain: keys of effects that every machine has and the model lacks.
        among: how many candidates there are, where the data have only some of them.
    """
    s, parts = data.settings, (data.rows(data.part == FIT), data.rows(data.part == SELECT))
    # Halves that judge each other are not two: together they are worth the blocks of one.
    half = max(1, len(parts[0].G))
    counts = block_draws(sum(len(part.G) for part in parts), rng, drawn=half)
    plain = [fit(seen, chosen, errors=False).vector for seen in parts]
    # Chen and Chen 2008, extended BIC: one of many costs more than one alone, and one with a size
    # for each log as many times as it has sizes.
    per_size, chance = np.log(max(2, len(parts[0].G))), 2.0 * np.log(among or len(data.keys))
    judged = []
    for key in data.keys:
        if key in chosen:
            continue
        known = [*chosen, *_levels(key, data.keys, chosen)]
        fitted, again = fit(parts[0], [*known, key]), fit(parts[1], [*known, key], errors=False)
        size, error = float(fitted.sizes[-1]), float(np.sqrt(fitted.covariance[-1, -1]))
        offset, spread = floor.sizes(chosen, key)
        size -= offset
        without = plain
        if offset or len(known) > len(chosen):
            given = {key: offset} if offset else None
            without = [fit(seen, known, errors=False, given=given).vector for seen in parts]
        before = _left(parts, without[::-1])
        # Each half of the blocks at the sizes of the other half; what they gain on the mean.
        blocks = 0.5 * (before - _left(parts, (again.vector, fitted.vector)))
        gain = float(blocks.sum())
        low, high = np.percentile(counts @ blocks, [2.5, 97.5]) * len(blocks) / half
        at_seen = 0.5 * float(
            np.sum(_left(parts, without) - _left(parts, (fitted.vector, again.vector)))
        )
        # Of one with a size for each log the largest counts, which one log alone determines.
        sizes = size + data.by_run(key, fitted.vector)
        most, error = float(np.max(np.abs(sizes))), error * np.sqrt(len(sizes))
        # The floor's own offset is only as sure as its contact model.
        spread = float(np.hypot(spread, floor.doubt(key, offset)))
        low_end, high_end = known_effects()[key[0]].inside(key[1])
        # A fit beyond them is no size either, however much of it the floor's walks have.
        fitted_beyond = abs(fitted.sizes[-1]) > max(-low_end, high_end)
        at_bound = fitted_beyond or not low_end < sizes.min() <= sizes.max() < high_end
        share = gain / max(0.5 * float(before.sum()), 1e-300)
        shows_in = known_effects()[key[0]].channels_of(key[1])
        worth = s.worth * sum(explained.get(name, 0.0) for name in shows_in)
        clear = most / max(float(np.hypot(spread, error)), 1e-300)
        plain_to_see = clear > s.clear and share > s.large
        price = len(sizes) * per_size + chance
        doubt = sum(surprise(*key, float(one), limbs) for one in sizes)
        if s.own_zeros and of_each_run(key[0]):
            # It is another in every run anyway: nothing is a surprise, and its price is paid.
            doubt = -price
        earned = (
            low > 0
            and np.isfinite(error)
            and clear > s.above_floor * (s.certain if key in certain else 1.0)
            and not at_bound
            and (gain > worth or plain_to_see or key in certain)
            and min(at_seen, gain) - doubt > price
        )
        judged.append(
            Candidate(
                key=key,
                size=size,
                error=error,
                floor=spread,
                gain=gain,
                interval=(float(low), float(high)),
                share=share,
                at_bound=bool(at_bound),
                earned=bool(earned),
                surprise=doubt,
            )
        )
    return tuple(sorted(judged, key=lambda c: (not c.earned, -c.score)))


def _levels(key: Key, keys: Sequence[Key], chosen: Sequence[Key]) -> list[Key]:
    """What is fitted along with a candidate that shows only in channels whose level is not known
    well: the other candidates that are such a level."""
    shows_in = known_effects()[key[0]].channels_of(key[1])
    known_to = [channels()[name].known_to for name in shows_in if name in channels()]
    if not all(known_to) or any(key[1] in one for one in known_to):
        return []
    return [k for k in keys if k not in chosen and any(k[1] in one for one in known_to)]


def distinct(
    data: NormalEquations, candidates: Sequence[Candidate], limbs: Limbs
) -> tuple[Candidate, ...]:
    """The candidates without those that are one effect on parts that a better one is on too.

    A group and its members, or two groups, say the same of the parts that they share. The better
    one scores more by at least the price of a parameter, or stands for fewer parts.
    """
    price = np.log(max(2, np.count_nonzero(data.part == FIT)))
    parts = {c.key: set(known_effects()[c.key[0]].members_of(c.key[1], limbs)) for c in candidates}
    left, kept = list(candidates), []
    while left:
        best = left[0]
        alike = [c for c in left if c.key[0] == best.key[0] and parts[c.key] & parts[best.key]]
        as_good = [c for c in alike if c.earned == best.earned and c.score > best.score - price]
        kept.append(min(as_good, key=lambda c: len(parts[c.key])))
        left = [c for c in left if c not in alike]
    return tuple(kept)


def _left(parts: Sequence[NormalEquations], vectors: Sequence[np.ndarray]) -> np.ndarray:
    """Squared error (K,) that fits leave of the blocks of some parts, one after the other."""
    return np.concatenate([loss(part, v) for part, v in zip(parts, vectors, strict=True)])


def left_unseen(data: NormalEquations, keys: Sequence[Key]) -> np.ndarray:
    """Squared error (K,) that these keys leave of the blocks of FIT and SELECT, in units of noise,
    at the sizes that the other of the two parts gives them."""
    parts = data.rows(data.part == FIT), data.rows(data.part == SELECT)
    vectors = [fit(seen, keys, errors=False).vector for seen in parts]
    return _left(parts[::-1], vectors)
