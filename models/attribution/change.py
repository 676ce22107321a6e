"""What changed of a machine since the runs that its model was calibrated on.

Explanations are compared by the evidence of the new runs for each: the marginal likelihood of their
residuals, relative to that of the unchanged machine, whose covariance is that of the model's
error, of zeros and of noise (`model_error`). An explanation is an effect alone, all that a load
changes of a link, or an error of the sensor of a joint's angle. No change of the machine is named
where an error of a sensor explains the runs about as well.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from surefoot.models.attribution.design import design
from surefoot.models.attribution.effect_sizes import (
    Found,
    interior_bounds,
    is_sampling_lag,
    plausible_size,
    with_clipped_size,
    with_deviation,
)
from surefoot.models.attribution.evidence import (
    Evidence,
    Key,
    LogUnderModel,
    linearise,
    slowest_rate,
)
from surefoot.models.attribution.explain import NAMED, least_excess, least_named
from surefoot.models.attribution.forces import Push, outside_forces, pushed_bins
from surefoot.models.attribution.judgement import NOISE_RATIO, ChannelLevel
from surefoot.models.attribution.metric import Metric, metric_of, noise_of
from surefoot.models.attribution.model_error import (
    ANGLE_ERROR,
    MEAN_WINDOW,
    NOTHING,
    PER_RUN,
    ZERO,
    ModelError,
    at_middles,
    evidence_of,
)
from surefoot.models.residuals.binning import BIN
from surefoot.models.residuals.channels import channels
from surefoot.sim.effects import AXES, effect, known_effects
from surefoot.sim.log import LogError, MemoisedLog
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine

AS_LIKELY = 2.0 * np.log(20.0)
"""Twice the logarithm of the odds up to which another explanation is as good: twenty to one."""
SURE = 1.645
"""Standard deviations above the limit at which a change is named in 95 of 100 runs."""
LOAD = ("link_mass", "link_com", "link_inertia")
"""What a load changes of the link that it is tied to."""
CONTRADICTION = 3.0
"""Ratio to unchanged runs from which a joint's angle and rate contradict each other."""
ANGLE_DRIFT = 0.03
"""Standard deviation of the drift of an angle [rad/s]: 0.01 to 0.06 rad within swings of two
seconds were measured of one attitude filter.
"""
ANGLE_SHARE = 0.05
"""Standard deviation of the shares of angles in an angle's error: gyro and attitude of that machine
differ by up to 5 %.
"""
ATTITUDE = 0.05
"""Standard deviation of an attitude or of a zero that is in error [rad]. One that was lost may be
anywhere.
"""
CONTENDERS = 6
"""Explanations that are refined on the true residual."""
REFINEMENTS = 4
"""Gauss-Newton steps of each."""
FAR = 0.2
"""Size of a zero from which the residual is not linear in it [rad]."""
FAR_STARTS = (-2.8, -2.0, -1.2, -0.4, 0.4, 1.2, 2.0, 2.8)
"""Zeros from which a far one is refined [rad]."""
_ROUNDS = 3
"""Most rounds in which the noise is adapted to what the best explanation leaves."""
_AS_UNCHANGED = 1.05
"""Ratio of what it leaves to the noise at which it is as in the unchanged runs."""
_NEAR = 0.3
"""Share of the best evidence from which an explanation may turn out better in the refinement."""


@dataclass(frozen=True)
class Hypothesis:
    """One explanation of the runs.

    Attributes:
        keys: of its k sizes.
        part: what it is of: the targets of an effect, or the joint whose sensor is in error.
        sizes: (k,).
        deviations: standard deviations of the sizes (k,), as the runs tell them.
        excess: the sizes in standard deviations, all of them together (Mahalanobis).
        evidence: twice the logarithm of its odds against the unchanged machine.
        gain: reduction of the runs' squared error by it.
        overlap: cosine between its first regressor and that of the explanation it is a rival of.
    """

    keys: tuple[Key, ...]
    part: frozenset[str]
    sizes: np.ndarray
    deviations: np.ndarray
    excess: float
    evidence: float
    gain: float
    overlap: float = 1.0

    @property
    def of_sensor(self) -> bool:
        """Whether it is an error of a sensor."""
        first, last = self.keys[0][0], self.keys[-1][0]
        return last == ANGLE_ERROR or known_effects()[first].traced.belongs_to != "machine"


