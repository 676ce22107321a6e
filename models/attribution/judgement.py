"""Judgement of a trace: residuals on data that no fit has seen, and the verdict on effects.

An effect stays only if it makes no channel worse, on bins that no fit has seen and on held-out
logs. A channel is at its floor where the lower end of the interval of what is left does not exceed
what noise and the model's own error explain.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from surefoot.models.attribution.design import without_nuisance
from surefoot.models.attribution.effect_sizes import Found
from surefoot.models.attribution.evidence import Evidence, Key, linearise
from surefoot.models.attribution.explain import FittedRun, Problem, without_sticking
from surefoot.models.attribution.forces import Push
from surefoot.models.attribution.metric import Metric
from surefoot.models.attribution.model_error import OF_MEAN
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.attribution.weights import RobustWeights
from surefoot.models.bootstrap import BLOCK_SECONDS, block_bootstrap_counts
from surefoot.models.residuals.channel import Channel
from surefoot.models.residuals.channels import channels
from surefoot.sim.effects import Effect
from surefoot.sim.robot.limbs import Limbs

NOISE_RATIO = 1.5
"""Ratio to the floor from which a channel is above it, at the lower end of its interval."""
WORSE_RATIO = 1.02
"""Ratio of after to before from which a channel is worse."""
REFUTED_RATIO = 1.1
"""Ratio of after to before from which a channel above all walks of its floor is worse, however much
these scatter.
"""


@dataclass(frozen=True)
class ChannelLevel:
    """Root mean square residual of a channel on bins that no fit has seen, in `unit`.

    Turn-on biases are subtracted. The floor is None where no simulated walk has the channel.
    """

    before: float
    after: float
    noise_floor: float | None
    unit: str
    highest: float = np.inf
    """Upper limit of the noise floor: the highest of the simulated walks plus their range and a
    standard error (two of events) or, where noise alone is the floor, two standard errors above it.
    """
    evaluation_only: bool = False
    """Whether no fit uses the channel: it need not reach its floor, but must not get worse."""
    same_bins: tuple[float, float] | None = None
    """Before and after on the bins that both have: compensating contacts changes the stances. Zeros
    where there are none.
    """
    by_chance: bool = False
    """Whether the increase, over a channel's few events, is within chance."""
    low_share: float = 1.0
    """Lower end of the 95 % interval of `after`, by a bootstrap over blocks, as a share of it."""
    of_noise: float = np.inf
    """Largest level that noise and the model's own error explain."""
    on_like_ground: bool = True
    """Whether the ground of the log is level, as that of the floor's walks is."""

    @property
    def at_floor(self) -> bool:
        """Whether the remaining residual is at the noise floor."""
        return self.evaluation_only or self.within_floor

    @property
    def within_floor(self) -> bool:
        """Whether the remaining residual is at the noise floor, even of a channel that no fit
        uses.
        """
        limit = min(self.of_noise, self.highest) if self.on_like_ground else self.of_noise
        return self.low_share * self.after <= limit

    @property
    def worse(self) -> bool:
        """Whether compensation increases the residual on unseen data.

        Judged on the bins that both have. Either the residual reaches REFUTED_RATIO of its value
        before and lies above all walks of the noise floor; or the increase is not by chance,
        exceeds the scatter of walks simulated with these effects, and the residual is above their
        floor.
        """
        before, after = self.same_bins or (self.before, self.after)
        if after > max(REFUTED_RATIO * before, self.highest):
            return True
        if self.by_chance or after <= WORSE_RATIO * before:
            return False
        if self.noise_floor is None:
            return True
        differ = after - before > self.highest - self.noise_floor
        return differ and not self.within_floor


