"""Gain of each candidate over the effects chosen so far, and whether it earns a place."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from surefoot.models.attribution.evidence import Key
from surefoot.models.attribution.fit import NormalEquations, fit, loss
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.attribution.priors import prior_penalty
from surefoot.models.attribution.run_offsets import is_per_run
from surefoot.models.attribution.split import FIT, SELECT
from surefoot.models.bootstrap import block_bootstrap_counts
from surefoot.models.residuals.registry import channels
from surefoot.sim.effects import known_effects
from surefoot.sim.robot.limbs import Limbs


@dataclass(frozen=True)
class Candidate:
    """A candidate, fitted along with the effects chosen before it.

    Attributes:
        key: name and target.
        size: less its apparent size on walks without the effect [its unit].
        error: standard error of the size [its unit].
        floor: spread of the apparent size on such walks [its unit].
        gain: reduction of the squared error on unseen blocks, in units of noise.
        interval: 95 % interval of the gain.
        share: the gain relative to the error before.
        at_bound: whether a size is at or beyond its bounds.
        earned: whether the candidate earns a place.
        prior_penalty: penalty of the prior on the size (`priors.prior_penalty`).
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
    prior_penalty: float = 0.0

    @property
    def score(self) -> float:
        """Gain less the prior's penalty, -2 log of a posterior ratio, by which candidates are
        ranked.
        """
        return self.gain - self.prior_penalty


@dataclass(frozen=True)
class SearchState:
    """What is known when candidates are evaluated.

    Attributes:
        chosen: keys of the effects found so far.
        explained: channel -> reduction of its squared error by them, in units of noise.
        certain: keys of effects that every machine has and the model lacks.
        among: number of candidates, where the data have only some of them; else 0.
    """

    chosen: Sequence[Key] = ()
    explained: Mapping[str, float] = field(default_factory=dict)
    certain: Collection[Key] = ()
    among: int = 0


def evaluate_candidates(
    data: NormalEquations,
    floor: NoiseFloor,
    state: SearchState,
    limbs: Limbs,
    rng: np.random.Generator,
) -> tuple[Candidate, ...]:
    """Evaluate every candidate that is not chosen yet; those that earn a place first, by score.

    Args:
        data: normal equations of the blocks.
        floor: noise floor.
        state: of the search.
        limbs: of the machine.
        rng: of the block bootstrap.
    """
    chosen, certain = state.chosen, state.certain
    s, parts = data.settings, (data.rows(data.part == FIT), data.rows(data.part == SELECT))
    # The two halves are validated on each other and are not independent, so the effective number of
    # blocks is that of one.
    half = max(1, len(parts[0].G))
    counts = block_bootstrap_counts(sum(len(part.G) for part in parts), rng, drawn=half)
    plain = [fit(seen, chosen, errors=False).vector for seen in parts]
    # Extended BIC (Chen and Chen 2008): choosing among many candidates adds to the price of a
    # parameter, and a candidate with a size for each log pays for all of them.
    per_size, chance = np.log(max(2, len(parts[0].G))), 2.0 * np.log(state.among or len(data.keys))
    judged = []
    for key in data.keys:
        if key in chosen:
            continue
        known = [*chosen, *_level_candidates(key, data.keys, chosen)]
        fitted, again = fit(parts[0], [*known, key]), fit(parts[1], [*known, key], errors=False)
        size, error = float(fitted.sizes[-1]), float(np.sqrt(fitted.covariance[-1, -1]))
        offset, spread = floor.sizes(chosen, key)
        size -= offset
        without = plain
        if offset or len(known) > len(chosen):
            given = {key: offset} if offset else None
            without = [fit(seen, known, errors=False, given=given).vector for seen in parts]
        before = _block_errors(parts, without[::-1])
        # Cross-validation: each half is evaluated at the sizes fitted to the other; mean of both.
        blocks = 0.5 * (before - _block_errors(parts, (again.vector, fitted.vector)))
        gain = float(blocks.sum())
        low, high = np.percentile(counts @ blocks, [2.5, 97.5]) * len(blocks) / half
        at_seen = 0.5 * float(
            np.sum(
                _block_errors(parts, without) - _block_errors(parts, (fitted.vector, again.vector))
            )
        )
        # A candidate with a size for each log is judged by the largest, which a single log
        # determines.
        sizes = size + data.by_run(key, fitted.vector)
        most, error = float(np.max(np.abs(sizes))), error * np.sqrt(len(sizes))
        # The apparent size on the floor's walks is only as certain as their contact model.
        spread = float(np.hypot(spread, floor.size_uncertainty(key, offset)))
        low_end, high_end = known_effects()[key[0]].interior_bounds(key[1], limbs)
        # Also at a bound if the size is beyond it before the floor's offset is subtracted.
        fitted_beyond = abs(fitted.sizes[-1]) > max(-low_end, high_end)
        at_bound = fitted_beyond or not low_end < sizes.min() <= sizes.max() < high_end
        share = gain / max(0.5 * float(before.sum()), 1e-300)
        shows_in = known_effects()[key[0]].channels_of(key[1])
        worth = s.least_added_share * sum(state.explained.get(name, 0.0) for name in shows_in)
        clear = most / max(float(np.hypot(spread, error)), 1e-300)
        plain_to_see = clear > s.clear_ratio and share > s.large_share
        price = len(sizes) * per_size + chance
        penalty = sum(prior_penalty(*key, float(one), limbs) for one in sizes)
        if s.per_run_offsets and is_per_run(key[0]):
            # A size that differs between runs anyway needs no prior and is not charged as a
            # parameter.
            penalty = -price
        earned = (
            low > 0
            and np.isfinite(error)
            and clear > s.least_size_ratio * (s.always_present_factor if key in certain else 1.0)
            and not at_bound
            and (gain > worth or plain_to_see or key in certain)
            and min(at_seen, gain) - penalty > price
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
                prior_penalty=penalty,
            )
        )
    return tuple(sorted(judged, key=lambda c: (not c.earned, -c.score)))


