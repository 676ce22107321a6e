"""Which effect does the model lack? Every candidate is fitted; one that earns its place stays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t

from models.candidates import Case, Evidence, Key, all_keys, linearise
from models.fitting import Grams, design, draws, fit, grams, loss, overlap
from models.floor import Floor, floor_with
from models.masking import Trust, trust
from sim.effects import CATALOGUE, Effect, effect

AT_MOST = 4
"""Effects that one trace may name."""
ABOVE_FLOOR = 5.0
"""How many times its size on walks that lack it an effect must have."""
DOUBT = 0.5
"""Share of the size that contacts fake on such walks which is taken for uncertain."""
WORTH = 0.02
"""Share of what is explained so far that a further effect must add."""
TWINS = 0.95
"""Overlap from which two regressors are hard to tell apart."""
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
    WORTH of what the others explain, and it pays for its parameter and for having been one of many
    (extended BIC, blocks as samples).
    One that no longer earns its place beside a later one goes.
    """
    keys = tuple(dict.fromkeys(key for case in cases for key in all_keys(case)))
    chosen: list[Effect] = []
    rounds: list[tuple[Candidate, ...]] = []
    rivals: tuple[tuple[Key, float], ...] = ()
    explained = 0.0
    evidence, trusted = None, None
    while True:
        if progress:
            progress(len(rounds) / (AT_MOST + 1))
        evidence = linearise(cases, chosen, keys, evidence)
        whole = design(evidence)
        # What the whole catalogue cannot explain hardly depends on what was chosen from it.
        trusted = trusted or trust(whole, floor.sigma)
        data = grams(whole, floor.counted(trusted.sigma), trusted.weight, split.part)
        candidates = judge(data, floor, [_key(e) for e in chosen], explained, rng)
        rounds.append(candidates)
        best = candidates[0] if candidates and candidates[0].earned else None
        if best is None or len(chosen) == AT_MOST:
            break
        rivals += _rivals(data, best, candidates, [_key(e) for e in chosen], rng)
        explained += best.gain
        chosen = _refined(
            cases, [*chosen, effect(*best.key, best.size)], floor, split, evidence, trusted
        )
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
    base = {0.0: (loss(unseen, plain), loss(seen, plain))}
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
        before, before_seen = base[0.0]
        if offset:
            faked = _without(seen, at, offset, chosen)
            before, before_seen = loss(unseen, faked), loss(seen, faked)
        blocks = before - loss(unseen, fitted.vector)
        gain = float(blocks.sum())
        low, high = np.percentile(counts @ blocks, [2.5, 97.5])
        at_seen = float(np.sum(before_seen - loss(seen, fitted.vector)))
        # The floor's own offset is only as sure as its contact model.
        spread = float(np.hypot(spread, DOUBT * offset))
        low_end, high_end = _inside(CATALOGUE[key[0]])
        at_bound = not low_end < size < high_end
        earned = (
            low > 0
            and np.isfinite(error)
            and abs(size) > ABOVE_FLOOR * np.hypot(spread, error)
            and not at_bound
            and gain > WORTH * explained
            and min(at_seen, gain) > price
        )
        judged.append(
            Candidate(
                key, size, error, spread, gain, (float(low), float(high)),
                gain / max(float(before.sum()), 1e-300), at_bound, bool(earned),
            )
        )  # fmt: skip
    return tuple(sorted(judged, key=lambda c: (not c.earned, -c.gain)))


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
    of_best = loss(unseen, fit(seen, [*chosen, best.key], errors=False).vector)
    rivals = []
    for other in candidates:
        if other.key == best.key or other.at_bound or other.gain < 0.5 * best.gain:
            continue
        behind = loss(unseen, fit(seen, [*chosen, other.key], errors=False).vector) - of_best
        shared = overlap(data, best.key, other.key, chosen)
        if np.percentile(counts @ behind, 2.5) <= 0 and shared > TWINS:
            rivals.append((other.key, shared))
    return tuple(rivals)


def _refined(
    cases: Sequence[Case],
    chosen: list[Effect],
    floor: Floor,
    split: Split,
    evidence: Evidence,
    trusted: Trust,
) -> list[Effect]:
    """Gauss-Newton on the true, nonlinear residual over the blocks that are not for the report."""
    keys = [_key(e) for e in chosen]
    part = np.where(split.fit | split.select, FIT, -1)
    chosen = [_clipped(e, e.value) for e in chosen]
    for _ in range(3):
        data = design(linearise(cases, chosen, keys, evidence.only(keys)))
        sums = grams(data, floor.counted(trusted.sigma), trusted.weight, part)
        step = fit(sums, keys, errors=False).sizes
        step = step - _offsets(floor, keys)
        moved = [_clipped(e, e.value + d) for e, d in zip(chosen, step, strict=True)]
        small = all(
            abs(a.value - b.value) < 1e-3 * abs(a.value) for a, b in zip(moved, chosen, strict=True)
        )
        chosen = moved
        if small:
            break
    return chosen


def _offsets(floor: Floor, keys: Sequence[Key]) -> np.ndarray:
    """Sizes (C,) that these keys, fitted together, have on walks that lack them."""
    return np.array([floor.sizes([k for k in keys if k != key], key)[0] for key in keys])


def _clipped(one: Effect, value: float) -> Effect:
    return replace(one, value=float(np.clip(value, *_inside(type(one)))))


def _inside(kind: type[Effect]) -> tuple[float, float]:
    """Bounds between which a size can still be varied by its step to either side."""
    low, high = kind.bounds
    return low + 1.1 * kind.step, high - 1.1 * kind.step


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
