"""Which effect does the model lack? Every candidate is fitted; one that earns its place stays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t

from models.candidates import Case, Evidence, Key, all_keys, linearise
from models.fitting import Design, Grams, design, draws, fit, grams, loss, overlap
from models.floor import Floor, floor_with
from models.masking import Trust, trust
from models.refinement import Data, inside, refined
from sim.effects import CATALOGUE, Effect, effect

AT_MOST = 4
"""Effects that one trace may name."""
ABOVE_FLOOR = 5.0
"""How many times its size on walks that lack it an effect must have."""
DOUBT = 0.7
"""Share of the size that contacts fake on such walks which is taken for uncertain: on slippery
ground they faked a delay of joints four times as long as on the floor's."""
WORTH = 0.02
"""Share of what is explained so far that a further effect must add."""
CLEAR, LARGE = 20.0, 0.2
"""One that stands so many times above its floor and takes such a share of all that is left may add
less: beside a very large effect even a large one is little."""
TWINS = 0.95
"""Overlap from which two regressors are hard to tell apart."""
CLOSE_BEHIND = 0.3
"""Share of the best gain from which a candidate might be better than linear regressors say."""
TRIED = 3
"""Candidates that are tried on the true residual in a round."""
SETTLING, MOVED = 3, 0.01
"""Times at most that sizes and weights are found anew, and the share of a size that is a move."""
FIT, SELECT, REPORT = 0, 1, 2


