"""Which effect does the model lack? Every candidate is fitted; one that earns its place stays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t

from models.candidates import Case, Evidence, Key, all_keys, linearise
from models.fitting import Whitened, by_block, fit, loss, overlap, resampled, whiten
from models.floor import Floor, floor_with
from models.masking import Trust, trust
from sim.effects import CATALOGUE, Effect, effect

AT_MOST = 4
"""Effects that one trace may name."""
ABOVE_FLOOR = 4.0
"""How many times its size on walks that lack it an effect must have."""
DOUBT = 0.3
"""Share of the size that contacts fake on such walks which is taken for uncertain."""
WORTH = 0.02
"""Share of what is explained so far that a further effect must add."""
TWINS = 0.95
"""Overlap from which two regressors are hard to tell apart."""


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
    WORTH of what the others explain, and it pays for its parameter (BIC, blocks as samples).
    """
    keys = tuple(dict.fromkeys(key for case in cases for key in all_keys(case.log)))
    chosen: list[Effect] = []
    rounds: list[tuple[Candidate, ...]] = []
    rivals: tuple[tuple[Key, float], ...] = ()
    explained = 0.0
    while True:
        if progress:
            progress(len(rounds) / (AT_MOST + 1))
        evidence = linearise(cases, chosen, keys)
        trusted = trust(evidence, floor.sigma)
        data = whiten(evidence, trusted)
        candidates = judge(data, floor, split, [_key(e) for e in chosen], explained, rng)
        rounds.append(candidates)
        best = candidates[0] if candidates and candidates[0].earned else None
        if best is None or len(chosen) == AT_MOST:
            break
        rivals += _rivals(data, split, best, candidates, [_key(e) for e in chosen], rng)
        explained += best.gain
        chosen = _refined(cases, [*chosen, effect(*best.key, best.size)], floor, split)
        floor = floor_with(floor, chosen)
    found = _with_intervals(evidence, trusted, split, chosen, floor)
    # What was found beside an effect is no other explanation of it.
    rivals = tuple(rival for rival in rivals if rival[0] not in [_key(e) for e in chosen])
    return Attribution(found, tuple(rounds), rivals, trusted, evidence, floor)


def judge(
    data: Whitened,
    floor: Floor,
    split: Split,
    chosen: Sequence[Key],
    explained: float,
    rng: np.random.Generator,
) -> tuple[Candidate, ...]:
    """Every candidate that is not chosen yet, those that earn a place first, by gain."""
    seen, unseen = data.rows(split.fit), data.rows(split.select)
    judged = []
    for key in data.keys:
        if key in chosen:
            continue
        with_it = [*chosen, key]
        fitted = fit(seen, with_it)
        at = len(chosen)
        size, error = float(fitted.sizes[at]), float(np.sqrt(fitted.covariance[at, at]))
        offset, spread = floor.sizes(chosen, key)
        size -= offset
        base, base_seen = (_without(part, key, offset, chosen, seen) for part in (unseen, seen))
        blocks = by_block(unseen, base - loss(unseen, with_it, fitted.sizes))
        gain = float(blocks.sum())
        low, high = np.percentile(resampled(blocks, rng), [2.5, 97.5])
        at_seen = float(np.sum(base_seen - loss(seen, with_it, fitted.sizes)))
        # The floor's own offset is only as sure as its contact model.
        spread = float(np.hypot(spread, DOUBT * offset))
        bounds = CATALOGUE[key[0]].bounds
        at_bound = not bounds[0] < size < bounds[1]
        earned = (
            low > 0
            and np.isfinite(error)
            and abs(size) > ABOVE_FLOOR * np.hypot(spread, error)
            and not at_bound
            and gain > WORTH * explained
            and at_seen > np.log(max(2, len(np.unique(seen.block)))) * _inflation(seen, base_seen)
        )
        judged.append(
            Candidate(
                key, size, error, spread, gain, (float(low), float(high)),
                gain / max(float(base.sum()), 1e-300), at_bound, bool(earned),
            )
        )  # fmt: skip
    return tuple(sorted(judged, key=lambda c: (not c.earned, -c.gain)))


