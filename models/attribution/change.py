"""What changed of a machine on a fixed base since runs that its model was calibrated on.

Explanations are compared by the evidence of the new runs for each: the marginal likelihood of their
torque balance, relative to that of the unchanged machine, whose covariance is that of the model's
error, of zeros and of noise (`model_error`). An explanation is an effect alone, all that a load
changes of a link, or an error of the sensor of a joint's angle. No change of the machine is named
where an error of a sensor explains the runs about as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import stdtrit

from surefoot.models.attribution.evidence import Evidence, Key, LogUnderModel, linearise
from surefoot.models.attribution.found import Found, with_clipped_size
from surefoot.models.attribution.levels import ChannelLevel
from surefoot.models.attribution.model_error import (
    ANGLE_ERROR,
    NOTHING,
    ZERO,
    ModelError,
    RunEvidence,
    RunResidual,
    RunSums,
    against_unchanged,
    averaged,
    run_evidence,
    run_residual,
    run_sums,
    windows,
)
from surefoot.models.attribution.priors import plausible_size
from surefoot.models.attribution.run_offsets import PER_RUN_EFFECTS
from surefoot.sim.effects import AXES, effect, known_effects
from surefoot.sim.log import LogError, MemoisedLog
from surefoot.sim.robot.limbs import Limbs

NAMED = 2.0 * np.log(1e3)
"""Twice the logarithm of the odds from which a change is named: a thousand to one."""
CHANCE = 0.005
"""Probability by which Student's t of as many runs, less one, exceeds the least excess on one side:
how runs differ is known no better than that.
"""
AS_LIKELY = 2.0 * np.log(20.0)
"""The same up to which another explanation is as good: twenty to one."""
SURE = 1.645
"""Standard deviations above the limit at which a change is named in 95 of 100 runs."""
SENSOR_EFFECTS = PER_RUN_EFFECTS | {
    *("encoder_scale", "joint_delay", "rate_delay", "torque_delay", "contact_delay"),
    *("gyro_scale", "accel_scale", "gyro_g_sensitivity", "imu_rotation", "imu_position"),
    *("imu_lowpass", "imu_delay"),
}
"""Effects of sensors, which are no changes of a machine's body."""
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
_ROUNDS = 4
"""Most rounds in which the noise is adapted to what the best explanation leaves."""
_AS_UNCHANGED = 1.05
"""Ratio of what it leaves to the noise at which it is as in the unchanged runs."""
NEAR = 0.3
"""Share of the best evidence from which an explanation may turn out better in the refinement."""


