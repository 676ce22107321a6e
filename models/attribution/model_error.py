"""Error of a machine's model, as runs of the unchanged machine show it.

No model is exact. Its errors appear a little different in every run, and a fit to a single run
attributes them to effects that the machine does not have. In the residual of run r, linear in the C
sizes of the catalogue,

    y_r = X_r (c + u_r) + Z_r z_r + e_r,   c ~ N(0, a^2 D),   u_r ~ N(0, b^2 D)

c is common to all runs, u_r belongs to one, z_r are its zeros and biases, and D scales all terms to
the same residual. a, b and the noise of each group of columns maximise the likelihood of all runs
by expectation maximisation (a mixed model: Laird and Ware, Biometrics 38, 1982).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from surefoot.models.attribution.design import design, nuisance_precision, scaled_inverse
from surefoot.models.attribution.effect_sizes import plausible_size
from surefoot.models.attribution.evidence import (
    Evidence,
    Key,
    LogUnderModel,
    all_keys,
    linearise,
    with_changes,
)
from surefoot.models.attribution.sensor_noise import data_sheet_noise
from surefoot.models.attribution.weights import robust_weights
from surefoot.models.residuals.binning import BIN
from surefoot.models.residuals.jacobians import Regressor
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
"""The same for simulated walks, whose sensors and clocks are as declared."""
ANGLE_ERROR = "angle_error"
"""Name of what a sensor may add to its joint's angle (`angle_errors`)."""
FEWEST_RUNS = 3
"""Runs needed to estimate how they differ."""
LEAST_NOISE = 0.3
"""Share of the noise by data sheets that a bin has at least."""
NOTHING = 1e-9
"""Mean square of the relative residual per unit up to which a size shows in nothing but rounding:
the mass of a link that turns about a vertical axis.
"""
_START = (1.0, 0.02, 0.3)
"""Initial a, b, and noise relative to the residual."""
_ROUNDS = 100
"""Most rounds of the expectation maximisation."""
_NEARLY = 0.02
"""The same for simulated walks, which hardly differ: b is then too large rather than too small."""
_FEWEST = 4
"""Fewest rounds: the noise settles first."""
_AHEAD = 3.0
"""Multiple of the step of b where it converges slowly (over-relaxation)."""
_LEAST = 1e-9
"""Share of a group's squared residual below which what is left is rounding."""
_SETTLED = 3e-3
"""Relative change of a and b in a round at which it has converged."""


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
        per_run: names of the effects that every run has at a size of its own.
        no_terms: names of the effects that are no error of the model.
        least: lower bound of each group's noise (G,), None without.
    """

    keys: tuple[Key, ...]
    groups: tuple[tuple[str, str], ...]
    sums: np.ndarray
    count: np.ndarray
    nuisance: np.ndarray
    rates: dict[str, float]
    per_run: frozenset[str] = PER_RUN
    no_terms: frozenset[str] = NO_TERMS
    least: np.ndarray | None = None

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


@dataclass(frozen=True)
class RunEvidence:
    """Evidence of one run, with the weights of its entries; on a fixed base averaged over windows.

    Attributes:
        case: the run under the declared model.
        known: its evidence.
        weight: (M, W).
        rates: as of `RunSums`.
    """

    case: LogUnderModel
    known: Evidence
    weight: np.ndarray
    rates: dict[str, float]

    def only(self, keys: Sequence[Key]) -> "RunEvidence":
        """The evidence restricted to these candidates."""
        return replace(self, known=self.known.only(keys))


def run_evidence(case: LogUnderModel, effects: Sequence[Effect] = ()) -> RunEvidence:
    """Evidence of one run with `effects` compensated, and all candidates."""
    known, (rates,) = evidence_of([case], effects)
    if case.fixed:
        return RunEvidence(case, known, np.isfinite(known.table).astype(float), rates)
    least = data_sheet_noise(case.log.rate, known.layout)
    return RunEvidence(case, known, robust_weights(design(known), least).weight, rates)


def evidence_of(
    cases: Sequence[LogUnderModel], effects: Sequence[Effect] = ()
) -> tuple[Evidence, list[dict[str, float]]]:
    """Evidence of runs with `effects` compensated and all candidates, on a fixed base averaged over
    windows and with `angle_errors`; and the `rates` of each run (`RunSums`).
    """
    first = cases[0]
    known = linearise(cases, effects, all_keys(first), evaluation_channels=False)
    if not first.fixed:
        return known, [{} for _ in cases]
    if first.log.has("dq") and first.log.has("tau"):
        undriven = first.undriven
        known = with_changes(known, cases, effects, lambda log: angle_errors(log, undriven))
    known = window_averaged(known, windows(known))
    of_rates, rates = known.layout.of("joint_rate"), []
    for run in range(len(cases)):
        table = known.table[known.log == run][:, of_rates]
        apart = np.nanmax(np.abs(table), axis=0, initial=0.0)
        named = zip(of_rates, apart, strict=True)
        rates.append({known.layout.columns[c].group: float(x) for c, x in named})
    return known, rates


def run_sums(
    run: RunEvidence,
    per_run: frozenset[str] = PER_RUN,
    no_terms: frozenset[str] = NO_TERMS,
) -> RunSums:
    """Sums of one run over each group of columns; `per_run` and `no_terms` as of `RunSums`.

    Of a machine on a fixed base these are its torques; of a walk all but the command's.
    """
    known, layout = run.known, run.known.layout
    table = design(known)
    used = layout.of("joint_torque") if run.case.fixed else layout.fitted
    groups, sums, count, kept = [], [], [], []
    sheet = data_sheet_noise(run.case.log.rate, layout)
    for columns in layout.alike:
        own = np.zeros_like(run.weight)
        here = [c for c in columns if c in used]
        own[:, here] = run.weight[:, here]
        if own.any():
            kept.append(here)
            groups.append(layout.kinds[here[0]])
            every = np.zeros(len(own), int)
            sums.append(table.grams(table.y, np.sqrt(own), here, every)[0])
            count.append(np.count_nonzero(own))
    return RunSums(
        keys=known.keys,
        groups=tuple(groups),
        sums=np.array(sums),
        count=np.array(count, float),
        nuisance=nuisance_precision(known),
        rates=run.rates,
        per_run=per_run,
        no_terms=no_terms,
        least=None
        if run.case.fixed
        else np.array([LEAST_NOISE * min(sheet[c] for c in columns) for columns in kept]),
    )


def windows(known: Evidence) -> list[np.ndarray]:
    """Windows (N, M) over the bins of each log (`window_weights`)."""
    return [window_weights(known.t[known.log == i]) for i in range(known.log.max(initial=0) + 1)]


def window_averaged(known: Evidence, weights: Sequence[np.ndarray]) -> Evidence:
    """An evidence whose rows are means over windows (`windows`), of each column over its values."""
    log = known.log
    table = known.table
    mean = [_means(w, table[log == i]) for i, w in enumerate(weights)]

    def of(one: Regressor) -> Regressor:
        parts = [
            np.column_stack(
                [each[c] @ one.values[log == i][:, n] for n, c in enumerate(one.columns)]
            )
            if len(one.columns)
            else np.zeros((len(weights[i]), 0))
            for i, each in enumerate(mean)
        ]
        return Regressor(one.columns, np.concatenate(parts))

    return replace(
        known,
        t=np.concatenate([w @ known.t[log == i] for i, w in enumerate(weights)]),
        log=np.repeat(np.arange(len(weights)), [len(w) for w in weights]),
        table=window_means(weights, log, table),
        X=tuple(of(one) for one in known.X),
        Z=tuple(of(one) for one in known.Z),
    )


def at_middles(known: Evidence) -> Evidence:
    """An evidence with the means over windows (`windows`) in the bins at their middles, and nothing
    in all others.
    """
    mean, place = window_averaged(known, windows(known)), []
    for run in range(known.log.max(initial=0) + 1):
        own = np.flatnonzero(known.log == run)
        place.append(own[np.searchsorted(known.t[own], mean.t[mean.log == run])])
    at = np.concatenate(place)

    def placed(values: np.ndarray, nothing: float) -> np.ndarray:
        out = np.full((len(known.t), values.shape[1]), nothing)
        out[at] = values
        return out

    X, Z = (
        tuple(replace(one, values=placed(one.values, 0.0)) for one in columns)
        for columns in (mean.X, mean.Z)
    )
    return replace(known, table=placed(mean.table, np.nan), X=X, Z=Z)


def window_means(weights: Sequence[np.ndarray], log: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Means of the columns of a table (M, W) over the windows of each log; NaN where a column has
    values for less than half of a window.
    """
    out = []
    for i, w in enumerate(weights):
        own = table[log == i]
        columns = [each @ np.nan_to_num(x) for each, x in zip(_means(w, own), own.T, strict=True)]
        there = np.array([w @ np.isfinite(x) >= 0.5 for x in own.T]).T
        out.append(
            np.where(there.reshape(len(w), -1), np.array(columns).T.reshape(len(w), -1), np.nan)
        )
    return np.concatenate(out)


