"""Error of a machine's model, as runs of the unchanged machine show it.

No model is exact. Its errors appear a little different in every run, and a fit to a single run
attributes them to effects that the machine does not have. In the residual of run r, linear in the C
sizes of the catalogue,

    y_r = X_r (c + u_r) + Z_r z_r + e_r,   c ~ N(0, a^2 D),   u_r ~ N(0, B^2 D)

c is common to all runs, u_r belongs to one, z_r are its zeros and biases, and D scales all terms to
the same residual. B is diagonal, with one value for all terms that show most in one channel: runs
differ more in forces, say, than in the motion of feet. a, B and the noise of each group of columns
maximise the likelihood of all runs by expectation maximisation (a mixed model: Laird and Ware,
Biometrics 38, 1982).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import block_diag

from surefoot.models.attribution.design import design, nuisance_precision, scaled_inverse
from surefoot.models.attribution.effect_sizes import plausible_size
from surefoot.models.attribution.evidence import (
    Changes,
    Evidence,
    Key,
    LogUnderModel,
    all_keys,
    linearise,
)
from surefoot.models.attribution.weights import robust_weights
from surefoot.models.residuals.binning import BIN
from surefoot.sim.effects import Effect, known_effects
from surefoot.sim.log import Log
from surefoot.sim.robot.limbs import Limbs

MEAN_WINDOW = 0.45
"""Length of the windows in which the torques of a machine on a fixed base are averaged [s]: long
compared with rows whose torques jump, short compared with a swing.
"""
OF_MEAN = float(np.sqrt(1.5 * BIN / MEAN_WINDOW))
"""Noise of such a mean, relative to the white noise of its bins."""
WHOLE = 0.8
"""Share of its bins that a window has at least."""
ZERO = "encoder_offset"
"""The effect that every run of a machine has at a size of its own."""
PER_RUN = frozenset({ZERO, "clock_scale", "reference_delay"})
"""Effects that every run has at a size of its own: zeros, and the clocks of its recording."""
NO_TERMS = frozenset({"torque_scale", "gyro_scale", "accel_scale", "gyro_bias", "accel_bias"})
"""Effects that are no error of a model: biases belong to a run, and a scale together with all
masses explains any torque.
"""
EXACT = frozenset(
    {
        *("clock_scale", "imu_delay", "joint_delay", "rate_delay", "torque_delay"),
        *("command_delay", "reference_delay", "gyro_g_sensitivity"),
        *("gyro_scale", "accel_scale", "gyro_bias", "accel_bias"),
    }
)
"""Effects that are no error of the model in simulated walks, whose sensors and clocks are as
declared.
"""
ANGLE_ERROR = "angle_error"
"""Name of what a sensor may add to its joint's angle (`angle_errors`)."""
FEWEST_RUNS = 3
"""Runs needed to estimate how they differ."""
LEAST_NOISE = 0.3
"""Share of the noise by data sheets that a bin has at least."""
NOTHING = 1e-9
"""Mean square of the relative residual per unit up to which a size changes nothing but rounding,
such as the mass of a link that turns about a vertical axis.
"""
_START = (1.0, 0.02, 0.3)
"""Initial a, B, and noise relative to the residual."""
_ROUNDS = 100
"""Most rounds of the expectation maximisation."""
_NEARLY = 0.02
"""Change at convergence for simulated walks, in place of _SETTLED. They hardly differ, so that B
converges slowly, and from above: stopped early, it is too large rather than too small.
"""
_FEWEST = 4
"""Fewest rounds: the noise settles first."""
_AHEAD = 3.0
"""Multiple of the step of B where it converges slowly (over-relaxation)."""
_LEAST = 1e-9
"""Share of a group's squared residual below which what is left is rounding."""
_SETTLED = 3e-3
"""Relative change of a and B in a round at which it has converged."""