@dataclass(frozen=True)
class Candidate:
    """One candidate, fitted with what was chosen before it.

    size and error [its unit], less the size it has on walks that lack it; floor: how far that
    varies [its unit]; gain: squared error it takes off the unseen blocks, in units of noise, with
    its 95 % interval; share: the same as a share of what there is to explain.
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


@dataclass(frozen=True)
class Found:
    """An effect with the 95 % interval of its size."""

    effect: Effect
    interval: tuple[float, float]


@dataclass(frozen=True)
class Attribution:
    """What was found: effects, strongest first; candidates by round; rivals of any effect;
    trust of the final evidence; floor: that of the model with the effects."""

    found: tuple[Found, ...]
    rounds: tuple[tuple[Candidate, ...], ...]
    rivals: tuple[tuple[Key, float], ...]
    trust: Trust
    evidence: Evidence
    floor: Floor


@dataclass(frozen=True)
class Split:
    """Masks (M,) of the bins that sizes are fitted on, that choose, and that only report."""

    fit: np.ndarray
    select: np.ndarray
    report: np.ndarray

    @property
    def part(self) -> np.ndarray:
        """FIT, SELECT or REPORT of each bin (M,), -1 for none."""
        part = np.full(len(self.fit), -1)
        for number, mask in enumerate((self.fit, self.select, self.report)):
            part[mask] = number
        return part


def attribute(
    cases: Sequence[Case],
    floor: Floor,
    split: Split,
    rng: np.random.Generator,
    progress: Callable[[float], None] | None = None,
) -> Attribution:
    """Greedy search: add the candidate that gains most on unseen blocks while one earns its place.

    A candidate earns it if its gain's interval lies above zero, its size stands ABOVE_FLOOR times
    above the one it has on walks of the declared model, it is not at its bound, it adds a share
    WORTH of what the others explain or is CLEAR by itself, and it pays for its parameter and for
    having been one of many (extended BIC, blocks as samples).
    """
    keys = tuple(dict.fromkeys(key for case in cases for key in all_keys(case)))
    chosen: list[Effect] = []
    rounds: list[tuple[Candidate, ...]] = []
    rivals: tuple[tuple[Key, float], ...] = ()
    explained = 0.0
    evidence = None
    while True:
        if progress:
            progress(len(rounds) / (AT_MOST + 1))
        evidence, whole, trusted, chosen = _settled(cases, chosen, keys, evidence, floor, split)
        data = grams(whole, floor.counted(trusted.sigma), trusted.weight, split.part)
        candidates = judge(data, floor, [_key(e) for e in chosen], explained, rng)
        rounds.append(candidates)
        best = candidates[0] if candidates and candidates[0].earned else None
        if best is None or len(chosen) == AT_MOST:
            break
        known = Data(cases, floor, evidence, chosen, trusted, split.part)
        tried = [
            (c, *refined(known, [*chosen, effect(*c.key, c.size)], REPORT))
            for c in contenders(candidates)
        ]
        best, chosen_with, _ = min(tried, key=lambda one: one[2])
        rivals += _rivals(data, best, candidates, [_key(e) for e in chosen], rng)
        explained += best.gain
        chosen = chosen_with
        floor = floor_with(floor, chosen)
    found = _with_intervals(data, chosen, floor)
    # What was found beside an effect is no other explanation of it.
    rivals = tuple(rival for rival in rivals if rival[0] not in [_key(e) for e in chosen])
    return Attribution(found, tuple(rounds), rivals, trusted, evidence, floor)


def judge(
    data: Grams,
    floor: Floor,
    chosen: Sequence[Key],
    explained: float,
    rng: np.random.Generator,
) -> tuple[Candidate, ...]:
    """Every candidate that is not chosen yet, those that earn a place first, by gain."""
    seen, unseen = data.rows(data.part == FIT), data.rows(data.part == SELECT)
    counts = draws(len(unseen.G), rng)
    plain = fit(seen, chosen, errors=False).vector
    plainly = loss(unseen, plain), loss(seen, plain)
    # Chen and Chen 2008, extended BIC: one of many costs more than one alone.
    price = np.log(max(2, len(seen.G))) + 2.0 * np.log(len(data.keys))
    judged = []
    for at, key in enumerate(data.keys):
        if key in chosen:
            continue
        fitted = fit(seen, [*chosen, key])
        size, error = float(fitted.sizes[-1]), float(np.sqrt(fitted.covariance[-1, -1]))
        offset, spread = floor.sizes(chosen, key)
        size -= offset
        before, before_seen = plainly
        if offset:
            faked = _without(seen, at, offset, chosen)
            before, before_seen = loss(unseen, faked), loss(seen, faked)
        blocks = before - loss(unseen, fitted.vector)
        gain = float(blocks.sum())
        low, high = np.percentile(counts @ blocks, [2.5, 97.5])
        at_seen = float(np.sum(before_seen - loss(seen, fitted.vector)))
        # The floor's own offset is only as sure as its contact model.
        spread = float(np.hypot(spread, DOUBT * offset))
        low_end, high_end = inside(CATALOGUE[key[0]])
        # A fit beyond them is no size either, however much of it the floor's walks have.
        fitted_beyond = abs(fitted.sizes[-1]) > max(-low_end, high_end)
        at_bound = fitted_beyond or not low_end < size < high_end
        share = gain / max(float(before.sum()), 1e-300)
        clear = abs(size) / max(float(np.hypot(spread, error)), 1e-300)
        plain_to_see = clear > CLEAR and share > LARGE
        earned = (
            low > 0
            and np.isfinite(error)
            and clear > ABOVE_FLOOR
            and not at_bound
            and (gain > WORTH * explained or plain_to_see)
            and min(at_seen, gain) > price
        )
        judged.append(
            Candidate(
                key, size, error, spread, gain, (float(low), float(high)),
                share, bool(at_bound), bool(earned),
            )
        )  # fmt: skip
    return tuple(sorted(judged, key=lambda c: (not c.earned, -c.gain)))


def _settled(
    cases: Sequence[Case],
    chosen: list[Effect],
    keys: Sequence[Key],
    evidence: Evidence | None,
    floor: Floor,
    split: Split,
) -> tuple[Evidence, Design, Trust, list[Effect]]:
    """The evidence about the chosen effects, which of it to believe, and their sizes on that.

    A large effect that is not linear spoils much of the evidence before it is explained.
    """
    times = 0
    while True:
        evidence = linearise(cases, chosen, keys, evidence)
        whole = design(evidence)
        trusted = trust(whole, floor.sigma)
        times += 1
        if not chosen or times == SETTLING:
            return evidence, whole, trusted, chosen
        data = Data(cases, floor, evidence, chosen, trusted, split.part)
        moved, _ = refined(data, chosen, REPORT)
        pairs = list(zip(moved, chosen, strict=True))
        if all(abs(a.value - b.value) < MOVED * abs(b.value) for a, b in pairs):
            return evidence, whole, trusted, chosen
        chosen = moved


def contenders(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Of those that earn a place, best first, the few whose gain is not far from the best's: which
    of them explains most is for the true residual to say."""
    earned = [c for c in candidates if c.earned]
    return [c for c in earned if c.gain > CLOSE_BEHIND * earned[0].gain][:TRIED]