@dataclass(frozen=True)
class Explanation:
    """One explanation of the runs.

    Attributes:
        keys: of its k sizes.
        part: what it is of: the targets of an effect, or the joint whose sensor is in error.
        sizes: (k,).
        deviations: standard deviations of the sizes (k,), as the runs tell them.
        evidence: twice the logarithm of its odds against the unchanged machine.
        gain: reduction of the runs' squared error by it.
        overlap: cosine between its first regressor and that of the explanation it is a rival of.
    """

    keys: tuple[Key, ...]
    part: frozenset[str]
    sizes: np.ndarray
    deviations: np.ndarray
    evidence: float
    gain: float
    overlap: float = 1.0

    @property
    def excess(self) -> float:
        """The largest of its sizes in standard deviations."""
        return float(np.max(np.abs(self.sizes) / self.deviations))

    @property
    def of_sensor(self) -> bool:
        """Whether it is an error of a sensor."""
        return self.keys[-1][0] == ANGLE_ERROR or self.keys[0][0] in SENSOR_EFFECTS


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
    """

    verdict: str
    reasons: tuple[str, ...]
    found: tuple[Found, ...]
    rivals: tuple[Explanation, ...]
    least: dict[Key, float]
    channels: dict[str, ChannelLevel] = field(default_factory=dict)
    zeros: tuple[tuple[Found, ...], ...] = ()


def find_change(cases: Sequence[LogUnderModel], known: ModelError) -> Change:
    """Compare the explanations of new runs, with the declared effects compensated in `cases`.

    Raises LogError where the runs have other readings than those that the model's error is of.
    """
    limbs = cases[0].robot.limbs
    runs = [run_evidence(case) for case in cases]
    sums = [run_sums(run) for run in runs]
    for case, run in zip(cases, sums, strict=True):
        lacking = {*known.noise} - {*run.groups}
        if lacking or {*known.keys} - {*run.keys}:
            names = ", ".join(dict.fromkeys(channel for channel, _ in lacking)) or "other effects"
            raise LogError(
                f"{case.log.name}: its readings differ from those of the runs that the declared "
                f"effects were found in ({names})"
            )
    found = _best(runs, sums, known, limbs)
    sizes = {(one.effect.name, one.effect.target): one.effect.value for one in found.found}
    residuals = [run_residual(run, known, limbs, sizes) for run in sums]
    return replace(
        found,
        channels=_levels(runs[0], sums, residuals, known),
        zeros=tuple(
            tuple(
                Found(with_clipped_size(effect(*key, 0.0), x, limbs), (x - 1.96 * e, x + 1.96 * e))
                for key, (x, e) in one.zeros.items()
            )
            for one in residuals
        ),
    )


def _levels(
    first: RunEvidence,
    runs: Sequence[RunSums],
    residuals: Sequence[RunResidual],
    known: ModelError,
) -> dict[str, ChannelLevel]:
    """Residual of each channel over all runs."""
    layout, out = first.known.layout, {}
    for channel in dict.fromkeys(channel for channel, _ in known.noise):
        sides = []
        for of_run in (
            lambda one: one.before,
            lambda one: one.after,
            lambda one: known.noise,
        ):
            square = [
                (number, of_run(one)[group])
                for run, one in zip(runs, residuals, strict=True)
                for group, number in zip(run.groups, run.count, strict=True)
                if group[0] == channel
            ]
            weights, levels = np.array(square).T
            sides.append(float(np.sqrt(np.average(levels**2, weights=weights))))
        units = dict.fromkeys(c.unit for c in layout.columns[layout.channels[channel]])
        out[channel] = ChannelLevel(*sides, unit=" and ".join(units))
    return out


def _best(
    runs: Sequence[RunEvidence], sums: Sequence[RunSums], known: ModelError, limbs: Limbs
) -> Change:
    """The change that the runs tell, without residuals."""
    entries = float(sum(run.count.sum() for run in sums))
    for _ in range(_ROUNDS):
        S = sum(against_unchanged(run, known, limbs) for run in sums)
        new = _NewRuns(runs, known, sums[0].keys, S, limbs)
        first = _ranked(new)
        # What the best explanation leaves is noise that the unchanged runs did not have.
        left = np.sqrt((S[0, 0] - first[0].gain) / entries)
        if left < _AS_UNCHANGED:
            break
        known = replace(known, noise={group: left * x for group, x in known.noise.items()})
    least = {one.keys[0]: _least(one, new) for one in first if len(one.keys) == 1}
    if contradicted := _contradicted(sums, known):
        return Change("not_identifiable", contradicted, (), (), least)
    # Of explanations that are about as good, the one of the fewest parts and sizes.
    as_good = [one for one in first if one.evidence > first[0].evidence - AS_LIKELY]
    alike = [one for one in as_good if one.of_sensor == first[0].of_sensor]
    inside = [one for one in alike if one.part <= first[0].part]
    best = min(inside, key=lambda one: (len(one.part), len(one.keys)))
    if best.evidence < NAMED or best.excess < _least_excess(known):
        return Change("unchanged", (), (), (), least)
    rivals = tuple(
        replace(one, overlap=new.overlap(one.keys[0], best.keys[0]))
        for one in _distinct([one for one in as_good if one is not best], best)
    )
    if _is_lost_zero(best.keys) and not _within_bounds(best, limbs):
        return Change("not_identifiable", (_words(best),), (), rivals, least)
    sensors = [one for one in (best, *rivals) if one.of_sensor]
    if sensors and not (best.of_sensor and len(best.keys) == 1):
        reasons = tuple(f"{_words(one)} explains these runs as well" for one in (*sensors, *rivals))
        return Change("not_identifiable", tuple(dict.fromkeys(reasons)), (), rivals, least)
    verdict = "confounded" if rivals else "attributed"
    return Change(verdict, (), _found(best, limbs), rivals, least)


def _ranked(new: "_NewRuns") -> list[Explanation]:
    """Every explanation, the one with the greatest evidence first."""
    tried = [_explained(keys, part, new) for keys, part in _explanations(new)]
    first = sorted((one for one in tried if one is not None), key=lambda one: -one.evidence)
    if first[0].evidence < NAMED:
        return first
    single = [one for one in first if len(one.keys) == 1]
    near = [one for one in single if one.evidence > NEAR * first[0].evidence][:CONTENDERS]
    # Far from zero, a lost zero does not look like its derivative.
    near += [one for one in single if _is_lost_zero(one.keys) and one.part <= first[0].part]
    refined = {one.keys: _refined(one, new) for one in near}
    return sorted((refined.get(one.keys, one) for one in first), key=lambda one: -one.evidence)


@dataclass(frozen=True)
class _NewRuns:
    """New runs, and a' V^-1 b (1 + P, 1 + P) of their residual and of the P candidates `keys`, V
    the covariance that they have if nothing changed.
    """

    runs: Sequence[RunEvidence]
    known: ModelError
    keys: tuple[Key, ...]
    S: np.ndarray
    limbs: Limbs

    def clipped(self, key: Key, size: float) -> float:
        """A size that the effect may have: nothing loses more mass than it has."""
        name, target = key
        low, high = known_effects()[name].interior_bounds(target, self.limbs)
        machine = self.runs[0].case.robot
        if name == "link_mass" and target in self.limbs.joints and machine.dynamics is not None:
            model = machine.dynamics.model
            joint = machine.joint_names[self.limbs.joints.index(target)]
            low = max(low, -float(model.body_mass[model.joint(joint).bodyid[0]]))
        return float(np.clip(size, low, high))

    def overlap(self, one: Key, other: Key) -> float:
        """Cosine (0 to 1) between the regressors of two candidates."""
        i, j = (1 + self.keys.index(key) for key in (one, other))
        return float(abs(self.S[i, j]) / np.sqrt(self.S[i, i] * self.S[j, j]))

    def at(self, key: Key, size: float) -> np.ndarray:
        """The same (2, 2) for one candidate, of the true residual with this size compensated."""
        total = np.zeros((2, 2))
        needed = dict.fromkeys([*self.known.keys, *(k for k in self.keys if k[0] == ZERO), key])
        for run in self.runs:
            known = run.only([one for one in needed if one in run.known.keys])
            other = _compensated(run.case, key, size)
            X = dict(zip(known.known.keys, known.known.X, strict=True)) | {key: other.X[0]}
            evidence = replace(known.known, table=other.table, X=tuple(X.values()))
            sums = run_sums(replace(known, known=evidence))
            place = [0, *sums.places([key])]
            total += against_unchanged(sums, self.known, self.limbs)[np.ix_(place, place)]
        return total


def _compensated(case: LogUnderModel, key: Key, size: float) -> Evidence:
    """Evidence of a run with one effect compensated; a zero may be beyond its bounds."""
    if key[0] == ZERO:
        column = f"q_{key[1]}"
        log = case.log.with_columns({column: case.log.columns[column] - size})
        case = replace(case, log=MemoisedLog.of(log))
        known = linearise([case], (), [key], evaluation_channels=False)
    else:
        known = linearise([case], [effect(*key, size)], [key], evaluation_channels=False)
    return averaged(known, windows(known)) if case.fixed else known


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
            out.append(((key,), frozenset(one.removesuffix(_axis(one)) for one in members)))
    for joint in limbs.joints:
        own = {joint, *(f"{joint}_{axis}" for axis in AXES)}
        out.append((tuple(k for k in keys if k[0] in LOAD and k[1] in own), frozenset({joint})))
        if errors := [k for k in keys if k[0] == ANGLE_ERROR and k[1].split()[0] == joint]:
            out.append((((ZERO, joint), *errors), frozenset({joint})))
    return [(own, part) for own, part in out if len(own) > 0]


def _axis(target: str) -> str:
    """The axis that a target names after a part, such as "_y" of "FL_calf_y"."""
    return target[-2:] if target[-2:] in {f"_{axis}" for axis in AXES} else ""


def _prior(key: Key, limbs: Limbs) -> float:
    """Prior standard deviation of a size."""
    name, target = key
    if name == ANGLE_ERROR:
        return ANGLE_DRIFT if target.endswith(" drift") else ANGLE_SHARE
    return ATTITUDE if name == ZERO else plausible_size(name, target, limbs) / 1.96


def _explained(keys: tuple[Key, ...], part: frozenset[str], new: _NewRuns) -> Explanation | None:
    """An explanation with its sizes, to first order; None where the runs do not show it."""
    place = [1 + new.keys.index(key) for key in keys]
    A = new.S[np.ix_(place, place)]
    if np.diag(A).min() < NOTHING:
        return None
    covariance = np.linalg.pinv(A, hermitian=True)
    alone = covariance @ new.S[place, 0]
    prior = np.array([_prior(key, new.limbs) for key in keys])
    if _is_lost_zero(keys):
        prior = np.maximum(prior, np.abs(alone))
    both = covariance + np.diag(prior**2)
    # Evidence of the sizes alone: N(0, covariance + prior) against N(0, covariance).
    evidence = (
        alone @ np.linalg.solve(covariance, alone)
        - alone @ np.linalg.solve(both, alone)
        - np.linalg.slogdet(both)[1]
        + np.linalg.slogdet(covariance)[1]
    )
    sizes = prior**2 * np.linalg.solve(both, alone)
    gain = float(alone @ new.S[place, 0])
    return Explanation(keys, part, sizes, np.sqrt(np.diag(covariance)), float(evidence), gain)


def _is_lost_zero(keys: tuple[Key, ...]) -> bool:
    """Whether an explanation is a zero alone, which may have any size."""
    return keys[0][0] == ZERO and len(keys) == 1


def _refined(one: Explanation, new: _NewRuns) -> Explanation:
    """An explanation by a single size, refined on the true residual."""
    (key,), prior = one.keys, _prior(one.keys[0], new.limbs)
    size, best = float(one.sizes[0]), replace(one, evidence=-np.inf)
    if _is_lost_zero(one.keys) and abs(size) > FAR:
        # The residual is a wave over a turn; start from the best of some zeros.
        size = min((*FAR_STARTS, size), key=lambda start: new.at(key, start)[0, 0])
    for _ in range(REFINEMENTS):
        if _is_lost_zero(one.keys):
            prior = max(prior, abs(size))
        else:
            size = new.clipped(key, size)
        S = new.at(key, size)
        variance = 1.0 / S[1, 1]
        gain = float(new.S[0, 0] - S[0, 0])
        evidence = gain - (size / prior) ** 2 - np.log1p(prior**2 / variance)
        if evidence > best.evidence:
            known = np.array([size]), np.sqrt([variance])
            best = replace(
                one, sizes=known[0], deviations=known[1], evidence=float(evidence), gain=gain
            )
        size += (S[1, 0] / S[1, 1] - size * variance / prior**2) / (1.0 + variance / prior**2)
    return best


def _least(one: Explanation, new: _NewRuns) -> float:
    """The least size that is named in 95 of 100 runs like these."""
    deviation, prior = float(one.deviations[0]), _prior(one.keys[0], new.limbs)
    ratio = (prior / deviation) ** 2
    z = np.sqrt((NAMED + np.log1p(ratio)) * (1.0 + ratio) / ratio)
    return float((max(z, _least_excess(new.known)) + SURE) * deviation)


def _least_excess(known: ModelError) -> float:
    """Standard deviations that unchanged runs hardly exceed, as few as they are."""
    return float(stdtrit(known.runs - 1, 1.0 - CHANCE))


def _contradicted(runs: Sequence[RunSums], known: ModelError) -> tuple[str, ...]:
    """A sentence for each joint whose angle and rate contradict each other."""
    most = {joint: max(run.rates[joint] for run in runs) for joint in runs[0].rates}
    return tuple(
        f"q_{joint} and dq_{joint} contradict each other: by up to {apart:.2g} rad/s, "
        f"{known.rates[joint]:.2g} in the unchanged runs"
        for joint, apart in most.items()
        if apart > CONTRADICTION * known.rates[joint]
    )


def _distinct(others: Sequence[Explanation], best: Explanation) -> tuple[Explanation, ...]:
    """The best of each other part, and of each sensor."""
    kept: list[Explanation] = []
    for one in others:
        same = [k for k in (best, *kept) if k.of_sensor == one.of_sensor and k.part & one.part]
        if not same:
            kept.append(one)
    return tuple(kept)


def _found(one: Explanation, limbs: Limbs) -> tuple[Found, ...]:
    """The effects of an explanation; of several sizes, those that differ from zero."""
    pairs = zip(one.keys, one.sizes, one.deviations, strict=True)
    sized = [(key, float(size), float(error)) for key, size, error in pairs]
    shown = [x for x in sized if abs(x[1]) > 1.96 * x[2]] or [
        max(sized, key=lambda x: abs(x[1]) / x[2])
    ]
    return tuple(
        Found(with_clipped_size(effect(*key, 0.0), size, limbs), (size - 1.96 * e, size + 1.96 * e))
        for key, size, e in sorted(shown, key=lambda x: -abs(x[1]) / x[2])
    )


def _within_bounds(one: Explanation, limbs: Limbs) -> bool:
    """Whether a single size is one that its effect may have."""
    name, target = one.keys[0]
    low, high = known_effects()[name].interior_bounds(target, limbs)
    return low < one.sizes[0] < high


def _words(one: Explanation) -> str:
    """Such as 'an error of the angle of hook' or 'link_mass tail'."""
    if _is_lost_zero(one.keys):
        return f"q_{one.keys[0][1]} is off by {one.sizes[0]:+.2g}"
    if one.keys[-1][0] == ANGLE_ERROR:
        return f"an error of q_{one.keys[0][1]}"
    return " with ".join(f"{name} {target}" for name, target in one.keys)
