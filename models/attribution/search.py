"""Which effect does the model lack? Every candidate is fitted; one that earns its place stays."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t

from surefoot.models.attribution.drift import adds_drift
from surefoot.models.attribution.evidence import Evidence, Key, LogUnderModel, all_keys, linearise
from surefoot.models.attribution.fit import (
    Design,
    NormalEquations,
    design,
    fit,
    normal_equations,
    overlap,
)
from surefoot.models.attribution.noise_floor import NoiseFloor, noise_floor_with
from surefoot.models.attribution.pairs import joint_pairs
from surefoot.models.attribution.priors import is_common
from surefoot.models.attribution.refinement import Data, contenders, refined, rerank
from surefoot.models.attribution.robust_weights import RobustWeights, robust_weights
from surefoot.models.attribution.selection import (
    Candidate,
    distinct,
    faked_share,
    judge,
    left_unseen,
    of_events,
)
from surefoot.models.attribution.split import REPORT, Split
from surefoot.models.bootstrap import block_draws
from surefoot.sim.effects import Effect, known_effects
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import Machine
from surefoot.sim.robot.limbs import Limbs


@dataclass(frozen=True)
class Found:
    """An effect with the 95 % interval of its size."""

    effect: Effect
    interval: tuple[float, float]


@dataclass(frozen=True)
class Attribution:
    """What was found: effects, strongest first; candidates by round; rivals of any effect;
    robust weights of the final evidence; floor: that of the model with the effects; refuted: the
    effects that explain a channel and make the drift of the legs worse."""

    found: tuple[Found, ...]
    rounds: tuple[tuple[Candidate, ...], ...]
    rivals: tuple[tuple[Key, float], ...]
    robust_weights: RobustWeights
    evidence: Evidence
    floor: NoiseFloor
    refuted: tuple[Key, ...] = ()


def attribute(
    cases: Sequence[LogUnderModel],
    floor: NoiseFloor,
    split: Split,
    rng: np.random.Generator,
    progress: Callable[[float], None] | None = None,
) -> Attribution:
    """Greedy search: add the candidate, or the pair, that gains most on unseen blocks while one
    earns its place.

    A candidate earns it if its gain's interval lies above zero, its size stands ABOVE_FLOOR times
    above the one it has on walks of the declared model, it is not at its bound, it adds a share
    WORTH of what the others explain or is CLEAR by itself, and it pays for its parameter and for
    having been one of many (extended BIC, blocks as samples).

    Args:
        cases: the logs under the declared model.
        floor: noise floor, from walks of the declared model.
        split: which blocks fit and which select.
        rng: draws the bootstrap's blocks.
        progress: called with the share done, from 0 to 1.
    """
    keys = tuple(dict.fromkeys(key for case in cases for key in all_keys(case)))
    settings, robot = cases[0].settings, cases[0].robot
    certain = _certain(keys, robot)
    chosen: list[Effect] = []
    refuted: list[tuple[Key, ...]] = []
    rounds: list[tuple[Candidate, ...]] = []
    rivals: tuple[tuple[Key, float], ...] = ()
    explained = 0.0
    evidence = None
    while True:
        if progress:
            progress(min(len(rounds) / (settings.most_effects + 1), 1.0))
        evidence, whole, weights, chosen = _settled(cases, chosen, keys, evidence, floor, split)
        limbs, found = evidence.layout.limbs, [_key(e) for e in chosen]
        sigma = floor.counted(weights.sigma, weights.alike)
        data = normal_equations(whole, sigma, weights.weight, split.part)
        candidates = judge(data, floor, found, explained, limbs, rng, certain)
        rounds.append(candidates)
        known = Data(cases, floor, evidence, chosen, weights, split.part)
        best, with_best = _next(known, data, candidates, certain, refuted, split.fit | split.select)
        if not best or len(chosen) >= settings.most_effects:
            break
        added = [c.key for c in best]
        others = distinct(data, candidates, limbs)
        for one in best:
            beside = [*found, *(key for key in added if key != one.key)]
            rivals += _rivals(data, one, others, beside, rng)
        gained = left_unseen(data, found) - left_unseen(data, [*found, *added])
        explained += float(np.sum(gained))
        chosen = with_best
        floor = noise_floor_with(floor, chosen)
    # What was found beside an effect is no other explanation of it.
    rivals = tuple(rival for rival in rivals if rival[0] not in found)
    out = tuple(key for keys in refuted for key in keys)
    sized = _with_intervals(data, chosen, floor)
    return Attribution(sized, tuple(rounds), rivals, weights, evidence, floor, out)


def _next(
    known: Data,
    data: NormalEquations,
    candidates: Sequence[Candidate],
    certain: Collection[Key],
    refuted: list[tuple[Key, ...]],
    use: np.ndarray,
) -> tuple[tuple[Candidate, ...], list[Effect]]:
    """The candidates, one or a pair, that are added next, and all effects at their sizes with them;
    none where none earns a place.

    Args:
        known: what sizes are refined on.
        data: normal equations of the blocks.
        candidates: of this round.
        certain: keys of effects that every machine has and the model lacks.
        refuted: keys of what made the drift of the legs worse, which grows.
        use: bins (M,) that fit and select.
    """
    found, limbs = [_key(e) for e in known.explained], known.evidence.layout.limbs
    while True:
        left = [c for c in candidates if (c.key,) not in refuted]
        if not left or not left[0].earned:
            return (), list(known.explained)
        left = _common_first(left, limbs, data.settings.single_part)
        # Contacts say which samples are of a stance: they come before what is fitted to these.
        timing = [c for c in left if c.earned and of_events(c.key)]
        few = [(c,) for c in contenders(data, distinct(data, left, limbs), found)]
        pairs = joint_pairs(data, known.floor, left, found, limbs, certain)
        few += [pair for pair in pairs if tuple(c.key for c in pair) not in refuted][
            : data.settings.pairs
        ]
        best, with_best = rerank(known, [(timing[0],)] if timing else few)
        if not adds_drift(known.cases, known.explained, with_best, use):
            return best, with_best
        refuted.append(tuple(c.key for c in best))


def _certain(keys: Sequence[Key], robot: Machine) -> set[Key]:
    """Of the candidates those that every machine has on each of its like parts, and the model
    lacks."""
    if not isinstance(robot, Robot):
        return set()
    kinds = known_effects()
    return {
        (name, target)
        for name, target in keys
        if kinds[name].is_certain(robot) and is_common(name, target, robot.limbs)
    }


def _common_first(
    candidates: Sequence[Candidate], limbs: Limbs, share: float
) -> Sequence[Candidate]:
    """The candidates, but for single parts where what all parts share explains about as much.

    Legs are of one make and carry one IMU: what they have in common comes first, and a part stands
    out from that. One by one, parts can make up for it.

    Args:
        candidates: of this round, those that earn a place first.
        limbs: of the machine.
        share: of the best part's score that something common has at least.
    """
    common = [c for c in candidates if is_common(*c.key, limbs)]
    parts = [c.score for c in candidates if c.earned and c not in common]
    if common and common[0].earned and common[0].score > share * max(parts, default=0.0):
        return common
    return candidates


def _settled(
    cases: Sequence[LogUnderModel],
    chosen: list[Effect],
    keys: Sequence[Key],
    evidence: Evidence | None,
    floor: NoiseFloor,
    split: Split,
) -> tuple[Evidence, Design, RobustWeights, list[Effect]]:
    """The evidence about the chosen effects, its robust weights, and their sizes with those.

    A large effect that is not linear spoils much of the evidence before it is explained.

    Args:
        cases: the logs under the declared model.
        chosen: effects found so far, with their sizes.
        keys: of all candidates.
        evidence: as far as it is linearised already, or None.
        floor: noise floor.
        split: which blocks fit and which select.
    """
    settings, times = cases[0].settings, 0
    while True:
        evidence = linearise(cases, chosen, keys, evidence)
        whole = design(evidence)
        weights = robust_weights(whole, floor.sigma)
        times += 1
        if not chosen or times == settings.settling_rounds:
            return evidence, whole, weights, chosen
        data = Data(cases, floor, evidence, chosen, weights, split.part)
        moved = refined(data, chosen, REPORT)
        pairs = list(zip(moved, chosen, strict=True))
        if all(abs(a.value - b.value) < settings.settled_share * abs(b.value) for a, b in pairs):
            return evidence, whole, weights, chosen
        chosen = moved


def _key(one: Effect) -> Key:
    return one.name, one.target


def _rivals(
    data: NormalEquations,
    best: Candidate,
    candidates: Sequence[Candidate],
    chosen: Sequence[Key],
    rng: np.random.Generator,
) -> tuple[tuple[Key, float], ...]:
    """Candidates inside their bounds that explain the unseen blocks as well as the best, with their
    overlap.

    Args:
        data: normal equations of the blocks.
        best: the candidate that is added.
        candidates: all of this round.
        chosen: keys of the effects found before it.
        rng: draws the bootstrap's blocks.
    """
    of_best = left_unseen(data, [*chosen, best.key])
    gained = float(np.sum(left_unseen(data, chosen) - of_best))
    counts = block_draws(len(of_best), rng)
    # What is no better by the price of one parameter is as good.
    price = np.log(max(2, len(of_best)))
    rivals = []
    for other in candidates:
        if other.key == best.key or other.at_bound:
            continue
        shared = overlap(data, best.key, other.key, chosen)
        if shared <= data.settings.twin_overlap:
            continue
        behind = left_unseen(data, [*chosen, other.key]) - of_best
        as_good = np.percentile(counts @ behind, 2.5) <= price
        if as_good and gained - np.sum(behind) > 0.5 * gained:
            rivals.append((other.key, shared))
    return tuple(rivals)


def _with_intervals(
    data: NormalEquations, chosen: Sequence[Effect], floor: NoiseFloor
) -> tuple[Found, ...]:
    """Effects by what they explain, with intervals from blocks and from the floor's own sizes."""
    keys = [_key(e) for e in chosen]
    used = data.rows(data.part != REPORT)
    covariance = fit(used, keys).covariance
    total = used.G.sum(axis=0)
    found = []
    for i, one in enumerate(chosen):
        offset, spread = floor.sizes([k for k in keys if k != keys[i]], keys[i])
        repeats = len(floor.repeats)
        faked = 1.96 * faked_share(keys[i], data.settings) * offset
        half = float(np.hypot(1.96 * np.sqrt(covariance[i, i]), faked))
        if repeats > 1:
            half = float(np.hypot(half, t.ppf(0.975, repeats - 1) * spread))
        at = 1 + data.keys.index(keys[i])
        strength = float(total[at, at] * one.value**2)
        found.append((strength, Found(one, (one.value - half, one.value + half))))
    return tuple(f for _, f in sorted(found, key=lambda pair: -pair[0]))