def _means(weights: np.ndarray, table: np.ndarray) -> list[np.ndarray]:
    """For each column of a table (M, W), weights (N, M) of the mean over its values."""
    out = []
    for column in table.T:
        there = np.isfinite(column)
        own = weights if there.all() else weights * there
        out.append(own if there.all() else own / np.maximum(own.sum(axis=1, keepdims=True), 1e-12))
    return out


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


def angle_errors(log: Log, undriven: Sequence[str]) -> dict[Key, Mapping[str, np.ndarray]]:
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
    """Estimate the error of a model from runs of the unchanged machine; None for too few runs, for
    runs with different readings, and without torques on a fixed base.
    """
    alike = len({(one.keys, one.groups) for one in runs}) == 1
    if len(runs) < FEWEST_RUNS or not alike or not runs[0].groups:
        return None
    keys = runs[0].keys
    sums, count = (np.sum([getattr(r, x) for r in runs], axis=0) for x in ("sums", "count"))
    scale = np.sqrt(sums[:, 0, 0] / count)
    # Mean square of the residual, relative to its own, that one unit of each size makes.
    strength = np.diag(np.tensordot(scale**-2.0, sums, 1))[1 : 1 + len(keys)] / count.sum()
    terms = [
        key
        for key, one in zip(keys, strength, strict=True)
        if _is_term(key, runs[0].no_terms | runs[0].per_run, limbs) and one > NOTHING
    ]
    D = 1.0 / strength[[keys.index(key) for key in terms]]
    simulated = runs[0].no_terms == EXACT
    if simulated:
        # Nothing that a walk of the model seems to lack is larger than what machines lack.
        most = np.array([plausible_size(*key, limbs) / 1.96 for key in terms])
        D = 1.0 / (1.0 / D + most**-2.0)
    parts = [_Part.of(run, terms, limbs) for run in runs]
    a, b, noise = _START[0], _START[1], _START[2] * scale
    before, posterior = np.inf, None
    for round_ in range(_ROUNDS):
        posterior = _posterior(parts, (a, b, noise), D)
        new_a = min(posterior.a, 1.0) if simulated else posterior.a
        step = np.log([new_a / a, posterior.b / b])
        settled = np.abs(step).max() < (_NEARLY if simulated else _SETTLED) and round_ >= _FEWEST
        a = min(posterior.a, 1.0) if simulated else posterior.a
        slow = 0.5 < step[1] / before < 1.5
        b, noise = b * np.exp((_AHEAD if slow else 1.0) * step[1]), posterior.noise
        before = step[1]
        if runs[0].least is not None:
            noise = np.maximum(noise, runs[0].least)
        if settled:
            break
    assert posterior is not None
    covariance = 0.5 * (posterior.covariance + posterior.covariance.T)
    found = ModelError(
        runs=len(runs),
        keys=tuple(terms),
        mean=posterior.mean,
        covariance=covariance + np.diag(b**2 * D),
        noise=dict(zip(runs[0].groups, noise.tolist(), strict=True)),
        rates={joint: max(run.rates[joint] for run in runs) for joint in runs[0].rates},
    )
    return _with_spread(runs, found, limbs)


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
    """Common sizes given a, b and the noise, and the next a, b and noise."""

    mean: np.ndarray
    covariance: np.ndarray
    a: float
    b: float
    noise: np.ndarray


