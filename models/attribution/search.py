"""Stepwise search for the effects that the model lacks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from surefoot.models.attribution.drift import adds_drift
from surefoot.models.attribution.evidence import Evidence, Key, LogUnderModel, all_keys, linearise
from surefoot.models.attribution.fit import NormalEquations, design, fit, normal_equations, overlap
from surefoot.models.attribution.found import Found
from surefoot.models.attribution.levels import channel_gains, channel_levels, without_nuisance
from surefoot.models.attribution.noise_floor import (
    NoiseFloor,
    is_compensated_approximately,
    noise_floor_with,
)
from surefoot.models.attribution.priors import masked_candidates
from surefoot.models.attribution.refinement import (
    RefinementData,
    contenders,
    merge_into_groups,
    refine_jointly,
    refine_sizes,
    replace_implausible,
    rerank,
    selection_cost,
)
from surefoot.models.attribution.robust_weights import (
    RobustWeights,
    noisy_leg_columns,
    robust_weights,
)
from surefoot.models.attribution.run_fit import fit_runs
from surefoot.models.attribution.run_offsets import is_per_run, is_sampling_lag
from surefoot.models.attribution.selection import (
    Candidate,
    SearchState,
    cross_validated_error,
    distinct,
    evaluate_candidates,
)
from surefoot.models.attribution.split import REPORT, Split
from surefoot.models.bootstrap import block_bootstrap_counts
from surefoot.sim.effects import AXES, Effect, effect, known_effects
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine


@dataclass(frozen=True)
class Attribution:
    """Result of the search.

    Attributes:
        found: effects, strongest first.
        rounds: candidates of each round.
        rivals: key and overlap of the candidates that explain the data as well as an effect found.
        robust_weights: of the final evidence.
        evidence: with all effects compensated.
        floor: noise floor of the model with the effects.
        harmful: effects that were dropped, and the channel that each made worse.
    """

    found: tuple[Found, ...]
    rounds: tuple[tuple[Candidate, ...], ...]
    rivals: tuple[tuple[Key, float], ...]
    robust_weights: RobustWeights
    evidence: Evidence
    floor: NoiseFloor
    harmful: tuple[tuple[Effect, str], ...] = ()


def attribute(
    cases: Sequence[LogUnderModel],
    floor: NoiseFloor,
    split: Split,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda share: None,
) -> Attribution:
    """Greedy forward selection: add the best candidate on unseen blocks while one earns its place.

    A candidate earns its place if the interval of its gain lies above zero, its size is
    `least_size_ratio` times its spread on walks without the effect, it is not at a bound, it adds a
    share `least_added_share` of what the others explain or is `clear_ratio` times its spread, and
    the gain exceeds the price of its parameters in the extended BIC, with blocks as samples.
    Effects that every machine has are chosen first. A candidate that increases the drift of leg
    odometry is rejected. One that may be masked by a similar effect found before is fitted jointly
    with it (`_masked_candidate`), and is chosen where no other earns a place, or where the best
    other one leaves a larger error. Finally, effects are dropped whose interval contains zero, or
    that make a channel worse on the part that no fit has seen.

    Args:
        cases: the logs under the declared model.
        floor: noise floor, from walks of the declared model.
        split: which blocks fit and which select.
        rng: of the block bootstrap.
        progress: called with the share done, from 0 to 1.
    """
    keys = tuple(dict.fromkeys(key for case in cases for key in all_keys(case)))
    settings, certain = cases[0].settings, _always_present(keys, cases[0].robot)
    chosen: list[Effect] = []
    refuted: list[Key] = []
    instead: dict[Key, list[Effect]] = {}
    rounds: list[tuple[Candidate, ...]] = []
    rivals: tuple[tuple[Key, float], ...] = ()
    known, declared, use, plain = None, None, split.fit | split.select, floor
    while True:
        progress(min(len(rounds) / (settings.most_effects + 1), 1.0))
        known, data = _refined_until_settled(cases, chosen, keys, known, floor, split)
        declared, found = declared or known.evidence, [_key(e) for e in known.explained]
        explained, limbs = approximate_gains(known), known.evidence.layout.limbs
        state = SearchState(found, explained, certain)
        candidates = evaluate_candidates(data, floor, state, limbs, rng)
        rounds.append(candidates)
        if _causes(known.explained, cases) >= settings.most_effects:
            break
        candidates = tuple(c for c in candidates if c.key not in refuted)
        hidden = [key for key in masked_candidates(keys, found, limbs) if key not in refuted]
        # Effects that every machine has come first, or others would absorb them.
        first = tuple(c for c in candidates if c.earned and c.key in certain)
        candidates = first or candidates
        if candidates and candidates[0].earned:
            others = distinct(data, candidates, limbs)
            few = contenders(data, others, found)
            best, chosen_with, worse = rerank(known, few)
            # Linear regressors are unreliable next to a similar effect, so try the joint fit as
            # well.
            tried = {c.key for c in few}
            alike = [key for key in hidden if key[0] == best.key[0] and key not in tried]
            masked, jointly_with = _masked_candidate(known, explained, rng, alike)
            cost = selection_cost(known, chosen_with)
            jointly = masked is not None and selection_cost(known, jointly_with) < cost
            if masked and jointly:
                best, chosen_with = masked, jointly_with
        else:
            best, chosen_with = _masked_candidate(known, explained, rng, hidden)
            if best is None:
                break
            others, few, worse, jointly = (), (), (), True
        floor_with = noise_floor_with(plain, chosen_with)
        if adds_drift(cases, declared, known.evidence, chosen_with, use, floor_with):
            refuted.append(best.key)
            continue
        if not jointly:
            rivals += _rivals(data, best, [c for c in others if c.key not in worse], found, rng)
            instead[best.key] = [
                effect(*c.key, c.size)
                for c in few
                if c != best and overlap(data, best.key, c.key, found) > settings.twin_overlap
            ]
            chosen_with = merge_into_groups(known, replace_implausible(known, chosen_with, instead))
            floor_with = noise_floor_with(plain, chosen_with)
        chosen, floor = chosen_with, floor_with
    sized, harmful = _with_intervals(data, known.explained, floor), ()
    while True:
        # One at a time: effects added later may explain what an unsure one did.
        limbs = known.evidence.layout.limbs
        gone = [
            one.effect
            for one in sized
            if _is_insignificant(one, limbs, _key(one.effect) in certain)
        ]
        if not gone and (harm := find_harmful_effect(known)):
            gone, harmful = [harm[0]], (*harmful, harm)
        if not gone:
            break
        chosen = [e for e in known.explained if e != gone[-1]]
        floor = noise_floor_with(plain, chosen)
        known, data = _refined_until_settled(cases, chosen, keys, known, floor, split)
        sized = _with_intervals(data, known.explained, floor)
    # An effect that was found later is not a rival of another.
    named = [_key(e) for e in known.explained]
    rivals = tuple(rival for rival in rivals if rival[0] not in named)
    weights, evidence = known.robust_weights, known.evidence
    return Attribution(sized, tuple(rounds), rivals, weights, evidence, floor, harmful)


def find_harmful_effect(known: RefinementData) -> tuple[Effect, str] | None:
    """The first channel that the effects make worse (`ChannelLevel.worse`), and the effect whose
    removal improves it most; None where there is no such channel.

    Per-run effects are compensated on both sides, at each run's own size.

    Args:
        known: the evidence with all effects compensated, and the matching noise floor.
    """
    weights, unseen = known.robust_weights, known.part == REPORT
    several = known.evidence.settings.per_run_offsets
    own = [e for e in known.explained if several and is_per_run(e.name)]
    shared = [e for e in known.explained if e not in own]
    runs = fit_runs(known, shared, own) if own else ()
    cases = [run.case for run in runs] or known.cases

    def left(evidence: Evidence) -> np.ndarray:
        return without_nuisance(evidence, weights, ~unseen)[unseen]

    before = linearise(cases, (), ())
    after = linearise(cases, shared, ()) if own else known.evidence
    levels = channel_levels(left(before), left(after), after, known.floor)
    worse = next((name for name, level in levels.items() if level.worse), None)
    if worse is None or not shared:
        return None

    def without(one: Effect) -> float:
        others = linearise(cases, [e for e in shared if e != one], ())
        return float(np.nanmean(left(others)[:, before.layout.of(worse)] ** 2))

    return min(shared, key=without), worse


LINK = ("link_mass", "link_com", "link_inertia")
"""What a load changes of the link that it is tied to."""


def _causes(explained: Sequence[Effect], cases: Sequence[LogUnderModel]) -> int:
    """Number of effects, as counted against `most_effects`.

    On a fixed base, mass, centre and inertia of one link count as one: a load changes them all.
    Lags within a row count as none.
    """
    if not all(case.fixed for case in cases):
        return len(explained)
    slowest = min(case.log.rate for case in cases)
    joints = cases[0].robot.limbs.joints
    causes = set()
    for one in explained:
        if is_sampling_lag(one, slowest):
            continue
        link = next((j for j in joints if one.target in (j, *(f"{j}_{a}" for a in AXES))), "")
        causes.add(link if one.name in LINK and link else _key(one))
    return len(causes)


def _is_insignificant(one: Found, limbs: Limbs, certain: bool) -> bool:
    """Whether an effect is insignificant: at a lower bound above zero, or with zero inside its 95 %
    interval; of one that every machine has for `certain`, within one standard error.
    """
    low, value = type(one.effect).interior_bounds(one.effect.target, limbs)[0], one.effect.value
    at_none = low > 0.0 and value <= low
    share = 1.0 / 1.96 if certain else 1.0
    begin, end = (value + share * (x - value) for x in one.interval)
    return at_none or begin <= 0.0 <= end


def _always_present(keys: Sequence[Key], robot: Machine) -> set[Key]:
    """Candidates that every machine has, and that the model lacks."""
    if robot.fixed:
        return set()
    kinds = known_effects()
    return {(name, target) for name, target in keys if kinds[name].is_always_present(target, robot)}


def approximate_gains(known: RefinementData) -> dict[str, float]:
    """Reduction of each channel's error, outside REPORT, by the effects found that a model
    compensates only approximately.

    Sensor errors are compensated exactly and leave nothing for others to absorb.
    """
    exact = [e for e in known.explained if not is_compensated_approximately(e)]
    if len(exact) == len(known.explained):
        return {}
    weight = known.robust_weights.weight * (known.part != REPORT)[:, None]
    without = linearise(known.cases, exact, ())
    gains = channel_gains(without, known.evidence.only(()), weight, known.effective_noise)
    return {name: float(gain.sum()) for name, gain in gains.items()}


def _masked_candidate(
    known: RefinementData,
    explained: Mapping[str, float],
    rng: np.random.Generator,
    keys: Sequence[Key],
) -> tuple[Candidate | None, list[Effect]]:
    """The best of `keys` that earns its place when fitted jointly with a similar effect found
    before, and all effects with it.

    (None, []) where there is none, or the legs' residual is near its noise floor. Every leg is
    compliant and every foot rolls; only by how much is in question.

    Args:
        known: the evidence and the effects found so far.
        explained: channel -> reduction of its error (`approximate_gains`).
        rng: of the block bootstrap.
        keys: candidates that may be masked (`priors.masked_candidates`).
    """
    layout, every = known.evidence.layout, known.evidence.keys
    chosen, limbs = [_key(e) for e in known.explained], layout.limbs
    best: tuple[Candidate | None, list[Effect]] = (None, [])
    far = known.evidence.settings.far_ratio
    if not len(noisy_leg_columns(layout, known.robust_weights.sigma, known.floor.sigma, far)):
        return best
    for key in keys:
        data, effects = refine_jointly(known, key)
        state = SearchState(chosen, explained, {key}, len(every))
        one = evaluate_candidates(data, known.floor, state, limbs, rng)[0]
        if one.earned and (best[0] is None or one.score > best[0].score):
            best = one, effects
    return best


def _refined_until_settled(
    cases: Sequence[LogUnderModel],
    chosen: Sequence[Effect],
    keys: Sequence[Key],
    before: RefinementData | None,
    floor: NoiseFloor,
    split: Split,
) -> tuple[RefinementData, NormalEquations]:
    """Refine the chosen effects and the robust weights in turn until the sizes settle.

    A large nonlinear effect distorts much of the evidence until it is compensated.

    Args:
        cases: the logs under the declared model.
        chosen: effects found so far, with their sizes.
        keys: of all candidates.
        before: data whose derivatives may be reused, or None.
        floor: noise floor.
        split: which blocks fit and which select.

    Returns:
        The data with the effects compensated, and their normal equations.
    """
    settings, times = cases[0].settings, 0
    evidence = before.evidence if before else None
    while True:
        evidence = linearise(cases, chosen, keys, evidence)
        whole = design(evidence)
        weights = robust_weights(whole, floor.sigma)
        data = RefinementData(cases, floor, evidence, chosen, weights, split.part)
        times += 1
        if not chosen or times == settings.settling_rounds:
            break
        moved = refine_sizes(data, chosen, REPORT)
        pairs = list(zip(moved, chosen, strict=True))
        if all(
            abs(a.value - b.value) < settings.settling_tolerance * abs(b.value) for a, b in pairs
        ):
            break
        chosen = moved
    return data, normal_equations(whole, data.effective_noise, weights.weight, split.part)


def _key(one: Effect) -> Key:
    return one.name, one.target


def _rivals(
    data: NormalEquations,
    best: Candidate,
    candidates: Sequence[Candidate],
    chosen: Sequence[Key],
    rng: np.random.Generator,
) -> tuple[tuple[Key, float], ...]:
    """Candidates that explain the unseen blocks as well as the best, with their overlap with it.

    Args:
        data: normal equations of the blocks.
        best: the candidate that is added.
        candidates: all of this round.
        chosen: keys of the effects found before it.
        rng: of the block bootstrap.
    """
    of_best = cross_validated_error(data, [*chosen, best.key])
    gained = float(np.sum(cross_validated_error(data, chosen) - of_best))
    counts = block_bootstrap_counts(len(of_best), rng)
    # Candidates within the price of one parameter are equally good.
    price = np.log(max(2, len(of_best)))
    rivals = []
    for other in candidates:
        if other.key == best.key or other.at_bound:
            continue
        shared = overlap(data, best.key, other.key, chosen)
        if shared <= data.settings.twin_overlap:
            continue
        behind = cross_validated_error(data, [*chosen, other.key]) - of_best
        as_good = (
            np.percentile(counts @ behind, 2.5) <= price or shared > data.settings.identical_overlap
        )
        if as_good and gained - np.sum(behind) > 0.5 * gained:
            rivals.append((other.key, shared))
    return tuple(rivals)


def _with_intervals(
    data: NormalEquations, chosen: Sequence[Effect], floor: NoiseFloor
) -> tuple[Found, ...]:
    """Effects, strongest first, with intervals from the blocks and the spread on the floor's
    walks.
    """
    keys = [_key(e) for e in chosen]
    used = data.rows(data.part != REPORT)
    covariance = fit(used, keys).covariance
    total = used.G.sum(axis=0)
    found = []
    for i, one in enumerate(chosen):
        offset, spread = floor.sizes([k for k in keys if k != keys[i]], keys[i])
        repeats = len(floor.walks)
        faked = 1.96 * floor.size_uncertainty(keys[i], offset)
        half = float(np.hypot(1.96 * np.sqrt(covariance[i, i]), faked))
        if repeats > 1:
            half = float(np.hypot(half, stdtrit(repeats - 1, 0.975) * spread))
        elif floor.run_variation:
            half = float(np.hypot(half, 1.96 * spread))
        at = 1 + data.keys.index(keys[i])
        strength = float(total[at, at] * one.value**2)
        found.append((strength, Found(one, (one.value - half, one.value + half))))
    return tuple(f for _, f in sorted(found, key=lambda pair: -pair[0]))