@dataclass(frozen=True)
class Change:
    """What changed.

    Attributes:
        verdict: unchanged, attributed, confounded or not_identifiable.
        reasons: why it is not better.
        found: effects of the change that is named.
        rivals: other explanations that are as good.
        least: for each effect, the least size that would have been named in 95 of 100 such runs.
        channels: residual of each channel, before and after the model's error, the runs' own zeros
            and the change are compensated, beside the noise that unchanged runs have.
        zeros: of each run.
        pushes: outside forces, during which nothing is judged.
    """

    verdict: str
    reasons: tuple[str, ...]
    found: tuple[Found, ...]
    rivals: tuple[Hypothesis, ...]
    least: dict[Key, float]
    channels: dict[str, ChannelLevel] = field(default_factory=dict)
    zeros: tuple[tuple[Found, ...], ...] = ()
    pushes: tuple[Push, ...] = ()


def find_change(cases: Sequence[LogUnderModel], known: ModelError) -> Change:
    """Compare the explanations of new runs, with the declared effects compensated in `cases`.

    Raises LogError where the runs have other readings than those that the model's error is of.
    """
    evidence, rates = evidence_of(cases)
    there = np.flatnonzero(np.isfinite(evidence.table).any(axis=0))
    shown = {evidence.layout.kinds[c] for c in there}
    lacking = {g for g in known.noise if g not in shown and not channels()[g[0]].on_level_ground}
    if lacking or {*known.keys} - {*evidence.keys}:
        names = ", ".join(dict.fromkeys(channel for channel, _ in lacking)) or "other effects"
        raise LogError(
            f"{cases[0].log.name}: its readings differ from those of the runs that the declared "
            f"effects were found in ({names})"
        )
    known = replace(known, noise={g: x for g, x in known.noise.items() if g in shown})
    found, new = _best(cases, evidence, rates, known, np.ones(len(evidence.t), dtype=bool))
    if pushes := _pushes(new, known, found.found):
        # What changed is judged on the rest.
        rest = ~pushed_bins(cases, evidence, pushes)
        found, new = _best(cases, evidence, rates, known, rest)
    beyond = tuple(one.in_words() for one in pushes) or _noisier(new, known)
    if found.verdict == "unchanged" and beyond:
        found = replace(found, verdict="not_identifiable", reasons=beyond)
    return replace(
        found,
        channels=_levels(new, found.found),
        zeros=_zeros(new, found.found),
        pushes=pushes,
    )


@dataclass(frozen=True)
class _NewRuns:
    """New runs, and the metric of what they are if nothing changed."""

    cases: Sequence[LogUnderModel]
    known: ModelError
    metric: Metric

    @property
    def machine(self) -> Machine:
        """The declared model of the first log, to which all belong."""
        return self.cases[0].robot

    @property
    def limbs(self) -> Limbs:
        """Limbs of the machine."""
        return self.machine.limbs

    @property
    def keys(self) -> tuple[Key, ...]:
        """Name and target of each candidate (C,)."""
        return self.metric.known.keys

    def sizes(self, found: Sequence[Found]) -> np.ndarray:
        """Sizes of all candidates with these effects (C,)."""
        sizes = np.zeros(len(self.keys))
        for one in found:
            sizes[self.keys.index((one.effect.name, one.effect.target))] = one.effect.value
        return sizes

    def left(self, found: Sequence[Found]) -> np.ndarray:
        """True residual (M, W) with these effects, less the zeros and the error of the model."""
        effects = [one.effect for one in found]
        data = design(evidence_of(self.cases, effects)[0]) if effects else self.metric.data
        return replace(self.metric, data=data).left(np.zeros(len(self.keys)))

    def overlap(self, one: Key, other: Key) -> float:
        """Cosine (0 to 1) between the regressors of two candidates."""
        S = self.metric.S
        i, j = (1 + self.keys.index(key) for key in (one, other))
        return float(abs(S[i, j]) / np.sqrt(S[i, i] * S[j, j]))

    def at(self, keys: Sequence[Key], sizes: np.ndarray) -> np.ndarray:
        """Products (1 + k, 1 + k) of the true residual with these k sizes compensated and of its
        derivatives; a zero, which stands alone, may be beyond its bounds.
        """
        cases, chosen = self.cases, []
        if _is_lost_zero(keys):
            column = f"q_{keys[0][1]}"
            logs = [c.log.with_columns({column: c.log.columns[column] - sizes[0]}) for c in cases]
            cases = [replace(c, log=MemoisedLog.of(x)) for c, x in zip(cases, logs, strict=True)]
        else:
            chosen = [effect(*key, x) for key, x in zip(keys, sizes, strict=True)]
        evidence = linearise(cases, chosen, keys, evaluation_channels=False, nuisance=False)
        if cases[0].fixed:
            evidence = at_middles(evidence)
        return self.metric.products(evidence.table, evidence.X)


