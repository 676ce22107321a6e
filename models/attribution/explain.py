"""Search for the effects that explain logs: sets of candidates, compared by their evidence.

Near the effects found so far, the residual is linear in the sizes of all candidates. The evidence
(marginal likelihood) of every single candidate and of every pair then follows from products under
the covariance of a machine that lacks nothing (`metric`). The best few are refined on the true
residual and compared there, until none earns its place (MacKay, Neural Computation 4, 1992).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice

import numpy as np
from scipy.special import stdtrit

from surefoot.models.attribution.effect_sizes import (
    Found,
    interior_bounds,
    is_sampling_lag,
    per_run_effects,
    plausible_size,
    price_of_some_parts,
    with_clipped_size,
)
from surefoot.models.attribution.evidence import (
    Evidence,
    Key,
    LogUnderModel,
    all_keys,
    event_channels,
    linearise,
    slowest_rate,
    with_compensated,
)
from surefoot.models.attribution.metric import Metric, metric_of
from surefoot.models.attribution.model_error import OF_MEAN, ModelError, at_middles
from surefoot.models.attribution.noise_floor import (
    POINT_FEET_SIZES,
    is_compensated_approximately,
)
from surefoot.models.attribution.weights import sticks
from surefoot.models.residuals.binning import BIN
from surefoot.models.residuals.channels import channels
from surefoot.models.residuals.jacobians import Regressor
from surefoot.sim.effects import Effect, effect, in_order, known_effects
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine

NAMED = 2.0 * np.log(1e3)
"""Twice the logarithm of the odds from which an effect is named, and up to which another one
explains the logs as well: a thousand to one.
"""
CHANCE = 0.005
"""Probability that Student's t, with one degree of freedom less than there are runs, exceeds the
least excess on one side: how runs differ is known from these runs alone.
"""
LEAST_EXCESS = 6.0
"""Least excess [standard deviations] where nothing but the noise of readings is known."""
AGREES = 2.0
"""Standard deviations between blocks of the logs, and between channels, that a size exceeds:
neither a bad block nor a channel that another contradicts makes an effect.
"""
TWIN_OVERLAP = 0.95
"""Cosine of two regressors from which they are nearly collinear."""
SINGLES, PAIRS = 5, 1
"""Single candidates and pairs that are refined in each round."""
_NEAR = 0.5
"""Share of the best evidence from which a candidate may turn out better in the refinement."""
MOST_EFFECTS = 5
"""Most effects of a trace."""
NEWTON_STEPS = 10
"""Most Gauss-Newton steps of a refinement; noise in a derivative makes each fall short."""
SETTLED = 0.02
"""Standard deviations by which sizes move once they have settled."""
MOVED = 0.1
"""Relative change of a size from which derivatives are computed again."""
INEXACT = 1e-4
"""Share of the squared residual that effects of the body explain which their models leave: 1 % of
its amplitude.
"""
EXACT_SHARE = 1e-3
"""Share of an effect's plausible size to which any model is exact."""
LINEAR = ("gyro_bias", "accel_bias")
"""Effects of each log that need no compensation, since the residual is linear in them."""
ZERO_MOVED = 4.0
"""Standard deviations from which a zero of a log is compensated, and again if it moves by more."""
ZERO_SETTLED = 0.5
"""Standard deviations from which a zero is compensated again once the effects are found."""
ZERO_ROUNDS = 4
"""Most times that the zeros of the logs are fitted beside the same effects."""


@dataclass(frozen=True)
class Candidate:
    """A candidate beside the effects found before it, to first order.

    Attributes:
        key: name and target.
        size: its size [its unit].
        deviation: standard deviation of the size [its unit].
        share: of the squared residual that it explains.
        least: size from which it would have been named [its unit].
        at_bound: whether the size is at or beyond its bounds.
        earned: whether it earns a place.
    """

    key: Key
    size: float
    deviation: float
    share: float
    least: float
    at_bound: bool
    earned: bool


@dataclass(frozen=True)
class FittedRun:
    """Effects of one log's own.

    Attributes:
        case: the log with `compensated` compensated.
        zeros: all of them, with 95 % intervals.
        compensated: those compensated; the others are turn-on biases, which every fit and filter
            estimates.
    """

    case: LogUnderModel
    zeros: tuple[Found, ...]
    compensated: tuple[Effect, ...]


@dataclass(frozen=True)
class Explanation:
    """Result of the search.

    Attributes:
        found: effects, strongest first.
        rounds: candidates of each round.
        imitated: keys of those that what the others leave once compensated may imitate.
        rivals: key and overlap of the candidates that explain the logs as well as an effect found.
        dropped: effects that were found and are not kept, and why.
        rejected: other effects that were considered last, and why each is not found.
        runs: each log with its own effects.
        metric: linearised at the effects.
    """

    found: tuple[Found, ...]
    imitated: frozenset[Key]
    rounds: tuple[tuple[Candidate, ...], ...]
    rivals: tuple[tuple[Key, float], ...]
    dropped: tuple[tuple[Effect, str], ...]
    rejected: tuple[tuple[Effect, str], ...]
    runs: tuple[FittedRun, ...]
    metric: Metric