@dataclass(frozen=True)
class RunSums:
    """Residual of one run and its derivatives, as sums over the G groups of columns.

    Attributes:
        keys: the P candidates and `angle_errors`.
        groups: channel and kind of the columns of each group, which have one noise.
        sums: Gram matrices (G, 1 + P + B, 1 + P + B) of residual, candidates and nuisance.
        count: number of entries of each group (G,).
        nuisance: precision of the nuisance parameters (B,).
        rates: joint -> largest difference between the slope of its angle and its rate, averaged
            over a window [rad/s]; of a machine on a fixed base.
        simulated: whether it is a walk of the model, whose sensors and clocks are as declared.
        least: lower bound of each group's noise (G,).
    """

    keys: tuple[Key, ...]
    groups: tuple[tuple[str, str], ...]
    sums: np.ndarray
    count: np.ndarray
    nuisance: np.ndarray
    rates: dict[str, float]
    simulated: bool = False
    least: np.ndarray | float = 0.0

    @property
    def zeros(self) -> list[Key]:
        """The candidates that every run has at a size of its own."""
        return [] if self.simulated else [key for key in self.keys if key[0] in PER_RUN]

    def of_groups(self, groups: Sequence[tuple[str, str]]) -> "RunSums":
        """The sums restricted to these groups."""
        at = [self.groups.index(group) for group in groups]
        least = np.broadcast_to(self.least, len(self.groups))[at]
        return replace(
            self, groups=tuple(groups), sums=self.sums[at], count=self.count[at], least=least
        )

    def whitened(self, noise: np.ndarray) -> np.ndarray:
        """Gram matrix of all rows in units of each group's noise (G,)."""
        return np.tensordot(noise**-2.0, self.sums, 1)

    def places(self, keys: Sequence[Key]) -> list[int]:
        """Rows of these keys in the sums."""
        return [1 + self.keys.index(key) for key in keys]


@dataclass(frozen=True)
class ModelError:
    """Error of a model in a new run of the unchanged machine, with the effects found compensated.

    Attributes:
        runs: number of runs that it is estimated from.
        keys: the C terms, and other effects whose apparent size differs between runs.
        mean: of their sizes (C,) [units of the effects].
        covariance: of their sizes in a new run (C, C).
        noise: group of columns -> its noise, in the residual's unit.
        rates: joint -> as of `RunSums`, the largest of the runs.
    """

    runs: int
    keys: tuple[Key, ...]
    mean: np.ndarray
    covariance: np.ndarray
    noise: dict[tuple[str, str], float]
    rates: dict[str, float]


def evidence_of(
    cases: Sequence[LogUnderModel], effects: Sequence[Effect] = ()
) -> tuple[Evidence, list[dict[str, float]]]:
    """Evidence of runs with `effects` compensated and all candidates, on a fixed base averaged over
    windows and with `angle_errors`; and the `rates` of each run (`RunSums`).
    """
    first = cases[0]
    errs = first.fixed and first.log.has("dq") and first.log.has("tau")

    def changes(log: Log) -> Changes:
        return angle_errors(log, first.undriven) if errs else {}

    known = linearise(cases, effects, all_keys(first), evaluation_channels=False, changes=changes)
    if not first.fixed:
        return known, [{} for _ in cases]
    known = at_middles(known)
    of_rates, rates = known.layout.of("joint_rate"), []
    for run in range(len(cases)):
        table = known.table[known.log == run][:, of_rates]
        apart = np.nanmax(np.abs(table), axis=0, initial=0.0)
        named = zip(of_rates, apart, strict=True)
        rates.append({known.layout.columns[c].group: float(x) for c, x in named})
    return known, rates


def run_sums(case: LogUnderModel, effects: Sequence[Effect] = ()) -> RunSums:
    """Sums of one run with `effects` compensated, and all candidates."""
    known, (rates,) = evidence_of([case], effects)
    if case.fixed:
        return sums_of(case, known, np.isfinite(known.table).astype(float), rates)
    least = known.layout.noise(case.log.rate)
    return sums_of(case, known, robust_weights(known, least).weight, rates)