def _without(seen: Grams, at: int, offset: float, chosen: Sequence[Key]) -> np.ndarray:
    """The vector (P,) of a fit with the candidate `at` held at the floor's own size."""
    held = seen.total()
    G = held.G.copy()
    G[0, 0] -= offset * G[0, 1 + at]
    G[0, :, 0] -= offset * G[0, :, 1 + at]
    G[0, 0, 1:] = G[0, 1:, 0]
    vector = fit(replace(held, G=G), chosen, errors=False).vector.copy()
    vector[1 + at] = -offset
    return vector


def _key(one: Effect) -> Key:
    return one.name, one.target


def _rivals(
    data: Grams,
    best: Candidate,
    candidates: Sequence[Candidate],
    chosen: Sequence[Key],
    rng: np.random.Generator,
) -> tuple[tuple[Key, float], ...]:
    """Candidates inside their bounds that explain the unseen blocks as well as the best, with their
    overlap.
    """
    seen, unseen = data.rows(data.part == FIT), data.rows(data.part == SELECT)
    counts = draws(len(unseen.G), rng)

    def left(*keys: Key) -> np.ndarray:
        return loss(unseen, fit(seen, [*chosen, *keys], errors=False).vector)

    of_best, of_none = left(best.key), left()
    # What is no better by the price of one parameter is as good.
    price = np.log(max(2, len(seen.G)))
    rivals = []
    for other in candidates:
        if other.key == best.key or other.at_bound:
            continue
        shared = overlap(data, best.key, other.key, chosen)
        if shared <= TWINS:
            continue
        behind = left(other.key) - of_best
        as_good = np.percentile(counts @ behind, 2.5) <= price
        if as_good and np.sum(of_none - of_best - behind) > 0.5 * np.sum(of_none - of_best):
            rivals.append((other.key, shared))
    return tuple(rivals)


def _with_intervals(data: Grams, chosen: Sequence[Effect], floor: Floor) -> tuple[Found, ...]:
    """Effects by what they explain, with intervals from blocks and from the floor's own sizes."""
    keys = [_key(e) for e in chosen]
    used = data.rows(data.part != REPORT)
    covariance = fit(used, keys).covariance
    total = used.G.sum(axis=0)
    found = []
    for i, one in enumerate(chosen):
        offset, spread = floor.sizes([k for k in keys if k != keys[i]], keys[i])
        repeats = len(floor.repeats)
        half = float(np.hypot(1.96 * np.sqrt(covariance[i, i]), 1.96 * DOUBT * offset))
        if repeats > 1:
            half = float(np.hypot(half, t.ppf(0.975, repeats - 1) * spread))
        at = 1 + data.keys.index(keys[i])
        strength = float(total[at, at] * one.value**2)
        found.append((strength, Found(one, (one.value - half, one.value + half))))
    return tuple(f for _, f in sorted(found, key=lambda pair: -pair[0]))