@dataclass(frozen=True)
class Problem:
    """Logs to explain, and what is known of the C candidates before they are seen.

    Attributes:
        cases: the logs under the declared model.
        use: mask (M,) of the bins that are used.
        several: whether zeros, biases and clocks belong to each log.
        keys: the candidates.
        prior: standard deviations of their sizes (C,).
        price: evidence that each must exceed (C,).
        certain: whether every machine has it and the model lacks it (C,).
        unknown: standard deviation of the size that it seems to have, beyond what walks of the
            model show (C,).
        shift: mean time by which it shifts noisy streams [s per unit] (C,).
    """

    cases: Sequence[LogUnderModel]
    use: np.ndarray
    several: bool
    keys: tuple[Key, ...]
    prior: np.ndarray
    price: np.ndarray
    certain: np.ndarray
    unknown: np.ndarray
    shift: np.ndarray

    @property
    def machine(self) -> Machine:
        """The declared model."""
        return self.cases[0].robot

    @property
    def limbs(self) -> Limbs:
        """Limbs of the machine."""
        return self.machine.limbs

    @property
    def per_run(self) -> frozenset[str]:
        """Names of the effects that each log has at a size of its own."""
        return per_run_effects() if self.several else frozenset()

    @property
    def zero_keys(self) -> list[Key]:
        """The candidates that each log has at a size of its own, without sums of others."""
        kinds = known_effects()
        return [
            (name, target)
            for name, target in self.keys
            if name in self.per_run and target in kinds[name].single_targets(self.limbs)
        ]

    @property
    def by_windows(self) -> bool:
        """Whether torques are averaged over windows, as for the error of the model: with several
        runs of a machine on a fixed base. Single rows in which torques jump give no acceleration.
        """
        return self.several and all(c.fixed and c.log.has("tau") for c in self.cases)

    def sized(self, key: Key, size: float) -> Effect:
        """A candidate with a size, clipped to its bounds on the machine."""
        return with_clipped_size(effect(*key, 0.0), size, self.machine)

    def at(self, keys: Sequence[Key]) -> np.ndarray:
        """Places of these candidates (k,)."""
        return np.array([self.keys.index(key) for key in keys], int)