def sums_of(
    case: LogUnderModel,
    known: Evidence,
    weight: np.ndarray,
    rates: dict[str, float],
    simulated: bool = False,
) -> RunSums:
    """Sums of one run over each group of columns.

    Of a machine on a fixed base these are its torques, also against their commands.

    Args:
        case: the run.
        known: its evidence.
        weight: of the entries (M, W).
        rates: as of `RunSums`.
        simulated: whether it is a walk of the model.
    """
    table, layout = design(known), known.layout
    used = layout.of("joint_torque", "command") if case.fixed else layout.fitted
    least = 0.0 if case.fixed else LEAST_NOISE * layout.noise(case.log.rate)
    floor = np.broadcast_to(least, layout.width)
    every = np.zeros(len(weight), int)
    groups, sums, count, kept = [], [], [], []
    for columns in layout.alike:
        here = [c for c in columns if c in used]
        if weight[:, here].any():
            groups.append(layout.kinds[here[0]])
            sums.append(table.grams(table.y, np.sqrt(weight), here, every)[0])
            count.append(np.count_nonzero(weight[:, here]))
            kept.append(floor[here].min())
    return RunSums(
        keys=known.keys,
        groups=tuple(groups),
        sums=np.array(sums),
        count=np.array(count, float),
        nuisance=nuisance_precision(known),
        rates=rates,
        simulated=simulated,
        least=np.array(kept),
    )


def at_middles(known: Evidence) -> Evidence:
    """An evidence with means over windows (`window_weights`) in the bins at their middles, and
    nothing in all others.

    A mean is over the values of a column, which has some for half of the window at least.
    """
    logs = [np.flatnonzero(known.log == log) for log in range(known.log.max(initial=0) + 1)]
    weights = [window_weights(known.t[own]) for own in logs]
    middles = [
        own[np.searchsorted(known.t[own], w @ known.t[own])]
        for own, w in zip(logs, weights, strict=True)
    ]
    at, w = np.concatenate(middles), sparse.block_diag(list(map(sparse.csr_array, weights)), "csr")
    there = np.isfinite(known.table)
    share = w @ there.astype(float)

    def means(values: np.ndarray, columns: np.ndarray, nothing: float) -> np.ndarray:
        out = np.full(values.shape, nothing)
        whole = np.where(there[:, columns], values, 0.0)
        out[at] = w @ whole / np.maximum(share[:, columns], 1e-12)
        return out

    table = means(known.table, np.arange(known.layout.width), np.nan)
    table[at] = np.where(share >= 0.5, table[at], np.nan)
    X, Z = (
        tuple(replace(one, values=means(one.values, one.columns, 0.0)) for one in regressors)
        for regressors in (known.X, known.Z)
    )
    return replace(known, table=table, X=X, Z=Z)


def window_weights(t: np.ndarray) -> np.ndarray:
    """Hann windows (N, M) on bins at t (M,) [s], each starting at the middle of the one before;
    none over a gap.
    """
    # The first and the last bin have no neighbour for the slope of a rate.
    if len(t) < 3:
        return np.zeros((0, len(t)))
    middles = np.arange(t[1] + 0.5 * MEAN_WINDOW, t[-2] - 0.5 * MEAN_WINDOW, 0.5 * MEAN_WINDOW)
    x = (t - middles[:, None]) / MEAN_WINDOW
    w = np.where(np.abs(x) < 0.5, 1.0 + np.cos(2.0 * np.pi * x), 0.0)
    total = w.sum(axis=1)
    whole = total > WHOLE * MEAN_WINDOW / np.median(np.diff(t))
    return w[whole] / total[whole, None]


def angle_errors(log: Log, undriven: Sequence[str]) -> Changes:
    """What may be added to the angle and the rate of a joint without a drive, apart from a zero: a
    drift, and shares of all angles.

    Such a joint has no drive's encoder. Its angle often is the difference of an attitude and of the
    angles of other joints.
    """
    drift = log.t - np.mean(log.t)
    out: dict[Key, Mapping[str, np.ndarray]] = {}
    for joint in undriven:
        out[ANGLE_ERROR, f"{joint} drift"] = {f"q_{joint}": drift}
        for of, angle, rate in zip(log.joints, log.q.T, log.dq.T, strict=True):
            out[ANGLE_ERROR, f"{joint} {of}"] = {f"q_{joint}": angle, f"dq_{joint}": rate}
    return out