def _without(
    part: Whitened, key: Key, offset: float, chosen: Sequence[Key], seen: Whitened
) -> np.ndarray:
    """Loss (M,) of a part with the candidate at no more than the floor's own size."""
    column = part.keys.index(key)
    rest, rest_seen = (replace(d, y=d.y - d.X[:, :, column] * offset) for d in (part, seen))
    return loss(rest, chosen, fit(rest_seen, chosen).sizes)


def _key(one: Effect) -> Key:
    return one.name, one.target


def _inflation(data: Whitened, losses: np.ndarray) -> float:
    """How much more a block's errors add up than independent ones would: 1 for white noise."""
    blocks = by_block(data, losses)
    entries = by_block(data, (data.weight > 0).sum(axis=1).astype(float))
    return float(max(1.0, np.var(blocks - entries) / max(2.0 * np.mean(entries), 1e-300)) ** 0.5)


def _rivals(
    data: Whitened,
    split: Split,
    best: Candidate,
    candidates: Sequence[Candidate],
    chosen: Sequence[Key],
    rng: np.random.Generator,
) -> tuple[tuple[Key, float], ...]:
    """Candidates that explain the unseen blocks as well as the best, with their overlap."""
    seen, unseen = data.rows(split.fit), data.rows(split.select)
    of_best = loss(unseen, [*chosen, best.key], fit(seen, [*chosen, best.key]).sizes)
    rivals = []
    for other in candidates:
        if other.key == best.key or other.gain < 0.5 * best.gain:
            continue
        keys = [*chosen, other.key]
        behind = by_block(unseen, loss(unseen, keys, fit(seen, keys).sizes) - of_best)
        shared = overlap(data, best.key, other.key, chosen)
        if np.percentile(resampled(behind, rng), 2.5) <= 0 and shared > TWINS:
            rivals.append((other.key, shared))
    return tuple(rivals)


def _refined(
    cases: Sequence[Case], chosen: list[Effect], floor: Floor, split: Split
) -> list[Effect]:
    """Gauss-Newton on the true, nonlinear residual over the blocks that are not for the report."""
    keys = [_key(e) for e in chosen]
    use = split.fit | split.select
    for _ in range(3):
        evidence = linearise(cases, chosen, keys, central=True)
        data = whiten(evidence, trust(evidence, floor.sigma)).rows(use)
        step = fit(data, keys).sizes[: len(keys)] - _offsets(floor, keys)
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
    low, high = one.bounds
    margin = 1.1 * one.step
    return replace(one, value=float(np.clip(value, low + margin, high - margin)))


def _with_intervals(
    evidence: Evidence, trusted: Trust, split: Split, chosen: Sequence[Effect], floor: Floor
) -> tuple[Found, ...]:
    """Effects by what they explain, with intervals from blocks and from the floor's own sizes."""
    keys = [_key(e) for e in chosen]
    data = whiten(evidence, trusted).rows(split.fit | split.select)
    fitted = fit(data, keys)
    found = []
    for i, one in enumerate(chosen):
        offset, spread = floor.sizes([k for k in keys if k != keys[i]], keys[i])
        repeats = len(floor.walks)
        half = np.hypot(1.96 * np.sqrt(fitted.covariance[i, i]), 1.96 * DOUBT * offset)
        if repeats > 1:
            half = np.hypot(half, t.ppf(0.975, repeats - 1) * spread * np.sqrt(1 + 1 / repeats))
        strength = float(
            np.sum(data.weight * (data.X[:, :, data.keys.index(keys[i])] * one.value) ** 2)
        )
        found.append((strength, Found(one, (one.value - half, one.value + half))))
    return tuple(f for _, f in sorted(found, key=lambda pair: -pair[0]))