def _levels(new: _NewRuns, found: Sequence[Found]) -> dict[str, ChannelLevel]:
    """Residual of each channel over all runs."""
    metric, layout, out = new.metric, new.metric.known.layout, {}
    before, after = metric.left(np.zeros(len(new.keys)), terms=False), new.left(found)
    noise = np.broadcast_to(noise_of(new.known, layout), before.shape)
    for channel in dict.fromkeys(channel for channel, _ in new.known.noise):
        columns = np.intersect1d(layout.of(channel), metric.columns)
        there = metric.root[:, columns] > 0.0
        sides = [
            float(np.sqrt(np.mean(one[:, columns][there] ** 2))) for one in (before, after, noise)
        ]
        units = dict.fromkeys(c.unit for c in layout.columns[layout.channels[channel]])
        out[channel] = ChannelLevel(*sides, unit=" and ".join(units))
    return out


def _zeros(new: _NewRuns, found: Sequence[Found]) -> tuple[tuple[Found, ...], ...]:
    """Zeros of each run beside the change."""
    keys = [key for key in new.keys if key[0] == ZERO and new.metric.belongs_to_log(key)]
    return tuple(
        tuple(
            with_deviation(key, x, e, new.machine) for key, (x, e) in zip(keys, zeros, strict=True)
        )
        for zeros in new.metric.zeros(keys, new.sizes(found))
    )