@dataclass(frozen=True)
class Chosen:
    """Effects whose sizes are refined.

    Attributes:
        effects: the k effects.
        misfit: squared residual that they leave, in units of its covariance.
        cost: the misfit, and what the sizes cost: -2 log of their posterior odds, but for the
            price of choosing them.
        metric: under which they are refined.
        precision: of the prior of their sizes (k,).
        table: residual (M, W) with them compensated.
        X: their regressors.
    """

    effects: tuple[Effect, ...]
    misfit: float
    cost: float
    metric: Metric
    precision: np.ndarray
    table: np.ndarray
    X: tuple[Regressor, ...]

    @property
    def keys(self) -> tuple[Key, ...]:
        """Names and targets of the effects (k,)."""
        return tuple((one.name, one.target) for one in self.effects)

    @property
    def sizes(self) -> np.ndarray:
        """Sizes of the effects (k,), each in its unit."""
        return np.array([one.value for one in self.effects])

    @cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the sizes (k, k), with the error of the model."""
        return self._covariance(())

    @cached_property
    def of_noise(self) -> np.ndarray:
        """Covariance of the sizes (k, k) by noise alone."""
        return self._covariance(None)

    def at(self, keys: Sequence[Key]) -> list[int]:
        """Places of these effects (k,)."""
        return [self.keys.index(key) for key in keys]

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations of the sizes (k,)."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def between_blocks(self) -> np.ndarray:
        """Standard deviations of the sizes (k,) by how the blocks of the logs differ: jackknife
        with one block left out (Efron and Stein, Annals of Statistics 9, 1981).
        """
        sizes = self.metric.without_blocks(self.keys, self.precision)
        return np.sqrt((len(sizes) - 1) * np.var(sizes, axis=0))

    @cached_property
    def between_channels(self) -> np.ndarray:
        """Standard deviations of the sizes (k,) by how the channels that would show them differ,
        each by itself. A channel that shows more denies nothing: it lacks something else as well.
        Times of contacts count for what delays them alone: whatever moves a foot also moves these.
        """
        parts, between = self.metric.alone, []
        S = np.array([one.products(self.table, self.X, self.keys) for one in parts.values()])
        of_events = np.array([channels()[name].of_events for name in parts])
        for place, (key, size) in enumerate(zip(self.keys, self.sizes, strict=True), 1):
            weights = np.maximum(S[:, place, place], 0.0)
            tells = of_events == bool(event_channels(key))
            tells &= np.sqrt(weights) * abs(size) > AGREES
            less = np.minimum(np.sign(size) * S[tells, place, 0] / weights[tells], 0.0)
            between.append(deviation_of_mean(less, weights[tells]))
        return np.array(between)

    @property
    def between(self) -> np.ndarray:
        """Standard deviations of the sizes (k,) between blocks or channels, the larger."""
        if not self.effects:
            return np.zeros(0)
        return np.maximum(self.between_blocks, self.between_channels)

    @cached_property
    def least_misfit(self) -> float:
        """The misfit that they would leave without a prior, to first order."""
        S, pull = self.metric.products(self.table, self.X, self.keys), self.precision * self.sizes
        return self.misfit - float(pull @ np.linalg.pinv(S[1:, 1:], hermitian=True) @ pull)

    def _covariance(self, without: tuple[()] | None) -> np.ndarray:
        S = self.metric.products(self.table, self.X, without)[1:, 1:]
        return np.linalg.pinv(S + np.diag(self.precision), hermitian=True)


def problem_of(
    cases: Sequence[LogUnderModel],
    use: np.ndarray,
    several: bool,
) -> Problem:
    """Logs to explain.

    Args:
        cases: the logs under the declared model.
        use: mask (M,) of the bins that may be used.
        several: whether zeros, biases and clocks belong to each log.
    """
    machine, kinds = cases[0].robot, known_effects()
    limbs = machine.limbs
    span = max(float(np.ptp(case.log.t)) for case in cases)
    per_run = per_run_effects() if several else frozenset()
    keys = tuple(dict.fromkeys(key for case in cases for key in all_keys(case)))
    if several:
        # Each clock is compared with the IMU's; a scale of all clocks shows in no residual.
        keys = tuple(key for key in keys if key != ("clock_scale", "imu"))
    certain = np.array(
        [not machine.fixed and kinds[name].is_always_present(at, machine) for name, at in keys]
    )
    of_choice = NAMED + 2.0 * np.log(len(keys))
    # What belongs to each log is no effect of the machine.
    price = [
        np.inf
        if key[0] in per_run
        else price_of_some_parts(*key, limbs) + (0.0 if sure else of_choice)
        for key, sure in zip(keys, certain, strict=True)
    ]
    return Problem(
        cases=cases,
        use=use,
        several=several,
        keys=keys,
        prior=np.array([plausible_size(*key, limbs) / 1.96 for key in keys]),
        price=np.array(price),
        certain=certain,
        unknown=np.array([_unknown_size(key, limbs, slowest_rate(cases)) for key in keys]),
        shift=np.array([kinds[name].shift_in(span) for name, _ in keys]),
    )


def _unknown_size(key: Key, limbs: Limbs, rate: float) -> float:
    """Standard deviation of the size that an effect seems to have without being there.

    A lag within a row is there in every log, at this rate [Hz], and is compensated however short.
    """
    name, target = key
    exact = effect(name, target, EXACT_SHARE * plausible_size(name, target, limbs))
    traced = known_effects()[name].traced_at(target)
    shows_in = [channels()[c] for c in traced.channels if c in channels()]
    levels = [channel.level_spread.get(target, 0.0) for channel in shows_in]
    if limbs.feet_alone:
        levels.append(POINT_FEET_SIZES.get(key, 0.0))
    return max(0.0 if is_sampling_lag(exact, rate) else exact.value, *levels, 0.0)


def explain(
    problem: Problem,
    error: ModelError,
    left: Callable[[Sequence[Effect], Sequence[Key]], np.ndarray],
    harmful: Callable[[Metric, Problem, Sequence[Effect]], tuple[Effect, str] | None] = lambda *_: (
        None
    ),
    needed: Callable[[Metric, Problem, Sequence[Effect], Sequence[Effect]], bool] = lambda *_: (
        False
    ),
    progress: Callable[[float], None] = lambda share: None,
) -> Explanation:
    """Add the best candidate or pair until none earns its place, then replace what another explains
    better.

    A candidate earns its place if the evidence for it exceeds its price, and its size the least
    excess over its standard deviation. Effects that every machine has are chosen first. Whenever
    one is added, those that no longer earn theirs are dropped. Finally those are dropped that what
    the others leave once they are compensated may imitate, unless a channel is worse without them
    than that; and those that harm on bins that no fit has seen.

    Args:
        problem: the logs.
        error: of the declared model.
        left: standard deviations of the sizes (k,) that these candidates seem to have in what
            walks of the model with these effects leave once they are compensated.
        harmful: an effect of these that harms, and why; None if none does.
        needed: whether a channel is worse with the second effects than with the first.
        progress: called with the share done, from 0 to 1.
    """
    state, chosen = _settled(_State.of(problem, error), ())
    rounds: list[tuple[Candidate, ...]] = []
    rivals: tuple[tuple[Key, float], ...] = ()
    rejected: tuple[tuple[Effect, str], ...] = ()
    tried = {frozenset(chosen.keys)}
    once: dict[Key, Effect] = {}

    def settled_anew(better: Chosen | None) -> tuple[_State, Chosen] | None:
        """The search at better effects, if there are any and it was not there before."""
        if better is None:
            return None
        once.update(zip(better.keys, better.effects, strict=True))
        settled = _settled(state, better.effects)
        if (keys := frozenset(settled[1].keys)) in tried:
            return None
        tried.add(keys)
        return settled

    while True:
        progress(min(len(rounds) / (MOST_EFFECTS + 1), 1.0))
        beside = _beside(state, chosen)
        rounds.append(_as_candidates(state, beside))
        anew = None
        if len(chosen.keys) < MOST_EFFECTS:
            better, rejected = _extended(state, chosen, beside)
            anew = settled_anew(better)
        if anew is None:
            better, rivals = _replaced(state, chosen)
            anew = settled_anew(better)
        if anew is None:
            break
        state, chosen = anew
    at_fewer, fewer = _not_imitated(state, chosen, left)
    imitated = frozenset(chosen.keys) - frozenset(fewer.keys)
    dropped: list[tuple[Effect, str]] = []
    imitations: list[tuple[Effect, str]] = []
    if len(fewer.effects) < len(chosen.effects) and not needed(
        state.metric, state.problem, chosen.effects, fewer.effects
    ):
        why = "what the other effects leave once they are compensated may imitate it"
        imitations = _without(chosen.effects, fewer, why)
        state, chosen = at_fewer, fewer
    while True:
        if harm := harmful(state.metric, state.problem, chosen.effects):
            dropped.append(harm)
            better = [e for e in chosen.effects if e != harm[0]]
        else:
            one, rivals = _replaced(state, chosen) if dropped else (None, rivals)
            if one is None or frozenset(one.keys) in tried:
                break
            tried.add(frozenset(one.keys))
            better = one.effects
        state, chosen = _settled(state, better)
    if problem.several:
        # Residuals are reported with the zeros that are compensated.
        before = chosen.effects
        state, chosen = _settled(state, before, moved=ZERO_SETTLED)
        why = "the logs' own zeros explain it, once they are fitted closely"
        dropped += _without(before, chosen, why)
    dropped += imitations
    known = {(e.name, e.target) for e, _ in (*dropped, *rejected)}
    others = [one for key, one in once.items() if key not in known]
    dropped += _without(others, chosen, "the other effects explain the logs as well without it")
    return Explanation(
        found=_with_intervals(state, chosen, left(chosen.effects, chosen.keys)),
        imitated=imitated & frozenset(chosen.keys),
        rounds=tuple(rounds),
        rivals=tuple(rival for rival in rivals if rival[0] not in chosen.keys),
        dropped=tuple(one for one in dropped if (one[0].name, one[0].target) not in chosen.keys),
        rejected=rejected,
        runs=_fitted_runs(state),
        metric=state.metric,
    )


def _without(effects: Sequence[Effect], chosen: Chosen, why: str) -> list[tuple[Effect, str]]:
    """Those of the effects that are not chosen, each with the reason why."""
    return [(one, why) for one in effects if (one.name, one.target) not in chosen.keys]


def zeros_beside(
    problem: Problem, error: ModelError, effects: Sequence[Effect]
) -> tuple[tuple[FittedRun, ...], Metric]:
    """Each log's own zeros, biases and clocks beside given effects, and the metric with them."""
    state = _State.of(problem, error).at(effects)
    state = _with_zeros(state, effects)
    return _fitted_runs(state), state.metric