def model_error(runs: Sequence[RunSums], limbs: Limbs) -> ModelError | None:
    """Estimate the error of a model from runs of the unchanged machine, by the groups of columns
    that all of them have; None for too few runs, for different candidates, and without torques on
    a fixed base.
    """
    groups = [group for group in runs[0].groups if all(group in one.groups for one in runs)]
    alike = all(one.keys == runs[0].keys for one in runs)
    if len(runs) < FEWEST_RUNS or not alike or not groups:
        return None
    runs = [one.of_groups(groups) for one in runs]
    first = runs[0]
    sums, count = (np.sum([getattr(r, x) for r in runs], axis=0) for x in ("sums", "count"))
    scale = np.sqrt(sums[:, 0, 0] / count)
    # Square of the residual, relative to its own, that one unit of each size makes (G, P).
    shown = np.einsum("gii->gi", sums)[:, 1 : 1 + len(first.keys)] / scale[:, None] ** 2
    strength = shown.sum(axis=0) / count.sum()
    named = zip(first.keys, strength, strict=True)
    terms = [key for key, one in named if _is_term(key, first, limbs) and one > NOTHING]
    at = [first.keys.index(key) for key in terms]
    D = 1.0 / strength[at]
    # Terms that show most in the same channel share one entry of B.
    channels = [[of == name for of, _ in groups] for name in dict.fromkeys(of for of, _ in groups)]
    most_shown = np.argmax(np.array(channels, float) @ shown[:, at], axis=0)
    kind, alike = np.unique(most_shown, return_inverse=True, return_counts=True)[1:]
    most_a, settled = np.inf, _SETTLED
    if first.simulated:
        # Nothing that a walk of the model seems to lack is larger than what machines lack.
        most = np.array([plausible_size(*key, limbs) / 1.96 for key in terms])
        D = 1.0 / (1.0 / D + most**-2.0)
        most_a, settled = 1.0, _NEARLY
    parts = [_Part.of(run, terms, limbs) for run in runs]
    a, b, noise = _START[0], np.full(len(alike), _START[1]), _START[2] * scale
    before, posterior = np.full(len(alike), np.inf), None
    for round_ in range(_ROUNDS):
        posterior = _posterior(parts, a**2 * D, b[kind] ** 2 * D, noise)
        next_a = np.sqrt(np.mean((posterior.mean**2 + np.diag(posterior.covariance)) / D))
        next_b = np.sqrt(np.bincount(kind, posterior.differences / D) / alike)
        step, moved = np.log(next_b / b), np.log(min(next_a, most_a) / a)
        a = float(min(next_a, most_a))
        slow = np.abs(step / before - 1.0) < 0.5
        b = b * np.exp(np.where(slow, _AHEAD, 1.0) * step)
        noise = np.maximum(posterior.noise, first.least)
        before = step
        if max(np.abs(step).max(), abs(moved)) < settled and round_ >= _FEWEST:
            break
    assert posterior is not None
    per_run = b[kind] ** 2 * D
    covariance = 0.5 * (posterior.covariance + posterior.covariance.T)
    found = ModelError(
        runs=len(runs),
        keys=tuple(terms),
        mean=posterior.mean,
        covariance=covariance + np.diag(per_run),
        noise=dict(zip(first.groups, noise.tolist(), strict=True)),
        rates={joint: max(run.rates[joint] for run in runs) for joint in first.rates},
    )
    return _with_spread(runs, found, a**2 * D, per_run, limbs)