def _posterior(
    runs: Sequence[_Part], known: tuple[float, float, np.ndarray], D: np.ndarray
) -> _Posterior:
    """One round of expectation maximisation from a, b and the noise (G,) in `known`."""
    a, b, noise = known
    C, weak, information = len(D), (b**2 * D) ** -1.0, noise**-2.0
    precision, score, solved = np.diag((a**2 * D) ** -1.0), np.zeros(C), []
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
    between, square, total = 0.0, np.zeros(len(noise)), sum(run.square for run in runs)
    for run, (inverse, right) in zip(runs, solved, strict=True):
        # Sizes of the run given the common ones, and their derivative with respect to these.
        pull = inverse[:, :C] * weak
        sizes, spread = inverse @ right + pull @ mean, inverse + pull @ covariance @ pull.T
        more = pull[:C] - np.eye(C)
        vary = np.diag(inverse)[:C] + np.sum(more @ covariance * more, axis=1)
        between += float(np.sum(((sizes[:C] - mean) ** 2 + vary) / D))
        second = (np.outer(sizes, sizes) + spread).ravel()
        square += run.square - 2.0 * run.right @ sizes + run.gram @ second
    return _Posterior(
        mean=mean,
        covariance=covariance,
        a=float(np.sqrt(np.mean((mean**2 + np.diag(covariance)) / D))),
        b=float(np.sqrt(between / (C * len(runs)))),
        noise=np.sqrt(np.maximum(square, _LEAST * total) / sum(run.count for run in runs)),
    )