@dataclass(frozen=True)
class _State:
    """The search at some effects.

    Attributes:
        declared: the logs under the declared model.
        problem: the logs, with their own zeros and clocks compensated.
        effects: that are compensated.
        error: of the declared model.
        metric: linearised at the effects.
        explained: squared residual of each channel (channels,) that effects of the body explain, in
            units of the noise.
    """

    declared: Sequence[LogUnderModel]
    problem: Problem
    effects: tuple[Effect, ...]
    error: ModelError
    metric: Metric
    explained: np.ndarray = field(default_factory=lambda: np.zeros(1))

    @staticmethod
    def of(problem: Problem, error: ModelError) -> "_State":
        if problem.by_windows:
            noise = {group: OF_MEAN * level for group, level in error.noise.items()}
            error = replace(error, noise=noise)
        metric = _metric(problem, (), None, error)
        return _State(problem.cases, problem, (), error, metric)

    def at(self, effects: Sequence[Effect]) -> "_State":
        """The search at other effects, with each log's zeros as they are."""
        # Other effects change the derivatives with respect to all candidates.
        same = {(e.name, e.target) for e in effects} <= {(e.name, e.target) for e in self.effects}
        before = self.metric.known if same else None
        metric = _metric(self.problem, effects, before, self.error)
        return replace(self, effects=tuple(effects), metric=metric)

    @property
    def least_excess(self) -> float:
        """Standard deviations that a size of an unchanged machine hardly exceeds."""
        return least_excess(self.error)

    def bias(self, at: np.ndarray, deviations: np.ndarray) -> np.ndarray:
        """Most by which sizes of candidates (k,) with these standard deviations are biased.

        Interpolation by a share f of a row lowers the variance of the mean of n rows by 2 f / n. A
        shift by x then seems to explain 2 x E / BIN of E entries, and is biased by E / BIN times
        its variance; half a row between rows, nothing more is gained.
        """
        known = np.where(np.isfinite(deviations), deviations, 0.0)
        shift = self.problem.shift[at]
        row = 1.0 / slowest_rate(self.problem.cases)
        with np.errstate(divide="ignore", invalid="ignore"):
            most = np.where(shift > 0.0, 0.5 * row / shift, 0.0)
        return np.minimum(shift * self.metric.entries[at] / BIN * known**2, most)

    def least_excess_of(self, at: np.ndarray) -> np.ndarray:
        """The least excess (k,) of candidates at these places: half for what every machine has."""
        return self.least_excess * np.where(self.problem.certain[at], 0.5, 1.0)

    def least(self, at: np.ndarray, deviations: np.ndarray) -> np.ndarray:
        """Sizes (k,) from which candidates with these standard deviations would be named."""
        prior, price = self.problem.prior[at], self.problem.price[at]
        known = np.hypot(deviations, self.problem.unknown[at])
        named = least_named(known, prior, price, self.least_excess_of(at))
        return named + self.bias(at, deviations)

    def earned(self, keys: Sequence[Key], sizes: np.ndarray, deviations: np.ndarray) -> np.ndarray:
        """By how much the evidence for sizes with these standard deviations exceeds its price (k,);
        negative also where a size does not reach the least excess or is at its bound.
        """
        at = self.problem.at(keys)
        variance = np.hypot(deviations, self.problem.unknown[at]) ** 2
        prior = self.problem.prior[at] ** 2
        bounds = [interior_bounds(*key, self.problem.machine) for key in keys]
        inside = np.array(
            [low < x < high for x, (low, high) in zip(sizes, bounds, strict=True)], bool
        )
        sizes = np.maximum(np.abs(sizes) - self.bias(at, deviations), 0.0)
        with np.errstate(invalid="ignore"):
            evidence = (
                sizes**2 / variance - sizes**2 / (variance + prior) - np.log1p(prior / variance)
            )
            evidence = np.where(np.isfinite(variance), evidence, -np.inf) - self.problem.price[at]
            evidence -= INEXACT * np.sum(self.metric.shares[at] * self.explained, axis=-1)
            excess = sizes / np.sqrt(variance)
        return np.where(
            (excess > self.least_excess_of(at)) & inside, evidence, np.minimum(evidence, -1.0)
        )

    def earned_by(self, chosen: Chosen) -> np.ndarray:
        """As `earned`, of refined effects (k,), on whose sizes blocks and channels must agree."""
        earned = self.earned(chosen.keys, chosen.sizes, chosen.deviations)
        if not (earned > 0.0).any():
            return earned
        agreed = np.abs(chosen.sizes) > AGREES * chosen.between
        return np.where(agreed, earned, np.minimum(earned, -1.0))