@dataclass(frozen=True)
class _Part:
    """Sums of one run over its n sizes: C terms, and what belongs to the run.

    Attributes:
        own: prior precision of the latter (n - C,).
        square: of the residual, by group (G,).
        right: products of residual and sizes (G, n).
        gram: products of the sizes (G, n * n).
        count: entries of each group (G,).
    """

    own: np.ndarray
    square: np.ndarray
    right: np.ndarray
    gram: np.ndarray
    count: np.ndarray

    @staticmethod
    def of(run: RunSums, terms: Sequence[Key], limbs: Limbs) -> "_Part":
        use = [*run.places(terms), *own_places(run)]
        gram = run.sums[:, use][:, :, use].reshape(len(run.sums), -1)
        own = own_precision(run, limbs)
        return _Part(own, run.sums[:, 0, 0], run.sums[:, use, 0], gram, run.count)


@dataclass(frozen=True)
class _Posterior:
    """Common sizes given their variances and the noise.

    Attributes:
        mean: (C,).
        covariance: (C, C).
        differences: mean square of what each run has beyond them (C,).
        noise: that the sizes leave (G,).
    """

    mean: np.ndarray
    covariance: np.ndarray
    differences: np.ndarray
    noise: np.ndarray


def _posterior(
    runs: Sequence[_Part], common: np.ndarray, per_run: np.ndarray, noise: np.ndarray
) -> _Posterior:
    """One round of expectation maximisation.

    Args:
        runs: the sums.
        common: prior variances of the common sizes (C,).
        per_run: variances of what runs have beyond them (C,).
        noise: (G,).
    """
    C, weak, information = len(common), 1.0 / per_run, noise**-2.0
    precision, score, solved = np.diag(1.0 / common), np.zeros(C), []
    for run in runs:
        n = run.right.shape[1]
        G, right = (information @ run.gram).reshape(n, n), information @ run.right
        inverse = scaled_inverse(G + np.diag(np.append(weak, run.own)))
        left = G[:, :C]
        precision = precision + G[:C, :C] - left.T @ inverse @ left
        score = score + right[:C] - left.T @ inverse @ right
        solved.append((inverse, right))
    covariance = scaled_inverse(precision)
    mean = covariance @ score
    between, square, total = np.zeros(C), np.zeros(len(noise)), sum(run.square for run in runs)
    for run, (inverse, right) in zip(runs, solved, strict=True):
        # Sizes of the run given the common ones, and their derivative with respect to these.
        pull = inverse[:, :C] * weak
        sizes, spread = inverse @ right + pull @ mean, inverse + pull @ covariance @ pull.T
        more = pull[:C] - np.eye(C)
        vary = np.diag(inverse)[:C] + np.sum(more @ covariance * more, axis=1)
        between += (sizes[:C] - mean) ** 2 + vary
        second = (np.outer(sizes, sizes) + spread).ravel()
        square += run.square - 2.0 * run.right @ sizes + run.gram @ second
    return _Posterior(
        mean=mean,
        covariance=covariance,
        differences=between / len(runs),
        noise=np.sqrt(np.maximum(square, _LEAST * total) / sum(run.count for run in runs)),
    )


def own_places(run: RunSums) -> list[int]:
    """Rows in the sums of what belongs to the run: zeros, biases and other nuisance parameters."""
    first = 1 + len(run.keys)
    return [*run.places(run.zeros), *range(first, first + len(run.nuisance))]


def own_precision(run: RunSums, limbs: Limbs) -> np.ndarray:
    """Prior precision of each of `own_places`."""
    of_zeros = [(plausible_size(*key, limbs) / 1.96) ** -2.0 for key in run.zeros]
    return np.append(of_zeros, run.nuisance)


def against_unchanged(run: RunSums, known: ModelError, limbs: Limbs) -> np.ndarray:
    """a' V^-1 b (1 + P, 1 + P) of the residual less its mean and of all candidates, V the
    covariance of a run of the unchanged machine.
    """
    G = run.whitened(np.array([known.noise[group] for group in run.groups]))
    # The residual less the mean error of the model.
    turned = np.eye(len(G))
    turned[run.places(known.keys), 0] = -known.mean
    G = turned.T @ G @ turned
    use, first = [*run.places(known.keys), *own_places(run)], 1 + len(run.keys)
    own = np.diag(own_precision(run, limbs))
    prior = np.asarray(block_diag(np.linalg.inv(known.covariance), own))
    cross = G[use, :first]
    return G[:first, :first] - cross.T @ np.linalg.solve(G[np.ix_(use, use)] + prior, cross)