def channel_levels(
    before: np.ndarray,
    after: np.ndarray,
    known: Evidence,
    floor: NoiseFloor,
    on_like_ground: bool = True,
) -> dict[str, ChannelLevel]:
    """Residual of each channel of a table.

    Args:
        before: residual (M, W) of the declared model on unseen bins.
        after: the same with the effects found compensated.
        known: evidence whose columns these are.
        floor: noise floor of the model with the effects.
        on_like_ground: as of `ChannelLevel`.
    """
    floors = [one.left for one in floor.walks]
    levels = {}
    for name, columns in known.layout.channels.items():
        if not np.isfinite(before[:, columns]).any():
            continue
        channel, kinds = channels()[name], [one.kind for one in known.layout.columns[columns]]

        def rms(values: np.ndarray, channel: Channel = channel, kinds: list[str] = kinds) -> float:
            return trimmed_rms(values, channel, kinds)

        least = channel.least_noise if channel.on_level_ground else 0.0
        shown = [part[:, columns] for part in floors if np.isfinite(part[:, columns]).any()]
        level = [max(rms(part), least) for part in shown]
        own = float(np.sqrt(np.mean(np.square(level)))) if level else None
        most = 2.0 * max(level) - min(level) if level else np.inf
        if level:
            square = _bulk(np.concatenate(shown) ** 2, channel, kinds)
            count = np.isfinite(after[:, columns]).sum()
            # A log has few changes of contact, and some are far outliers.
            deviations = 2.0 if channel.of_events else 1.0
            most *= 1.0 + deviations * scatter_of_rms(square[np.isfinite(square)], count)
        if own is None and not floor.walks:
            own = float(np.sqrt(np.mean(floor.sigma[columns] ** 2)))
            # Noise of neighbouring bins is correlated, so n bins determine the RMS to about
            # 1/sqrt(n).
            count = np.isfinite(after[:, columns]).sum()
            most = own * (1.0 + 2.0 / float(np.sqrt(max(count, 1))))
        most = max(most, floor.levels.get(name, 0.0))
        both = np.isfinite(before[:, columns]) & np.isfinite(after[:, columns])
        on_both = [np.where(both, part[:, columns], np.nan) for part in (before, after)]
        same = [rms(part) for part in on_both] if both.any() else [0.0, 0.0]
        levels[name] = ChannelLevel(
            before=rms(before[:, columns]),
            after=rms(after[:, columns]),
            noise_floor=own,
            unit=" and ".join(dict.fromkeys(c.unit for c in known.layout.columns[columns])),
            highest=most,
            evaluation_only=channel.evaluation_only,
            same_bins=(same[0], same[1]),
            by_chance=channel.of_events and _by_chance(before[:, columns], after[:, columns]),
            low_share=_low_share(_bulk(after[:, columns] ** 2, channel, kinds), known),
            of_noise=max(np.inf if own is None else NOISE_RATIO * own, floor.levels.get(name, 0.0)),
            on_like_ground=on_like_ground,
        )
    return levels