def deviation_of_mean(values: np.ndarray, weights: np.ndarray) -> float:
    """Standard deviation of the mean of values (n,) that differ by more than the noise that their
    weights (n,), inverse variances, say: random effects (DerSimonian and Laird, Controlled Clinical
    Trials 7, 1986). 0 of none.
    """
    if not len(values):
        return 0.0
    total = float(np.sum(weights))
    Q = float(weights @ (values - weights @ values / total) ** 2)
    free = total - float(weights @ weights) / total
    between = (Q - (len(values) - 1)) / free if len(values) > 1 else 0.0
    return float(np.sum(1.0 / (1.0 / weights + max(between, 0.0))) ** -0.5)


def least_excess(error: ModelError) -> float:
    """Standard deviations that a size hardly exceeds in runs of a machine that lacks nothing, by
    Student's t of as many runs as the model's error is known from.
    """
    return float(stdtrit(error.runs - 1, 1.0 - CHANCE)) if error.runs > 1 else LEAST_EXCESS


def least_named(
    deviation: np.ndarray | float,
    prior: np.ndarray | float,
    price: np.ndarray | float,
    excess: np.ndarray | float,
) -> np.ndarray:
    """Sizes (C,) whose evidence reaches its price and which exceed their standard deviations (C,)
    by `excess`, for standard deviations of their prior (C,).
    """
    ratio = (prior / deviation) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        enough = np.sqrt((price + np.log1p(ratio)) * (1.0 + ratio) / ratio)
    return np.maximum(enough, excess) * deviation


@dataclass(frozen=True)
class _Beside:
    """Evidence of the C candidates beside the effects found, to first order.

    Attributes:
        S: products (1 + C, 1 + C) without what the effects found explain.
        evidence: of each, less its price (C,).
        sizes: (C,).
        deviations: standard deviations of the sizes (C,), infinite where nothing shows.
    """

    S: np.ndarray
    evidence: np.ndarray
    sizes: np.ndarray
    deviations: np.ndarray


def _beside(state: _State, chosen: Chosen, instead_of: int | None = None) -> _Beside:
    """Candidates beside the effects found, or `instead_of` one of them."""
    problem, S = state.problem, state.metric.S
    at = 1 + problem.at(chosen.keys)
    if instead_of is not None:
        # Its own part is back in the residual.
        turned = np.eye(len(S))
        turned[at[instead_of], 0] = chosen.sizes[instead_of]
        S, at = turned.T @ S @ turned, np.delete(at, instead_of)
    if len(at):
        A = S[np.ix_(at, at)] + np.diag(problem.prior[at - 1] ** -2.0)
        S = S - S[:, at] @ np.linalg.solve(A, S[at])
    precision, d, b = problem.prior**-2.0, np.diag(S)[1:], S[1:, 0]
    whole = np.einsum("kii->i", state.metric.grams)[1 : len(S)]
    seen = d > 1e-9 * np.maximum(whole, 1.0)
    seen[at - 1] = False
    d = np.where(seen, d, 1.0)
    evidence = b**2 / (d + precision) - np.log1p(d / precision) - problem.price
    return _Beside(
        S=S,
        evidence=np.where(seen, evidence, -np.inf),
        sizes=np.where(seen, b / (d + precision), 0.0),
        deviations=np.where(seen, d**-0.5, np.inf),
    )


def _as_candidates(state: _State, beside: _Beside) -> tuple[Candidate, ...]:
    """Every candidate of a round, those that earn a place first, by evidence."""
    problem = state.problem
    earned = state.earned(problem.keys, beside.sizes, beside.deviations)
    total = max(float(beside.S[0, 0]), 1e-300)
    gains = beside.sizes * beside.S[1:, 0]
    every = np.arange(len(problem.keys))
    deviations = np.hypot(beside.deviations, problem.unknown)
    least = state.least(every, beside.deviations)
    out = []
    for i in np.argsort(-beside.evidence):
        name, target = problem.keys[i]
        low, high = interior_bounds(name, target, problem.machine)
        if name not in problem.per_run and np.isfinite(beside.deviations[i]):
            out.append(
                Candidate(
                    key=problem.keys[i],
                    size=float(beside.sizes[i]),
                    deviation=float(deviations[i]),
                    share=float(gains[i]) / total,
                    least=float(least[i]),
                    at_bound=bool(not low < beside.sizes[i] < high),
                    earned=bool(earned[i] > 0.0 and beside.evidence[i] > 0.0),
                )
            )
    return tuple(sorted(out, key=lambda one: not one.earned))