def _with_spread(
    runs: Sequence[RunSums],
    known: ModelError,
    common: np.ndarray,
    per_run: np.ndarray,
    limbs: Limbs,
) -> ModelError:
    """The error with the variance by which each effect's apparent size differs between runs beyond
    its error, such as that of a delay, which is no term; and the common sizes beside these.

    Args:
        runs: their sums.
        known: the error by the terms alone.
        common: prior variances of the terms (C,).
        per_run: variances of what runs have beyond the common sizes (C,).
        limbs: of the machine.
    """
    other = {ANGLE_ERROR, *(EXACT if runs[0].simulated else PER_RUN)}
    keys = [key for key in runs[0].keys if key[0] not in other]
    place, square = runs[0].places(keys), np.zeros(len(keys))
    for run in runs:
        S = against_unchanged(run, known, limbs)
        information = np.maximum(np.diag(S)[place], 1e-300)
        square += (S[0, place] / information) ** 2 - 1.0 / information
    # Seen by the fit, a run is nearer to the common sizes than a new one.
    spread = dict(zip(keys, square / (len(runs) - 1), strict=True))
    more = [key for key in keys if key not in known.keys and spread[key] > 0.0]
    added = np.array([spread[key] for key in more])
    per_run = np.append(per_run + np.maximum([spread[key] for key in known.keys], 0.0), added)
    every = (*known.keys, *more)
    noise = np.array([known.noise[group] for group in runs[0].groups])
    parts = [_Part.of(run, every, limbs) for run in runs]
    beside = _posterior(parts, np.append(common, added), per_run, noise)
    covariance = 0.5 * (beside.covariance + beside.covariance.T) + np.diag(per_run)
    return replace(known, keys=every, mean=beside.mean, covariance=covariance)


def _is_term(key: Key, run: RunSums, limbs: Limbs) -> bool:
    """Whether an effect is an error of the model, and no sum of others."""
    name, target = key
    if name in (EXACT if run.simulated else NO_TERMS) or key in run.zeros or name == ANGLE_ERROR:
        return False
    return target in known_effects()[name].single_targets(limbs)


def model_error_as_dict(known: ModelError) -> dict[str, Any]:
    """A model's error as plain JSON types."""
    lower = [row[: k + 1].tolist() for k, row in enumerate(known.covariance)]
    return {
        "runs": known.runs,
        "terms": [
            {"name": name, "target": target, "mean": mean}
            for (name, target), mean in zip(known.keys, known.mean.tolist(), strict=True)
        ],
        "covariance": lower,
        "noise": [{"channel": c, "kind": k, "level": x} for (c, k), x in known.noise.items()],
        "rates": known.rates,
    }


def model_error_from_dict(said: Mapping[str, Any]) -> ModelError:
    """The model's error from `model_error_as_dict`; KeyError, TypeError or ValueError where it is
    damaged.
    """
    terms = said["terms"]
    covariance = np.zeros((len(terms), len(terms)))
    for k, row in enumerate(said["covariance"]):
        covariance[k, : k + 1] = covariance[: k + 1, k] = row
    np.linalg.cholesky(covariance)
    return ModelError(
        runs=int(said["runs"]),
        keys=tuple((str(one["name"]), str(one["target"])) for one in terms),
        mean=np.array([_finite(one["mean"]) for one in terms]),
        covariance=covariance,
        noise={(str(x["channel"]), str(x["kind"])): _above_zero(x["level"]) for x in said["noise"]},
        rates={str(joint): _finite(x) for joint, x in said["rates"].items()},
    )


def _finite(value: Any) -> float:
    if not np.isfinite(size := float(value)):
        raise ValueError(value)
    return size


def _above_zero(value: Any) -> float:
    if not (level := _finite(value)) > 0.0:
        raise ValueError(value)
    return level