def _best(
    cases: Sequence[LogUnderModel],
    evidence: Evidence,
    rates: Sequence[Mapping[str, float]],
    known: ModelError,
    used: np.ndarray,
) -> tuple[Change, _NewRuns]:
    """The change that the bins of a mask `used` (M,) tell, without residuals, and the runs."""

    def tried(known: ModelError) -> tuple[_NewRuns, list[Hypothesis]]:
        metric = metric_of(cases, evidence, known, used, PER_RUN, not cases[0].fixed)
        new = _NewRuns(cases, known, metric)
        return new, _ranked(new)

    new, first = tried(known)
    for _ in range(_ROUNDS):
        # What the best explanation leaves is noise that the unchanged runs did not have.
        entries = np.count_nonzero(new.metric.root)
        left = np.sqrt((new.metric.S[0, 0] - first[0].gain) / entries)
        if left < _AS_UNCHANGED:
            break
        known = replace(known, noise={group: left * x for group, x in known.noise.items()})
        new, first = tried(known)
    sensors = [one.keys for one in first if one.of_sensor]
    least = {one.keys[0]: _least(one, sensors, new) for one in first if len(one.keys) == 1}
    if contradicted := _contradicted(rates, known):
        return Change("not_identifiable", contradicted, (), (), least), new
    # Of explanations that are about as good, the one of the fewest parts and sizes.
    as_good = [one for one in first if one.evidence > first[0].evidence - AS_LIKELY]
    alike = [one for one in as_good if one.of_sensor == first[0].of_sensor]
    inside = [one for one in alike if one.part <= first[0].part]
    # That several parts change by the same size is less likely than that one of them does.
    inside += [
        one
        for one in first
        if one.part < first[0].part
        and one.of_sensor == first[0].of_sensor
        and one.evidence > max(first[0].evidence - NAMED, NAMED)
    ]
    best = min(inside, key=lambda one: (len(one.part), len(one.keys)))
    if best.evidence <= first[0].evidence - AS_LIKELY:
        as_good = [one for one in first if abs(one.evidence - best.evidence) < AS_LIKELY]
    named = best.evidence >= NAMED and best.excess >= least_excess(known)
    if not named or _is_sampling_lag(best, new.machine, slowest_rate(cases)):
        return Change("unchanged", (), (), (), least), new
    rivals = tuple(
        replace(one, overlap=new.overlap(one.keys[0], best.keys[0]))
        for one in _distinct([one for one in as_good if one is not best], best)
    )
    low, high = interior_bounds(*best.keys[0], new.machine)
    if _is_lost_zero(best.keys) and not low < best.sizes[0] < high:
        return Change("not_identifiable", (_words(best),), (), rivals, least), new
    sensors = [one for one in (best, *rivals) if one.of_sensor]
    if sensors and not (best.of_sensor and len(best.keys) == 1):
        reasons = tuple(f"{_words(one)} explains these runs as well" for one in (*sensors, *rivals))
        reasons = tuple(dict.fromkeys(reasons))
        return Change("not_identifiable", reasons, (), rivals, least), new
    verdict = "confounded" if rivals else "attributed"
    return Change(verdict, (), _found(best, new.machine), rivals, least), new


def _noisier(new: _NewRuns, unchanged: ModelError) -> tuple[str, ...]:
    """How much more noise runs have than the unchanged ones, if it is much."""
    group = next(iter(unchanged.noise))
    ratio = new.known.noise[group] / unchanged.noise[group]
    if ratio < NOISE_RATIO:
        return ()
    return (f"what no effect explains is {ratio:.2g} times that of the unchanged runs",)


def _pushes(new: _NewRuns, unchanged: ModelError, found: Sequence[Found]) -> tuple[Push, ...]:
    """Outside forces in what a change leaves of the runs, where it leaves more than noise."""
    if not _noisier(new, unchanged):
        return ()
    metric, fixed = new.metric, new.cases[0].fixed
    left = np.where(metric.root > 0.0, new.left(found), np.nan)
    return outside_forces(new.cases, left, metric.known, MEAN_WINDOW if fixed else BIN)


def _ranked(new: _NewRuns) -> list[Hypothesis]:
    """Every explanation, the one with the greatest evidence first."""
    tried = [_explained(keys, part, new) for keys, part in _explanations(new)]
    first = sorted((one for one in tried if one is not None), key=lambda one: -one.evidence)
    if first[0].evidence < NAMED:
        return first
    of_effects = [one for one in first if one.keys[-1][0] != ANGLE_ERROR]
    near = [one for one in of_effects if one.evidence > _NEAR * first[0].evidence][:CONTENDERS]
    # Far from zero, a lost zero does not look like its derivative.
    near += [one for one in of_effects if _is_lost_zero(one.keys) and one.part <= first[0].part]
    refined = {one.keys: _refined(one, new) for one in near}
    return sorted((refined.get(one.keys, one) for one in first), key=lambda one: -one.evidence)