def _extended(
    state: _State, chosen: Chosen, beside: _Beside
) -> tuple[Chosen | None, tuple[tuple[Effect, str], ...]]:
    """The effects with the candidate or pair added that leaves the least cost, if it earns its
    place, else None; and what was tried and does not, with the reason.
    """
    tried, rejected = [], []
    for keys, sizes, likely in _proposals(state, beside):
        if tried and not likely:
            break
        new = [state.problem.sized(key, x) for key, x in zip(keys, sizes, strict=True)]
        one = _refined(state, [*chosen.effects, *new])
        gained = chosen.cost - one.cost - float(np.sum(state.problem.price[state.problem.at(keys)]))
        at = one.at(keys)
        if gained > 0.0 and np.all(state.earned_by(one)[at] > 0.0):
            tried.append((gained, one))
        else:
            rejected += [(one.effects[i], _why_not(state, one, i, gained)) for i in at]
    best = max(tried, key=lambda pair: pair[0])[1] if tried else None
    return best, tuple(rejected)


def _proposals(state: _State, beside: _Beside) -> Iterator[tuple[list[Key], np.ndarray, bool]]:
    """Candidates and pairs with their sizes to first order: those that might be the best, then, as
    not so likely, others, since far from zero the first order may promise too much.
    """
    problem, keys = state.problem, state.problem.keys
    earned = state.earned(keys, beside.sizes, beside.deviations)
    every = able = (beside.evidence > 0.0) & (earned > 0.0)
    if (first := able & problem.certain).any():
        # Others would absorb what every machine has.
        able = first
    order = [int(i) for i in np.argsort(-beside.evidence)]
    best = float(np.max(beside.evidence, where=able, initial=0.0))
    near = (i for i in order if able[i] and beside.evidence[i] > _NEAR * best)
    likely = list(islice(_distinct(near, problem), SINGLES))
    for i in likely:
        yield [keys[i]], beside.sizes[[i]], True
    pairs = np.triu(_of_pairs(problem, beside), 1)
    if first.any():
        pairs = np.where(first[:, None] & first, pairs, 0.0)
    ends = np.argpartition(-pairs, min(PAIRS, pairs.size) - 1, axis=None)[:PAIRS]
    for flat in sorted(ends, key=lambda flat: -pairs.flat[flat]):
        pair = np.array(np.unravel_index(flat, pairs.shape))
        if pairs[tuple(pair)] > max(best, 0.0):
            A = beside.S[np.ix_(1 + pair, 1 + pair)] + np.diag(problem.prior[pair] ** -2.0)
            yield [keys[i] for i in pair], np.linalg.solve(A, beside.S[1 + pair, 0]), True
    others = (i for i in order if every[i] and i not in likely)
    for i in islice(_distinct(others, problem), SINGLES):
        yield [keys[i]], beside.sizes[[i]], False


def _distinct(order: Iterator[int], problem: Problem) -> Iterator[int]:
    """Candidates in this order without those that share parts with one of the same name before."""
    taken: set[tuple[str, str]] = set()
    for i in order:
        name, target = problem.keys[i]
        parts = {(name, part) for part in known_effects()[name].members_of(target, problem.limbs)}
        if not parts & taken:
            taken |= parts
            yield i


def _of_pairs(problem: Problem, beside: _Beside) -> np.ndarray:
    """Evidence (C, C) of pairs of candidates, less their prices; zero where there is none."""
    precision = problem.prior**-2.0
    c, b = beside.S[1:, 1:], beside.S[1:, 0]
    d = np.diag(c) + precision
    whole = d[:, None] * d
    seen = np.isfinite(beside.deviations) & np.isfinite(problem.price)
    # Those that show in nothing may have products a little below zero.
    with np.errstate(invalid="ignore"):
        determinant = np.maximum(whole - c**2, 1e-12 * whole)
        gain = (b[:, None] ** 2 * d - 2.0 * b[:, None] * b * c + b**2 * d[:, None]) / determinant
        shrink = np.log(determinant / (precision[:, None] * precision))
        evidence = gain - shrink - problem.price[:, None] - problem.price
        known = seen[:, None] & seen & (np.abs(c) < 0.999 * np.sqrt(whole))
    return np.where(known, evidence, 0.0)


def _replaced(state: _State, chosen: Chosen) -> tuple[Chosen | None, tuple[tuple[Key, float], ...]]:
    """The effects with one replaced by a candidate that explains the logs better, if there is one;
    else the rivals that explain them as well.
    """
    problem, rivals = state.problem, []
    for place, key in enumerate(chosen.keys):
        own = int(problem.at([key])[0])
        if problem.certain[own]:
            continue
        beside = _beside(state, chosen, instead_of=place)
        S = beside.S[1:, 1:]
        with np.errstate(invalid="ignore"):
            overlap = np.abs(S[own]) / np.sqrt(S[own, own] * np.diag(S))
        # To first order, the gain of a large size may be off by more than NAMED.
        alike = overlap > TWIN_OVERLAP
        earned = state.earned(problem.keys, beside.sizes, beside.deviations)
        able = (earned > 0.0) & ((beside.evidence > beside.evidence[own]) | alike)
        able[problem.at(chosen.keys)] = False
        able &= np.isfinite(beside.evidence)
        order = (int(i) for i in np.argsort(-beside.evidence) if able[i])
        for i in islice(_distinct(order, problem), SINGLES):
            other = problem.sized(problem.keys[i], beside.sizes[i])
            one = _refined(state, [*chosen.effects[:place], other, *chosen.effects[place + 1 :]])
            costs = problem.price[i] - problem.price[own]
            if not np.all(state.earned_by(one) > 0.0):
                continue
            if one.cost + costs < chosen.cost:
                return one, ()
            twin = alike[i] and problem.keys[i][0] != key[0]
            if twin and one.least_misfit < chosen.least_misfit + NAMED:
                rivals.append((problem.keys[i], float(overlap[i])))
    return None, tuple(rivals)