def _by_chance(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether the mean paired increase over events is less than two standard errors.

    A few bad touchdowns dominate the RMS.
    """
    more = after**2 - before**2
    more = more[np.isfinite(more)]
    return bool(np.mean(more) <= 2.0 * np.std(more) / np.sqrt(len(more))) if len(more) else True


def block_gains(
    before: np.ndarray, after: np.ndarray, known: Evidence, sigma: np.ndarray, weight: np.ndarray
) -> dict[str, np.ndarray]:
    """Reduction of each block's weighted squared residual (K,) by channel, in units of the noise.

    Args:
        before: residual (M, W) without nuisance parameters; NaN where there is none.
        after: the same with more effects compensated.
        known: evidence whose columns and bins these are.
        sigma: noise of the columns (W,).
        weight: of the entries (M, W).
    """
    stretch = np.floor((known.t - known.t.min()) / BLOCK_SECONDS).astype(int)
    number = known.log * (stretch.max() + 1) + stretch
    gain = np.nan_to_num(weight * (before**2 - after**2)) / sigma**2
    both = np.isfinite(before) & np.isfinite(after) & (weight > 0.0)
    gains = {}
    for name, columns in known.layout.channels.items():
        blocks = np.unique(number[both[:, columns].any(axis=1)])
        if len(blocks):
            each = np.bincount(number, gain[:, columns].sum(axis=1), minlength=number.max() + 1)
            gains[name] = each[blocks]
    return gains


def scatter_of_rms(square: np.ndarray, count: int) -> float:
    """Relative standard deviation of the RMS of `count` independent draws from a distribution.

    sqrt((kurtosis - 1) / (4 count)), the kurtosis by samples (K,) of the distribution's square.
    """
    kurtosis = np.mean(square**2) / max(np.mean(square) ** 2, 1e-300)
    return float(np.sqrt(max(kurtosis - 1.0, 0.0) / (4.0 * max(count, 1))))


def trimmed_rms(values: np.ndarray, channel: Channel, kinds: Sequence[str]) -> float:
    """Root mean square of the finite values (M, n) of columns of these kinds (n,), without the
    largest (`_bulk`); NaN without any.

    Kinds of events count alike, though one may have fewer: feet that slide show no touchdown.
    """
    square = _bulk(values**2, channel, kinds)
    parts = [square[:, part] for part in _alike(channel, kinds)]
    means = [np.nanmean(part) for part in parts if np.isfinite(part).any()]
    return float(np.sqrt(np.mean(means))) if means else np.nan


def _bulk(square: np.ndarray, channel: Channel, kinds: Sequence[str]) -> np.ndarray:
    """The squares (M, n), and NaN in place of the largest 1 %, of each kind of event 10 %.

    A few bins with an impact between two samples would otherwise dominate a torque's RMS, and feet
    that hit an edge or bounce that of contacts.
    """
    share, bulk = 0.9 if channel.of_events else 0.99, square.copy()
    for part in _alike(channel, kinds):
        values = np.sort(square[:, part], axis=None)
        if count := np.count_nonzero(np.isfinite(values)):
            most = values[max(1, round(share * count)) - 1]
            bulk[:, part] = np.where(square[:, part] <= most, square[:, part], np.nan)
    return bulk


def _alike(channel: Channel, kinds: Sequence[str]) -> list[np.ndarray]:
    """Masks (n,) of the columns of a channel that are judged together: each kind of event, and all
    of any other channel.
    """
    if not channel.of_events:
        return [np.ones(len(kinds), dtype=bool)]
    return [np.array(kinds) == kind for kind in dict.fromkeys(kinds)]


def _low_share(bulk: np.ndarray, known: Evidence) -> float:
    """Lower end of the 95 % interval of the root mean square of a channel, as a share of it, by
    blocks of its squares (M, n) without the largest.
    """
    there = np.isfinite(bulk)
    if not there.any():
        return 1.0
    block = known.log * 1_000_000 + np.floor(known.t / BLOCK_SECONDS).astype(int)
    rows, block = there.any(axis=1), np.unique(block, return_inverse=True)[1]
    total, count = (
        np.bincount(block[rows], np.where(there, one, 0.0).sum(axis=1)[rows])
        for one in (bulk, np.ones_like(bulk))
    )
    drawn = block_bootstrap_counts(int(np.count_nonzero(count)), np.random.default_rng(0))
    mean = (drawn @ total[count > 0]) / np.maximum(drawn @ count[count > 0], 1.0)
    level = np.sum(total) / np.sum(count)
    return float(np.sqrt(np.percentile(mean, 2.5) / level)) if level > 0.0 else 1.0


@dataclass(frozen=True)
class Residuals:
    """Residuals of logs before and after effects are compensated.

    Attributes:
        problem: the logs, with their own zeros and clocks compensated.
        effects: that are compensated.
        use: mask (M,) of the bins that nuisance parameters are fitted on.
        weights: of the entries.
        floor: noise floor of the model with the effects.
        evidence: with the effects compensated.
        before: residual (M, W) without them and without nuisance parameters; NaN where masked.
        after: the same with them.
    """

    problem: Problem
    effects: tuple[Effect, ...]
    use: np.ndarray
    weights: RobustWeights
    floor: NoiseFloor
    evidence: Evidence
    before: np.ndarray
    after: np.ndarray

    def left_by(self, effects: Sequence[Effect]) -> np.ndarray:
        """Residual (M, W) with these effects instead, in the same entries."""
        known = linearise(self.problem.cases, effects, ())
        known = without_sticking(self.problem, self.effects, known)
        return without_nuisance(known, self.weights.sigma, self.weights.weight, self.use)

    def left_without(self, one: Effect) -> np.ndarray:
        """Residual (M, W) with the effects but for one."""
        return self.left_by([e for e in self.effects if e != one])

    def gained(self, without: np.ndarray, used: np.ndarray) -> tuple[str, np.ndarray]:
        """The fitted channel that one of the effects changes most, and the 95 % interval (2,) of
        what it explains there, over the bins of a mask `used` (M,); "" where it changes nothing.

        without (M, W): `left_without` it.
        """
        weight = np.where(used[:, None], self.weights.weight, 0.0)
        gains = block_gains(without, self.after, self.evidence, self.weights.sigma, weight)
        fitted = [name for name in gains if not channels()[name].evaluation_only]
        most = max(fitted, key=lambda name: abs(gains[name].sum()), default="")
        return most, _interval(gains[most]) if most else np.zeros(2)

    def levels(self, judge: np.ndarray) -> dict[str, ChannelLevel]:
        """Level of each channel over the bins of a mask (M,)."""
        known, cases = self.evidence, self.problem.cases
        judged = replace(known, t=known.t[judge], log=known.log[judge])
        level = all(c.fixed or c.motion.level or not c.motion.by_reference for c in cases)
        return channel_levels(
            self.before[judge], self.after[judge], judged, self.floor, on_like_ground=level
        )

    def worse(self, judge: np.ndarray) -> list[str]:
        """Channels that the effects make worse over the bins of a mask (M,)."""
        return [name for name, level in self.levels(judge).items() if level.worse]


def residuals_with(
    problem: Problem,
    effects: Sequence[Effect],
    metric: Metric,
    floor: NoiseFloor,
    use: np.ndarray,
) -> Residuals:
    """Residuals before and after these effects, as the search sees them (`without_sticking`).

    Args:
        problem: the logs.
        effects: to compensate.
        metric: with its weights.
        floor: noise floor of the model with the effects.
        use: mask (M,) of the bins that nuisance parameters are fitted on.
    """
    known = without_sticking(problem, effects, linearise(problem.cases, effects, ()))
    weights, layout, there = metric.robust, known.layout, np.isfinite(known.table)
    # No fit uses the channels that are only evaluated.
    weight, masked = weights.weight.copy(), weights.masked
    for c in np.setdiff1d(np.arange(layout.width), layout.fitted):
        leg = layout.columns[c].leg
        off = masked.any(axis=1) if leg is None else masked[:, leg]
        weight[:, c] = there[:, c] & ~(off & bool(layout.masked_by[c]))
    weights = replace(weights, weight=weight)
    if problem.by_windows:
        floor = replace(floor, sigma=OF_MEAN * floor.sigma)
    after = without_nuisance(known, weights.sigma, weights.weight, use)
    sides = Residuals(problem, tuple(effects), use, weights, floor, known, after, after)
    return replace(sides, before=sides.left_by(()))


@dataclass(frozen=True)
class Unseen:
    """Data that no fit has seen.

    Attributes:
        sides: residuals before and after effects.
        used: mask (M,) of the bins.
        parts: masks (M,) of the parts on each of which an effect must not harm, by their names.
    """

    sides: Residuals
    used: np.ndarray
    parts: Mapping[str, np.ndarray]


def find_harmful_effect(unseen: Sequence[Unseen]) -> tuple[Effect, str] | None:
    """An effect that harms on data that no fit has seen, and why; None where none does.

    Either it makes the channel that it changes most worse: surely on a part (95 % of a block
    bootstrap), or more likely than not on the whole (the middle of that interval). Or a channel is
    worse with all of the effects (`ChannelLevel.worse`), and best without this one.
    """
    sure: list[tuple[float, Effect, str]] = []
    likely: list[tuple[float, Effect, str]] = []
    for data in unseen:
        for one in (e for e in data.sides.effects if type(e).is_compensated()):
            without = data.sides.left_without(one)
            for name, part in data.parts.items():
                channel, (_, highest) = data.sides.gained(without, part)
                if highest < 0.0:
                    sure.append((highest, one, f"it makes {channel} worse on {name}"))
            channel, ends = data.sides.gained(without, data.used)
            if (middle := float(np.mean(ends))) < 0.0:
                why = f"it rather makes {channel} worse on data that no fit has seen"
                likely.append((middle, one, why))
    if sure or likely:
        return min(sure or likely, key=lambda x: x[0])[1:]
    worse = ((data, name) for data in unseen for name in data.sides.worse(data.used))
    if (first := next(worse, None)) is None:
        return None
    data, name = first
    columns = data.sides.evidence.layout.of(name)

    def square(one: Effect) -> float:
        return float(np.nanmean(data.sides.left_without(one)[data.used][:, columns] ** 2))

    return min(data.sides.effects, key=square), f"it makes {name} worse"


def _interval(blocks: np.ndarray) -> np.ndarray:
    """95 % interval (2,) of the sum over blocks, by a bootstrap."""
    drawn = block_bootstrap_counts(len(blocks), np.random.default_rng(0)) @ blocks
    return np.percentile(drawn, [2.5, 97.5])


@dataclass(frozen=True)
class HeldOutRuns:
    """Result on held-out logs.

    Attributes:
        channels: residual of each channel over all logs.
        runs: effects of each log's own.
    """

    channels: dict[str, ChannelLevel]
    runs: tuple[FittedRun, ...]


@dataclass(frozen=True)
class Findings:
    """What a verdict rests on.

    Attributes:
        found: effects, strongest first.
        channels: residuals on data that no fit has seen.
        imitated: keys of the effects that what the others leave may imitate.
        curves: whether a joint's encoder error is a curve of its angle.
        rivals: other explanations of an effect.
        pushes: sections with an outside force; channels are judged without them.
        pushed_away: effects that explain nothing but outside forces.
        limbs: of the machine, on which bounds depend.
    """

    found: Sequence[Found]
    channels: dict[str, ChannelLevel]
    imitated: frozenset[Key] = frozenset()
    curves: bool = False
    rivals: Sequence[object] = ()
    pushes: Sequence[Push] = ()
    pushed_away: Sequence[Found] = ()
    limbs: Limbs | None = None


def verdict_of(findings: Findings) -> tuple[str, tuple[str, ...]]:
    """The verdict and its reasons; `no_residual` and `attributed` have none."""
    found, channels, pushes = findings.found, findings.channels, findings.pushes
    above = [name for name, c in channels.items() if not c.at_floor or c.worse]
    reasons = [f"{name}: {_above(channels[name])}" for name in above]
    if findings.curves:
        reasons.append("a joint's encoder error varies with its angle")
    reasons += [
        f"{one.effect.name} {one.effect.target}: its size is at its bound"
        for one in found
        if _at_bound(one.effect, findings.limbs)
    ]
    if reasons:
        return "none_of_these", tuple(reasons)
    if pushes and (findings.pushed_away or not found):
        names = [f"{one.effect.name} {one.effect.target}" for one in findings.pushed_away]
        explained = [f"{name}: explains nothing but outside forces" for name in names]
        return "not_identifiable", (*explained, *(one.in_words() for one in pushes))
    if not found:
        return "no_residual", ()
    if not _gains([one.effect for one in found], channels):
        why = "the effects found do not reduce the residual on unseen data"
        return "not_identifiable", (why,)
    imitated = [
        f"{one.effect.name} {one.effect.target}: what the other effects leave may imitate it"
        for one in found
        if (one.effect.name, one.effect.target) in findings.imitated
    ]
    return ("confounded" if findings.rivals or imitated else "attributed"), tuple(imitated)


def _above(c: ChannelLevel) -> str:
    if not c.at_floor:
        left = f"{c.after:.3g} {c.unit} is left on the parts of the logs that no fit has seen"
        return f"{left}, above its noise floor of {c.noise_floor:.3g}"
    return f"worse with the effects found, {c.before:.3g} -> {c.after:.3g} {c.unit}"


def _at_bound(one: Effect, limbs: Limbs | None) -> bool:
    if not type(one).is_compensated():
        return False
    low, high = type(one).interior_bounds(one.target, limbs)
    return not low < one.value < high


def _gains(effects: Sequence[Effect], channels: dict[str, ChannelLevel]) -> bool:
    """Whether the effects reduce a channel that they show in on unseen data.

    True if one of them has an estimate of its own, as sliding feet have, and not from channels.
    """
    if not all(one.is_compensated() and one.traced.by_search for one in effects):
        return True
    shown = {name for one in effects for name in one.traced_at(one.target).channels}
    own = [channels[name] for name in shown if name in channels]
    return not own or any(c.after < c.before for c in own)
