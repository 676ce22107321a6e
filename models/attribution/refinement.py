"""Nonlinear refinement of effects' sizes, and selection among nearly collinear candidates.

Hardly any effect is linear in its size. A delay of the IMU, for instance, looks like an advance of
the reference in the channels where both appear, which have by far the highest signal-to-noise
ratio. Only the legs distinguish the two, and they matter only if interpolation errors between rows
do not decide the choice first.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from surefoot.models.attribution.evidence import Evidence, Key, LogUnderModel, linearise, table_of
from surefoot.models.attribution.fit import NormalEquations, design, fit, loss, normal_equations
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.attribution.priors import prior_penalty
from surefoot.models.attribution.robust_weights import RobustWeights
from surefoot.models.attribution.selection import Candidate, cross_validated_error
from surefoot.models.attribution.split import REPORT
from surefoot.models.bootstrap import block_bootstrap_counts
from surefoot.models.residuals.command import commanded_torque
from surefoot.sim.effects import Effect, effect, known_effects
from surefoot.sim.robot.limbs import Limbs


@dataclass(frozen=True)
class RefinementData:
    """Data on which sizes are refined.

    Attributes:
        cases: the logs under the declared model.
        floor: noise floor.
        evidence: with `explained` compensated.
        explained: effects found so far.
        robust_weights: of the evidence.
        part: part of the split of each bin (M,), as in `Split.part`.
    """

    cases: Sequence[LogUnderModel]
    floor: NoiseFloor
    evidence: Evidence
    explained: Sequence[Effect]
    robust_weights: RobustWeights
    part: np.ndarray

    def normal_equations(self, evidence: Evidence) -> NormalEquations:
        """Normal equations of an evidence, with the noise and weights of this one."""
        weight = self.robust_weights.weight
        return normal_equations(design(evidence), self.effective_noise, weight, self.part)

    def count_blocks(self, report: int) -> int:
        """Number of blocks outside the part `report`."""
        sums = self.normal_equations(self.evidence.only(()))
        return int(np.count_nonzero(sums.part != report))

    @property
    def effective_noise(self) -> np.ndarray:
        """Effective noise (W,) of the columns in a fit."""
        return self.floor.effective_noise(self.robust_weights.sigma, self.robust_weights.alike)


def refine_sizes(data: RefinementData, chosen: Sequence[Effect], report: int) -> list[Effect]:
    """Refine the sizes of effects on all blocks but those of the part `report`.

    Gauss-Newton iterations, which recompute derivatives only after a size has moved far.
    """
    return _refined(data, chosen, report)[0]


def _refined(
    data: RefinementData, chosen: Sequence[Effect], report: int
) -> tuple[list[Effect], Evidence]:
    """The refined effects, and the evidence linearised one step before them."""
    limbs = data.evidence.layout.limbs
    chosen = [with_clipped_size(e, e.value, limbs) for e in chosen]
    settings, keys = data.evidence.settings, [(e.name, e.target) for e in chosen]
    offsets, evidence = _offsets(data.floor, keys), data.evidence.only(keys)
    known = keys == [(e.name, e.target) for e in data.explained]
    derived = compensated = list(data.explained) if known else []
    for _ in range(settings.newton_steps):
        if _has_moved(derived, chosen, settings.relinearise_share):
            evidence, derived = (
                linearise(data.cases, chosen, keys, evidence, evaluation_channels=False),
                chosen,
            )
        elif compensated != chosen:
            tables = [table_of(case, chosen, evaluation_channels=False) for case in data.cases]
            evidence = replace(evidence, table=np.concatenate(tables))
        compensated = chosen
        sums = data.normal_equations(evidence)
        sums = sums.rows(sums.part != report)
        steps = fit(sums, keys, errors=False).sizes - offsets
        moved = [
            with_clipped_size(e, e.value + d, limbs) for e, d in zip(chosen, steps, strict=True)
        ]
        settled = not _has_moved(chosen, moved, settings.newton_tolerance)
        chosen = moved
        if settled:
            break
    return chosen, evidence


def _has_moved(before: Sequence[Effect], after: Sequence[Effect], share: float) -> bool:
    """Whether a size has changed by this relative amount, or there are no sizes `before`."""
    pairs = zip(before, after, strict=False)
    return not before or any(abs(a.value - b.value) >= share * abs(b.value) for a, b in pairs)


def remaining_error(data: RefinementData, chosen: Sequence[Effect], report: int) -> np.ndarray:
    """Weighted squared error (K,) of each block outside the part `report`, with the effects
    refitted linearly about their sizes.
    """
    keys = [(e.name, e.target) for e in chosen]
    evidence = data.evidence.only(keys)
    if list(chosen) != list(data.explained):
        evidence = linearise(data.cases, chosen, keys, evidence, evaluation_channels=False)
    return _error_of_fit(data, evidence, report)


def _error_of_fit(data: RefinementData, evidence: Evidence, report: int) -> np.ndarray:
    """Weighted squared error (K,) of each block outside the part `report`, with all candidates of
    the evidence fitted linearly.
    """
    sums = data.normal_equations(evidence)
    sums = sums.rows(sums.part != report)
    return loss(sums, fit(sums, evidence.keys, errors=False).vector)


def _offsets(floor: NoiseFloor, keys: Sequence[Key]) -> np.ndarray:
    """Apparent sizes (C,) of these candidates, fitted together, on walks without the effects."""
    return np.array([floor.sizes([k for k in keys if k != key], key)[0] for key in keys])


def with_clipped_size(one: Effect, value: float, limbs: Limbs) -> Effect:
    """The effect with its value clipped to its bounds on a machine with these limbs."""
    return replace(one, value=float(np.clip(value, *type(one).interior_bounds(one.target, limbs))))


def refine_jointly(data: RefinementData, key: Key) -> tuple[NormalEquations, list[Effect]]:
    """Refine a candidate together with the effects found.

    Needed for effects that resemble one another: while only one of them is compensated it absorbs a
    part of the other, and linear regressors are unreliable.

    Returns:
        The normal equations of the problem linearised at the refined sizes, with sizes counted from
        zero, and the effects.
    """
    effects = refine_sizes(data, [*data.explained, effect(*key, 0.0)], REPORT)
    keys = [(e.name, e.target) for e in effects]
    evidence = linearise(data.cases, effects, keys, evaluation_channels=False)
    table = evidence.table.copy()
    for one, regressor in zip(effects, evidence.X, strict=True):
        table[:, regressor.columns] += one.value * regressor.values
    return data.normal_equations(replace(evidence, table=table)), effects


def contenders(
    data: NormalEquations, candidates: Sequence[Candidate], chosen: Sequence[Key]
) -> list[Candidate]:
    """The few candidates that might be the best, by score.

    Those that earn a place with nearly the best score, and those too small to earn one alone that
    explain all that the best does and more.
    """
    earned = [c for c in candidates if c.earned]
    near = [c for c in earned if c.score > data.settings.near_best_share * earned[0].score]
    near += [c for c in candidates if earned and _outdoes(data, c, earned[0], chosen)]
    return sorted(near, key=lambda c: -c.score)[: data.settings.contenders]


def _outdoes(data: NormalEquations, one: Candidate, best: Candidate, chosen: Sequence[Key]) -> bool:
    """Whether a candidate that did not earn a place gains more than the best that did, and leaves
    little for that one to explain.
    """
    sized = abs(one.size) > data.settings.contender_size_ratio * np.hypot(one.error, one.floor)
    if one.earned or one.at_bound or not sized or one.interval[0] <= best.gain:
        return False
    alone, both = (
        0.5 * float(cross_validated_error(data, [*chosen, *keys]).sum())
        for keys in ((one.key,), (one.key, best.key))
    )
    return alone - both < data.settings.least_own_share * best.gain


def rerank(
    data: RefinementData, few: Sequence[Candidate]
) -> tuple[Candidate, list[Effect], tuple[Key, ...]]:
    """Select the candidate that leaves the smallest error on the true residual.

    All effects are refined along with each candidate. The IMU, and torques against commands, are
    weighted by how well they are known between rows. If the difference to the best is within
    chance, a candidate whose size is likelier by more than `positive_evidence` is preferred.

    Returns:
        The candidate, all effects with it, and the keys of the candidates that are significantly
        worse.
    """
    before = list(data.explained)
    refined = [_refined(data, [*before, effect(*c.key, c.size)], REPORT) for c in few]
    tried = [(c, chosen) for c, (chosen, _) in zip(few, refined, strict=True)]
    if len(tried) == 1:
        return (*tried[0], ())
    weight = data.robust_weights.weight * interpolation_weights(data)
    fair = replace(data, robust_weights=replace(data.robust_weights, weight=weight))
    left = [_error_of_fit(fair, evidence, REPORT) for _, evidence in refined]
    penalty = [_size_penalty(candidate, chosen[-1], data) for candidate, chosen in tried]
    best = min(range(len(tried)), key=lambda i: float(left[i].sum()) + penalty[i])
    counts = block_bootstrap_counts(len(left[best]), np.random.default_rng(0))
    behind = [float(np.percentile(counts @ (one - left[best]), 2.5)) for one in left]
    least = data.evidence.settings.positive_evidence
    likelier = [
        i for i, one in enumerate(penalty) if behind[i] <= 0.0 and penalty[best] - one > least
    ]
    found, chosen = tried[min(likelier, key=lambda i: penalty[i], default=best)]
    # Compensating a scale also scales the noise; differences of a few percent are insignificant.
    differs = (data.evidence.settings.at_floor_ratio - 1.0) * float(left[best].sum())
    worse = tuple(c.key for (c, _), by in zip(tried, behind, strict=True) if by > differs)
    return found, chosen, worse


def _size_penalty(candidate: Candidate, newest: Effect, data: RefinementData) -> float:
    """Penalty on the refined size of a candidate, unless its kind has none."""
    if candidate.prior_penalty < 0.0:
        return candidate.prior_penalty
    return prior_penalty(newest.name, newest.target, newest.value, data.evidence.layout.limbs)


def replace_implausible(
    data: RefinementData, chosen: Sequence[Effect], instead: Mapping[Key, Sequence[Effect]]
) -> list[Effect]:
    """Replace effects whose refitted size has become implausible.

    Two effects at one joint may grow in opposite directions to fit an error of another kind. An
    effect with such a size is replaced by one that was nearly collinear with it when it was chosen,
    if that lowers the total cost.

    Args:
        data: the evidence on which sizes are refined.
        chosen: effects found so far, with their sizes.
        instead: for each effect's key, its nearly collinear alternatives.
    """
    chosen, limbs = list(chosen), data.evidence.layout.limbs

    for i, one in enumerate(chosen[:-1]):
        others = instead.get((one.name, one.target), ())
        penalty = prior_penalty(one.name, one.target, one.value, limbs)
        if not others or penalty <= data.evidence.settings.positive_evidence:
            continue
        tried = [[*chosen[:i], other, *chosen[i + 1 :]] for other in others]
        chosen = min(
            [chosen, *(refine_sizes(data, effects, REPORT) for effects in tried)],
            key=lambda effects: selection_cost(data, effects),
        )
    return chosen


def selection_cost(data: RefinementData, effects: Sequence[Effect]) -> float:
    """Cost of a set of effects, -2 log of likelihood and prior: remaining error plus penalties."""
    limbs = data.evidence.layout.limbs
    penalty = sum(prior_penalty(e.name, e.target, e.value, limbs) for e in effects)
    return float(remaining_error(data, effects, REPORT).sum()) + penalty


def merge_into_groups(data: RefinementData, chosen: Sequence[Effect]) -> list[Effect]:
    """Merge effects of one name on several parts into one on the smallest group that has them all,
    where the saved parameters outweigh the larger error.

    Found one after the other, the members of a group have different sizes, each fitted beside those
    found before it.
    """
    chosen, limbs = list(chosen), data.evidence.layout.limbs
    # BIC's price of a parameter, and of choosing it among many (`selection.evaluate_candidates`).
    choice = 2.0 * np.log(len(data.evidence.keys))
    for name in {e.name for e in chosen}:
        kind, alike = known_effects()[name], [e for e in chosen if e.name == name]
        parts = {part for e in alike for part in kind.members_of(e.target, limbs)}
        covers = {t: set(of) for t, of in kind.group_targets(limbs).items() if parts <= set(of)}
        if len(alike) < 2 or not covers:
            continue
        price = choice + np.log(max(2, data.count_blocks(REPORT)))
        target = min(covers, key=lambda t: len(covers[t]))
        one = effect(name, target, float(np.median([e.value for e in alike])))
        tried = refine_sizes(data, [one, *(e for e in chosen if e.name != name)], REPORT)
        if selection_cost(data, tried) < selection_cost(data, chosen) + (len(alike) - 1) * price:
            chosen = tried
    return chosen


def interpolation_weights(data: RefinementData) -> np.ndarray:
    """Weights (M, W) in 0..1 for the interpolation error of streams that are shifted in time.

    Linear interpolation between rows errs by up to an eighth of the second difference, and as much
    again when the shift is undone; at touchdown that is far more than the noise. Compensating a
    delay of the other stream instead causes the error only once, which would bias the choice. The
    second differences come from the IMU's readings, since a reference may have been smoothed, and
    from commanded torques, which are free of noise. Unlike noise, the error differs between
    candidates, so a bin in which it dominates is practically dropped.
    """
    weight, begin = np.ones_like(data.robust_weights.weight), 0
    imu = data.evidence.layout.of("imu_gyro", "imu_accel")
    command = data.evidence.layout.of("command")
    for case in data.cases:
        log, first, count = case.log, case.motion.first, case.motion.count[:, None]
        rows = begin + np.arange(len(first))
        begin += len(first)
        moved = []
        if log.has("imu") and not case.fixed:
            moved.append((imu, np.hstack([log.gyro, log.accel])))
        if (asked := commanded_torque(log)) is not None:
            moved.append((command, asked))
        for columns, x in moved:
            if not len(columns):
                continue
            lost = np.zeros_like(x)
            lost[1:-1] = 2 / 8 * (x[2:] - 2.0 * x[1:-1] + x[:-2])
            square = np.add.reduceat(lost**2, first, axis=0) / count**2
            noise = data.robust_weights.sigma[columns] ** 2
            weight[np.ix_(rows, columns)] = (noise / (noise + square)) ** 2
    return weight