def _explanations(new: _NewRuns) -> list[tuple[tuple[Key, ...], frozenset[str]]]:
    """Keys and part of each explanation: a link, a leg, a side, or the joint of a sensor."""
    keys, limbs, kinds = new.keys, new.limbs, known_effects()
    out = []
    for key in keys:
        name, target = key
        # Two links do not lose or gain the same mass.
        if name != ANGLE_ERROR and not (
            name in (*LOAD, ZERO) and target not in kinds[name].single_targets(limbs)
        ):
            members = kinds[name].members_of(target, limbs)
            # Without the axis, such as "_y" of "FL_calf_y".
            out.append(((key,), frozenset(re.sub("_[xyz]$", "", one) for one in members)))
    for joint in limbs.joints:
        own = {joint, *(f"{joint}_{axis}" for axis in AXES)}
        out.append((tuple(k for k in keys if k[0] in LOAD and k[1] in own), frozenset({joint})))
        if errors := [k for k in keys if k[0] == ANGLE_ERROR and k[1].split()[0] == joint]:
            out.append((((ZERO, joint), *errors), frozenset({joint})))
    return [(own, part) for own, part in out if len(own) > 0]


def _prior(key: Key, limbs: Limbs) -> float:
    """Prior standard deviation of a size."""
    name, target = key
    if name == ANGLE_ERROR:
        return ANGLE_DRIFT if target.endswith(" drift") else ANGLE_SHARE
    return ATTITUDE if name == ZERO else plausible_size(name, target, limbs) / 1.96


def _explained(keys: tuple[Key, ...], part: frozenset[str], new: _NewRuns) -> Hypothesis | None:
    """An explanation by those of its sizes that the runs show, to first order; None for none."""
    # Motion in a plane does not show where a link's centre of mass is across it.
    shown = np.diag(new.metric.S)[1:] > NOTHING
    keys = tuple(key for key in keys if shown[new.keys.index(key)])
    if not keys:
        return None
    place = [1 + new.keys.index(key) for key in keys]
    A, b = new.metric.S[np.ix_(place, place)], new.metric.S[place, 0]
    covariance = np.linalg.pinv(A, hermitian=True)
    alone = covariance @ b
    prior = np.array([_prior(key, new.limbs) for key in keys])
    if _is_lost_zero(keys):
        prior = np.maximum(prior, np.abs(alone))
    # Marginal likelihood, relative to that of no size, in units of the prior.
    inner, pull = np.eye(len(keys)) + prior[:, None] * A * prior, prior * b
    sizes = np.linalg.solve(inner, pull)
    evidence = float(pull @ sizes - np.linalg.slogdet(inner)[1])
    sizes *= prior
    deviations, excess = np.sqrt(np.diag(covariance)), float(np.sqrt(sizes @ A @ sizes))
    return Hypothesis(keys, part, sizes, deviations, excess, evidence, float(alone @ b))


def _is_sampling_lag(one: Hypothesis, machine: Machine, rate: float) -> bool:
    """Whether an explanation is a lag within a row, by which runs differ and machines do not."""
    key, *others = one.keys
    if others or key[0] not in known_effects():
        return False
    lag = with_clipped_size(effect(*key, 0.0), float(one.sizes[0]), machine)
    return is_sampling_lag(lag, rate)


def _is_lost_zero(keys: Sequence[Key]) -> bool:
    """Whether an explanation is a zero alone, which may have any size."""
    return keys[0][0] == ZERO and len(keys) == 1


def _refined(one: Hypothesis, new: _NewRuns) -> Hypothesis:
    """An explanation refined on the true residual."""
    keys, lost, best = one.keys, _is_lost_zero(one.keys), replace(one, evidence=-np.inf)
    sizes, prior = one.sizes, np.array([_prior(key, new.limbs) for key in keys])
    if lost and (abs(sizes[0]) > FAR or new.cases[0].fixed):
        # The residual is a wave over a turn, and half a turn away seems to be none; start from the
        # best of some zeros.
        starts = [np.array([start]) for start in (*FAR_STARTS, sizes[0])]
        sizes = min(starts, key=lambda start: new.at(keys, start)[0, 0])
    for _ in range(REFINEMENTS):
        if lost:
            prior = np.maximum(prior, np.abs(sizes))
        else:
            effects = [effect(*key, 0.0) for key in keys]
            pairs = zip(effects, sizes, strict=True)
            sizes = np.array([with_clipped_size(e, x, new.machine).value for e, x in pairs])
        S = new.at(keys, sizes)
        A, gain = S[1:, 1:], float(new.metric.S[0, 0] - S[0, 0])
        shrink = np.linalg.slogdet(np.eye(len(keys)) + prior[:, None] * A * prior)[1]
        evidence = float(gain - np.sum((sizes / prior) ** 2) - shrink)
        if evidence > best.evidence:
            best = replace(
                one,
                sizes=sizes,
                deviations=np.sqrt(np.diag(np.linalg.pinv(A, hermitian=True))),
                excess=float(np.sqrt(sizes @ A @ sizes)),
                evidence=evidence,
                gain=gain,
            )
        known = np.diag(prior**-2.0)
        sizes = sizes + np.linalg.solve(A + known, S[1:, 0] - known @ sizes)
    return best