def _why_not(state: _State, chosen: Chosen, place: int, gained: float) -> str:
    """Why a refined effect at this place does not earn it."""
    one, size = chosen.effects[place], abs(chosen.sizes[place])
    low, high = interior_bounds(one.name, one.target, state.problem.machine)
    if not low < one.value < high:
        bound = low if one.value <= low else high
        return f"its size is at its bound of {bound:.2g} {one.unit}"
    for parts, between in (
        ("the log's blocks", chosen.between_blocks[place]),
        ("channels", chosen.between_channels[place]),
    ):
        if size <= AGREES * between:
            return f"{parts} disagree on it: {size / between:.1f} of {AGREES:g} standard deviations"
    if gained <= 0.0:
        return f"its evidence is {-0.5 * gained:.1f} below its price, in units of ln(odds)"
    at = state.problem.at([chosen.keys[place]])
    size -= state.bias(at, chosen.deviations[[place]])[0]
    excess = max(size, 0.0) / np.hypot(chosen.deviations[place], state.problem.unknown[at][0])
    least = state.least_excess_of(at)[0]
    if excess < least:
        return f"{excess:.1f} of {least:.1f} standard deviations"
    return f"{excess:.1f} standard deviations, too little evidence for the price of one more effect"


def _not_imitated(
    state: _State, chosen: Chosen, left: Callable[[Sequence[Effect], Sequence[Key]], np.ndarray]
) -> tuple[_State, Chosen]:
    """Drop the effects that the residual which the others leave once compensated may imitate; left
    as of `explain`.

    How much is left depends on how an effect is simulated, so it is no part of the error under
    which sizes are fitted.
    """
    while chosen.effects:
        imitated = [
            left([e for e in chosen.effects if e != one], chosen.keys)[place]
            for place, one in enumerate(chosen.effects)
        ]
        deviations = np.hypot(chosen.deviations, imitated)
        earned = state.earned(chosen.keys, chosen.sizes, deviations)
        kept = _without_worst(chosen, earned)
        if kept is None:
            break
        state, chosen = _settled(state, kept)
    return state, chosen


def _without_worst(chosen: Chosen, earned: np.ndarray) -> tuple[Effect, ...] | None:
    """The effects without the one that earns its place least; None if all earn theirs."""
    worst = int(np.argmin(earned)) if len(earned) else -1
    if worst < 0 or earned[worst] > 0.0:
        return None
    return (*chosen.effects[:worst], *chosen.effects[worst + 1 :])


def _settled(
    state: _State, effects: Sequence[Effect], moved: float = ZERO_MOVED
) -> tuple[_State, Chosen]:
    """Fit each log's zeros (`moved` as of `_with_zeros`) and the sizes of effects in turn; drop
    what does not earn its place.
    """
    while True:
        if tuple(effects) != state.effects:
            state = state.at(effects)
        state = _with_zeros(state, effects, moved)
        chosen = _refined(state, effects)
        state = replace(state, explained=_explained_by_body(state, chosen))
        kept = _without_worst(chosen, state.earned_by(chosen))
        if kept is None:
            return state, chosen
        effects = kept


def _refined(state: _State, start: Sequence[Effect]) -> Chosen:
    """Refine the sizes of effects on the true residual, by Gauss-Newton steps."""
    problem, metric, machine = state.problem, state.metric, state.problem.machine
    effects = in_order([with_clipped_size(one, one.value, machine) for one in start])
    keys = [(one.name, one.target) for one in effects]
    precision = problem.prior[problem.at(keys)] ** -2.0
    # Size at which each derivative was taken, and the derivative.
    known = {(e.name, e.target): e.value for e in state.effects}
    derived = {key: (x, metric.known.X[metric.known.keys.index(key)]) for key, x in known.items()}
    best = None
    for _ in range(NEWTON_STEPS):
        stale = [
            key
            for key, one in zip(keys, effects, strict=True)
            if key not in derived or abs(derived[key][0] - one.value) > MOVED * abs(one.value)
        ]
        sizes = np.array([one.value for one in effects])
        seen = _observed(problem, effects, stale, state.effects)
        for key, one in zip(stale, seen.X, strict=True):
            derived[key] = sizes[keys.index(key)], one
        table, X = seen.table, tuple(derived[key][1] for key in keys)
        S = metric.products(table, X, keys)
        A, scale = S[1:, 1:] + np.diag(precision), np.sqrt(precision)
        volume = np.linalg.slogdet(A / scale / scale[:, None])[1]
        cost = float(S[0, 0] + precision @ sizes**2 + volume)
        if best is None or cost < best.cost:
            best = Chosen(effects, float(S[0, 0]), cost, metric, precision, table, X)
        inverse = np.linalg.pinv(A, hermitian=True)
        moved = sizes + inverse @ (S[1:, 0] - precision * sizes)
        effects = tuple(
            with_clipped_size(one, x, machine) for one, x in zip(effects, moved, strict=True)
        )
        change = np.array([one.value for one in effects]) - sizes
        if np.all(np.abs(change) <= SETTLED * np.sqrt(np.diag(inverse))):
            break
    assert best is not None
    return best