def _level_candidates(key: Key, keys: Sequence[Key], chosen: Sequence[Key]) -> list[Key]:
    """Candidates to fit along with one whose channels have an uncertain level.

    These are the other candidates that describe that level.
    """
    shows_in = known_effects()[key[0]].channels_of(key[1])
    level_spread = [channels()[name].level_spread for name in shows_in if name in channels()]
    if not all(level_spread) or any(key[1] in one for one in level_spread):
        return []
    return [k for k in keys if k not in chosen and any(k[1] in one for one in level_spread)]


def distinct(
    data: NormalEquations, candidates: Sequence[Candidate], limbs: Limbs
) -> tuple[Candidate, ...]:
    """Drop candidates of one name that share parts with a better one.

    A group and its members, or two groups, are equivalent on the parts that they share. A candidate
    is better if its score is higher by the price of a parameter, or if it covers fewer parts.
    """
    price = np.log(max(2, np.count_nonzero(data.part == FIT)))
    parts = {c.key: set(known_effects()[c.key[0]].members_of(c.key[1], limbs)) for c in candidates}
    left, kept = list(candidates), []
    while left:
        best = left[0]
        alike = [c for c in left if c.key[0] == best.key[0] and parts[c.key] & parts[best.key]]
        as_good = [c for c in alike if c.earned == best.earned and c.score >= best.score - price]
        kept.append(min(as_good, key=lambda c: len(parts[c.key])))
        left = [c for c in left if c not in alike]
    return tuple(kept)


def _block_errors(parts: Sequence[NormalEquations], vectors: Sequence[np.ndarray]) -> np.ndarray:
    """Squared error (K,) of the blocks of some parts, each with its vector, concatenated."""
    return np.concatenate([loss(part, v) for part, v in zip(parts, vectors, strict=True)])


def cross_validated_error(data: NormalEquations, keys: Sequence[Key]) -> np.ndarray:
    """Cross-validated squared error (K,) of the blocks of FIT and SELECT, in units of noise: each
    part with the sizes fitted to the other.
    """
    parts = data.rows(data.part == FIT), data.rows(data.part == SELECT)
    vectors = [fit(seen, keys, errors=False).vector for seen in parts]
    return _block_errors(parts[::-1], vectors)