def own_places(run: RunSums) -> list[int]:
    """Rows in the sums of what belongs to the run: zeros, biases and other nuisance parameters."""
    zeros = [key for key in run.keys if key[0] in run.per_run]
    first = 1 + len(run.keys)
    return [*run.places(zeros), *range(first, first + len(run.nuisance))]


def own_precision(run: RunSums, limbs: Limbs) -> np.ndarray:
    """Prior precision of each of `own_places`."""
    zeros = [key for key in run.keys if key[0] in run.per_run]
    return np.append([(plausible_size(*key, limbs) / 1.96) ** -2.0 for key in zeros], run.nuisance)


def against_unchanged(run: RunSums, known: ModelError, limbs: Limbs) -> np.ndarray:
    """a' V^-1 b (1 + P, 1 + P) of the residual less its mean and of all candidates, V the
    covariance of a run of the unchanged machine.
    """
    G, first = _about_mean(run, known), 1 + len(run.keys)
    use = [*run.places(known.keys), *own_places(run)]
    inner = G[np.ix_(use, use)] + _unchanged_precision(run, known, limbs)
    cross = G[use, :first]
    return G[:first, :first] - cross.T @ np.linalg.solve(inner, cross)


def _about_mean(run: RunSums, known: ModelError) -> np.ndarray:
    """Whitened Gram matrix of a run whose residual is less the mean error of the model."""
    G = run.whitened(np.array([known.noise[group] for group in run.groups]))
    turned = np.eye(len(G))
    turned[run.places(known.keys), 0] = -known.mean
    return turned.T @ G @ turned


def _unchanged_precision(run: RunSums, known: ModelError, limbs: Limbs) -> np.ndarray:
    """Prior precision of the terms about their mean and of what belongs to the run."""
    own = np.diag(own_precision(run, limbs))
    return np.asarray(block_diag(np.linalg.inv(known.covariance), own))


def _with_spread(runs: Sequence[RunSums], known: ModelError, limbs: Limbs) -> ModelError:
    """The error with the variance by which each effect's apparent size differs between runs beyond
    its error, such as that of a delay, which is no term.
    """
    other = {ANGLE_ERROR, *runs[0].per_run}
    if runs[0].no_terms == EXACT:
        other |= EXACT
    keys = [key for key in runs[0].keys if key[0] not in other]
    place, square = runs[0].places(keys), np.zeros(len(keys))
    for run in runs:
        S = against_unchanged(run, known, limbs)
        information = np.maximum(np.diag(S)[place], 1e-300)
        square += (S[0, place] / information) ** 2 - 1.0 / information
    # Seen by the fit, a run is nearer to the common sizes than a new one.
    spread = dict(zip(keys, square / (len(runs) - 1), strict=True))
    more = [key for key in keys if key not in known.keys and spread[key] > 0.0]
    own = np.maximum([spread[key] for key in known.keys], 0.0)
    added = [spread[key] for key in more]
    return replace(
        known,
        keys=(*known.keys, *more),
        mean=np.append(known.mean, np.zeros(len(more))),
        covariance=block_diag(known.covariance + np.diag(own), np.diag(added)),
    )


def _is_term(key: Key, no_terms: frozenset[str], limbs: Limbs) -> bool:
    name, target = key
    if name in no_terms or name == ANGLE_ERROR:
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