def _least(one: Hypothesis, sensors: Sequence[tuple[Key, ...]], new: _NewRuns) -> float:
    """The least size that is named in 95 of 100 runs like these; of a change of the machine, also
    told from errors of sensors.
    """
    deviation, prior = float(one.deviations[0]), _prior(one.keys[0], new.limbs)
    named = float(least_named(deviation, prior, NAMED, least_excess(new.known)))
    if not one.of_sensor:
        apart = min((_apart(one.keys[0], keys, new) for keys in sensors), default=1.0)
        named = max(named, np.sqrt(AS_LIKELY / apart) * deviation)
    return named + SURE * deviation


def _apart(key: Key, keys: tuple[Key, ...], new: _NewRuns) -> float:
    """Share of what a candidate explains that other candidates do not (above 0, to 1)."""
    own, place = 1 + new.keys.index(key), [1 + new.keys.index(other) for other in keys]
    known = [0.0 if _is_lost_zero(keys) else _prior(other, new.limbs) ** -2.0 for other in keys]
    A, b = new.metric.S[np.ix_(place, place)] + np.diag(known), new.metric.S[place, own]
    return max(1.0 - float(b @ np.linalg.solve(A, b)) / float(new.metric.S[own, own]), NOTHING)


def _contradicted(rates: Sequence[Mapping[str, float]], known: ModelError) -> tuple[str, ...]:
    """A sentence for each joint whose angle and rate contradict each other."""
    most = {joint: max(run[joint] for run in rates) for joint in rates[0]}
    return tuple(
        f"q_{joint} and dq_{joint} contradict each other: by up to {apart:.2g} rad/s, "
        f"{known.rates[joint]:.2g} in the unchanged runs"
        for joint, apart in most.items()
        if apart > CONTRADICTION * known.rates[joint]
    )


def _distinct(others: Sequence[Hypothesis], best: Hypothesis) -> tuple[Hypothesis, ...]:
    """The best of each other part, and of each sensor."""
    kept: list[Hypothesis] = []
    for one in others:
        same = [k for k in (best, *kept) if k.of_sensor == one.of_sensor and k.part & one.part]
        if not same:
            kept.append(one)
    return tuple(kept)


def _found(one: Hypothesis, machine: Machine) -> tuple[Found, ...]:
    """The effects of an explanation; of several sizes, those that differ from zero."""
    pairs = zip(one.keys, one.sizes, one.deviations, strict=True)
    every = [(key, float(size), float(error)) for key, size, error in pairs]
    shown = [x for x in every if abs(x[1]) > 1.96 * x[2]] or [
        max(every, key=lambda x: abs(x[1]) / x[2])
    ]
    strongest = sorted(shown, key=lambda x: -abs(x[1]) / x[2])
    return tuple(with_deviation(key, size, error, machine) for key, size, error in strongest)


def _words(one: Hypothesis) -> str:
    """Such as 'an error of the angle of hook' or 'link_mass tail'."""
    if _is_lost_zero(one.keys):
        return f"q_{one.keys[0][1]} is off by {one.sizes[0]:+.2g}"
    if one.keys[-1][0] == ANGLE_ERROR:
        return f"an error of q_{one.keys[0][1]}"
    return " with ".join(f"{name} {target}" for name, target in one.keys)