def _explained_by_body(state: _State, chosen: Chosen) -> np.ndarray:
    """Squared residual of each channel (channels,) that those of the effects explain which a model
    compensates only approximately.
    """
    exact = [one for one in chosen.effects if not is_compensated_approximately(one)]
    if len(exact) == len(chosen.effects):
        return np.zeros(1)
    without = _observed(state.problem, exact, (), exact).table
    square = state.metric.squares
    return np.maximum(square(without) - square(chosen.table), 0.0)


def _with_zeros(state: _State, effects: Sequence[Effect], moved: float = ZERO_MOVED) -> _State:
    """Compensate each log's zeros and clocks that are far from where they are now, by more than
    `moved` standard deviations.
    """
    problem = state.problem
    keys = [key for key in problem.zero_keys if key[0] not in LINEAR]
    doubt = problem.unknown[problem.at(keys)]
    for _ in range(ZERO_ROUNDS):
        zeros = []
        for case, fitted in zip(problem.cases, state.metric.zeros(keys), strict=True):
            sizes = {(e.name, e.target): e.value for e in case.zeros}
            for key, (size, deviation), more in zip(keys, fitted, doubt, strict=True):
                least = ZERO_MOVED * np.hypot(deviation, more)
                known = key in sizes
                if abs(size - sizes.get(key, 0.0)) > (moved * deviation if known else least):
                    sizes[key] = size
                if abs(sizes.get(key, 0.0)) <= least:
                    sizes.pop(key, None)
            zeros.append(tuple(problem.sized(key, size) for key, size in sizes.items()))
        if zeros == [case.zeros for case in problem.cases]:
            break
        cases = [
            replace(with_compensated(case, these), zeros=these)
            for these, case in zip(zeros, state.declared, strict=True)
        ]
        problem = replace(problem, cases=cases)
        metric = _metric(problem, effects, state.metric.known, state.error, moved=keys)
        state = replace(state, problem=problem, metric=metric)
    return state


def _metric(
    problem: Problem,
    effects: Sequence[Effect],
    before: Evidence | None,
    error: ModelError,
    moved: Sequence[Key] = (),
) -> Metric:
    """Metric at these effects.

    Args:
        problem: of the search.
        effects: that are compensated.
        before: an evidence whose derivatives may be reused.
        error: of the model.
        moved: candidates that the logs have at other sizes than those of `before`.
    """
    before = None if problem.by_windows else before
    known = linearise(
        problem.cases, effects, problem.keys, before, evaluation_channels=False, moved=moved
    )
    known = without_sticking(problem, effects, known)
    return metric_of(problem.cases, known, error, problem.use, problem.per_run)


def without_sticking(problem: Problem, effects: Sequence[Effect], known: Evidence) -> Evidence:
    """The evidence without the entries in which a joint of a fixed base may stick at effects, over
    windows if the problem is.
    """
    still = sticks(problem.cases, effects, known.layout)
    known = replace(known, table=np.where(still, np.nan, known.table))
    return at_middles(known) if problem.by_windows else known


def _observed(
    problem: Problem, effects: Sequence[Effect], keys: Sequence[Key], at: Sequence[Effect]
) -> Evidence:
    """Residual with effects compensated and its derivatives with respect to `keys`, as of
    `without_sticking` at other effects.
    """
    known = linearise(problem.cases, effects, keys, evaluation_channels=False, nuisance=False)
    return without_sticking(problem, at, known)


def _with_intervals(state: _State, chosen: Chosen, left: np.ndarray) -> tuple[Found, ...]:
    """Effects, strongest first, with 95 % intervals.

    left: standard deviations (k,) by what they leave once compensated.
    """
    at = state.problem.at(chosen.keys)
    noise, both = np.diag(chosen.of_noise), np.diag(chosen.covariance) + left**2
    runs = state.error.runs
    of_model = stdtrit(runs - 1, 0.975) ** 2 if runs > 1 else 1.96**2
    square = 1.96**2 * (noise + state.problem.unknown[at] ** 2)
    half = np.sqrt(square + of_model * np.maximum(both - noise, 0.0))
    bias = state.bias(at, np.sqrt(both))
    half += bias
    deviations = np.hypot(np.sqrt(both), state.problem.unknown[at])
    excess = np.maximum(np.abs(chosen.sizes) - bias, 0.0) / deviations
    least = state.least(at, np.sqrt(both))
    found = [
        Found(
            one,
            (one.value - h, one.value + h),
            excess=float(ratio),
            least=float(smallest),
            agreement=abs(one.value) / max(between, 1e-300),
        )
        for one, h, ratio, smallest, between in zip(
            chosen.effects, half, excess, least, chosen.between, strict=True
        )
    ]
    return tuple(sorted(found, key=lambda one: -one.excess))


def _fitted_runs(state: _State) -> tuple[FittedRun, ...]:
    """Each log's own zeros, biases and clocks."""
    problem, keys, runs = state.problem, state.problem.zero_keys, []
    for case, fitted in zip(problem.cases, state.metric.zeros(keys), strict=True):
        known = {(e.name, e.target): e.value for e in case.zeros}
        found = []
        for key, (size, deviation) in zip(keys, fitted, strict=True):
            one = problem.sized(key, known.get(key, size))
            half = 1.96 * deviation
            if key in known or key[0] in LINEAR:
                found.append(Found(one, (one.value - half, one.value + half)))
        runs.append(FittedRun(case, tuple(found), case.zeros))
    return tuple(runs)
