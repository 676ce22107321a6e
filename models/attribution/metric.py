"""Products of residuals and candidates under the covariance of a machine without the candidates.

The covariance of the residual of one log is diag(noise^2 / weight) + F C F^T. The columns of F are
the terms of the model's error, what belongs to the log (its zeros, if there are several), and its
nuisance parameters, whose covariance is C. Products a^T V^-1 b follow by the matrix inversion
lemma.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from surefoot.models.attribution.design import Design, design, nuisance_precision, scaled_inverse
from surefoot.models.attribution.effect_sizes import plausible_size
from surefoot.models.attribution.evidence import Evidence, Key, LogUnderModel
from surefoot.models.attribution.model_error import ModelError
from surefoot.models.attribution.weights import RobustWeights, robust_weights
from surefoot.models.bootstrap import BLOCK_SECONDS
from surefoot.models.residuals.channels import commanded_torque
from surefoot.models.residuals.jacobians import Regressor
from surefoot.models.residuals.layout import Layout


@dataclass(frozen=True)
class Metric:
    """Covariance of the residuals of R logs, linearised at the effects found.

    Attributes:
        data: residual and candidates.
        robust: weights and noise.
        root: square root of each entry's weight, divided by its noise (M, W); zero where it is not
            used.
        expected: mean error of the model (M, W), and minus what is compensated of the zeros.
        places: of the columns of F among candidates and nuisance parameters (f,).
        precision: inverse of C (f, f).
        terms: whether a column of F is a term of the model's error or a zero (f,).
    """

    data: Design
    robust: RobustWeights
    root: np.ndarray
    expected: np.ndarray
    places: np.ndarray
    precision: np.ndarray
    terms: np.ndarray

    @property
    def known(self) -> Evidence:
        """The evidence from which the metric is computed."""
        return self.data.evidence

    @cached_property
    def columns(self) -> np.ndarray:
        """The columns of the table with any entry that is used."""
        return np.flatnonzero(self.root.any(axis=0))

    @cached_property
    def entries(self) -> np.ndarray:
        """Number of entries that each candidate shows in, by their weights (C,)."""
        used = np.sum(self.root**2, axis=0) / np.maximum(np.max(self.root**2, axis=0), 1e-300)
        return np.array([used[one.columns].sum() for one in self.known.X], float)

    @cached_property
    def shares(self) -> np.ndarray:
        """Share of each channel in the squared norm of each candidate (C, channels)."""
        square = self.root**2
        energy = np.zeros((len(self.known.X), self.known.layout.width))
        for place, one in enumerate(self.known.X):
            energy[place, one.columns] = np.sum(square[:, one.columns] * one.values**2, axis=0)
        by_channel = self.by_channel(energy)
        return by_channel / np.maximum(by_channel.sum(axis=1, keepdims=True), 1e-300)

    def by_channel(self, of_columns: np.ndarray) -> np.ndarray:
        """Sums (..., channels) of values (..., W) of the columns of each channel."""
        slices = self.known.layout.channels.values()
        return np.stack([of_columns[..., one].sum(axis=-1) for one in slices], axis=-1)

    @cached_property
    def alone(self) -> dict[str, "Metric"]:
        """The metric of each channel by itself, of those with any entry that is used."""
        parts = {}
        for name, columns in self.known.layout.channels.items():
            root = np.zeros_like(self.root)
            root[:, columns] = self.root[:, columns]
            if root.any():
                parts[name] = replace(self, root=root)
        return parts

    def squares(self, table: np.ndarray) -> np.ndarray:
        """Squared residual of each channel (channels,) in units of the noise, of a table (M, W)."""
        y = np.where(self.root > 0.0, np.nan_to_num(table) - self.expected, 0.0)
        return self.by_channel(np.sum((self.root * y) ** 2, axis=0))

    @cached_property
    def grams(self) -> np.ndarray:
        """Products (R, 1 + C + B, 1 + C + B) of residual, candidates and nuisance parameters of
        each log, in units of the noise.
        """
        y = self.data.y - self.expected
        return self.data.grams(y, self.root, self.columns, self.known.log)

    @cached_property
    def S(self) -> np.ndarray:
        """a^T V^-1 b (1 + C, 1 + C) of residual and candidates, over all logs."""
        first, at, total = 1 + len(self.known.keys), 1 + self.places, 0.0
        for G, inverse in zip(self.grams, self._inverses, strict=True):
            cross = G[at, :first]
            total = total + G[:first, :first] - cross.T @ inverse @ cross
        return np.asarray(total)

    @cached_property
    def _inverses(self) -> list[np.ndarray]:
        """Inverse of F^T D^-1 F + C^-1 (f, f) of each log."""
        at = np.ix_(1 + self.places, 1 + self.places)
        return [scaled_inverse(G[at] + self.precision) for G in self.grams]

    def zeros(
        self, keys: Sequence[Key], sizes: np.ndarray | None = None
    ) -> list[list[tuple[float, float]]]:
        """Size and standard deviation of these candidates, which belong to a log, in each log, with
        what of them is compensated, beside effects of given sizes (C,).
        """
        which = [list(self.places).index(self.known.keys.index(key)) for key in keys]
        prior, out = np.diag(self.precision), []
        for fitted, inverse in zip(self._fitted(sizes), self._inverses, strict=True):
            # By the log alone, without the prior, unless that tells more: all clocks together.
            both = 1.0 / np.diag(inverse)
            alone = np.where(both > 2.0 * prior, both - prior, both)
            out.append(
                [(float(fitted[i] * both[i] / alone[i]), float(alone[i] ** -0.5)) for i in which]
            )
        return out

    def belongs_to_log(self, key: Key) -> bool:
        """Whether each log has this candidate at a size of its own."""
        return self.known.keys.index(key) in self.places[~self.terms]

    def left(self, sizes: np.ndarray, terms: bool = True) -> np.ndarray:
        """Residual (M, W) less effects of given sizes (C,), the zeros and nuisance parameters of
        each log, and the model's error unless `terms` is False.
        """
        out = self.data.y - (self.expected if terms else 0.0)
        kept = np.ones(len(self.places), bool) if terms else ~self.terms
        for run, fitted in enumerate(self._fitted(sizes, terms)):
            vector = np.append(sizes, np.zeros(len(self.known.Z)))
            vector[self.places[kept]] += fitted
            own = self.known.log == run
            out[own] -= self.data.explained(vector)[own]
        return out

    def _fitted(self, sizes: np.ndarray | None, terms: bool = True) -> list[np.ndarray]:
        """Sizes of the columns of F in each log, beside effects of given sizes (C,)."""
        kept, out = np.ones(len(self.places), bool) if terms else ~self.terms, []
        at = 1 + self.places[kept]
        for G in self.grams:
            inner = G[np.ix_(at, at)] + self.precision[np.ix_(kept, kept)]
            right = G[at, 0] if sizes is None else G[at, 0] - G[at, 1 : 1 + len(sizes)] @ sizes
            out.append(scaled_inverse(inner) @ right)
        return out

    def products(
        self, table: np.ndarray, X: Sequence[Regressor], without: Collection[Key] | None = ()
    ) -> np.ndarray:
        """a^T V^-1 b (1 + k, 1 + k) of another residual table (M, W) and its regressors.

        An entry that the table lacks counts as noise.

        Args:
            table: as of the evidence.
            X: the k regressors.
            without: candidates that are no terms of the model's error here; None for all terms.
        """
        lost = np.isnan(table) & (self.root > 0.0)
        root = np.where(lost, 0.0, self.root)
        used = np.zeros((1 + len(X), *table.shape))
        used[0] = (np.where(np.isfinite(table), table, 0.0) - self.expected) * root
        for place, one in enumerate(X, 1):
            used[place][:, one.columns] = one.values * root[:, one.columns]
        kept = self._kept(without)
        cross = self.data.products(used * root, self.columns, self.known.log)[:, self.places[kept]]
        total = np.zeros((1 + len(X), 1 + len(X)))
        total[0, 0] = float(np.sum(self.robust.weight[lost]))
        for run, inverse in enumerate(self._inverses_of(kept)):
            flat = used[:, self.known.log == run][:, :, self.columns].reshape(1 + len(X), -1)
            total += flat @ flat.T - cross[run].T @ inverse @ cross[run]
        return total

    def without_blocks(self, keys: Sequence[Key], precision: np.ndarray) -> np.ndarray:
        """Sizes (K, k) of these candidates beside each other, to first order, with one block of the
        logs left out; precision (k,) of their prior.
        """
        blocks = np.column_stack([self.known.log, self.known.t // BLOCK_SECONDS]).astype(int)
        blocks, part = np.unique(blocks, axis=0, return_inverse=True)
        y = self.data.y - self.expected
        parts = self.data.grams(y, self.root, self.columns, part.ravel())
        kept = self._kept(keys)
        F, own = 1 + self.places[kept], self.precision[np.ix_(kept, kept)]
        at = np.append(0, 1 + np.array([self.known.keys.index(key) for key in keys], int))

        def reduced(G: np.ndarray) -> np.ndarray:
            cross = G[np.ix_(F, at)]
            return G[np.ix_(at, at)] - cross.T @ scaled_inverse(G[np.ix_(F, F)] + own) @ cross

        whole = np.array([reduced(G) for G in self.grams])
        total, prior, sizes = whole.sum(axis=0), np.diag(precision), []
        for (run, _), one in zip(blocks, parts, strict=True):
            S = total - whole[run] + reduced(self.grams[run] - one)
            sizes.append(np.linalg.lstsq(S[1:, 1:] + prior, S[1:, 0], rcond=None)[0])
        return np.array(sizes)

    def _kept(self, without: Collection[Key] | None) -> np.ndarray:
        """Which columns of F remain without some candidates (f,); None: without all terms."""
        if without is None:
            return ~self.terms
        return ~np.isin(self.places, [self.known.keys.index(key) for key in without])

    def _inverses_of(self, kept: np.ndarray) -> list[np.ndarray]:
        """As `_inverses`, of these columns of F (f,)."""
        if kept.all():
            return self._inverses
        at = np.ix_(1 + self.places[kept], 1 + self.places[kept])
        return [scaled_inverse(G[at] + self.precision[np.ix_(kept, kept)]) for G in self.grams]


def metric_of(
    cases: Sequence[LogUnderModel],
    known: Evidence,
    error: ModelError,
    use: np.ndarray,
    per_run: Collection[str] = (),
    robust_to_outliers: bool = True,
) -> Metric:
    """The metric of an evidence.

    Args:
        cases: the logs.
        known: evidence with the effects found so far compensated.
        error: of the declared model.
        use: mask (M,) of the bins that are used.
        per_run: names of the effects that every log has at a size of its own.
        robust_to_outliers: whether entries lose weight by what no candidate explains of them.
    """
    data, layout, limbs = design(known), known.layout, cases[0].robot.limbs
    floor = noise_of(error, layout)
    unknown, floor = np.isnan(floor), np.nan_to_num(floor, nan=1e-12)
    own = [i for i, key in enumerate(known.keys) if key[0] in per_run and known.single[i]]
    robust = robust_weights(_with_own(known, own), floor)
    if not robust_to_outliers:
        robust = replace(robust, weight=data.there.astype(float), sigma=floor)
    # What exceeds the floor is no white noise.
    excess = np.maximum(robust.sigma**2 - floor**2, 0.0) * robust.alike
    sigma = np.sqrt(floor**2 + excess)
    weight = robust.weight * use[:, None] * interpolation_weights(cases, known, sigma)
    root = np.zeros_like(weight)
    used = layout.fitted[~unknown[layout.fitted]]
    root[:, used] = np.sqrt(weight[:, used]) / sigma[used]
    shared = [i for i, key in enumerate(error.keys) if key in known.keys]
    terms = [known.keys.index(error.keys[i]) for i in shared]
    free = [i for i, key in enumerate(known.bias_of) if key is None or key[0] not in per_run]
    sizes = np.zeros(data.size)
    sizes[terms] = error.mean[shared]
    expected = data.explained(sizes)
    for run, case in enumerate(cases):
        # A prior is of the whole zero, and a part of it is compensated.
        zeros = np.zeros(data.size)
        zeros[[known.keys.index((e.name, e.target)) for e in case.zeros]] = [
            e.value for e in case.zeros
        ]
        if case.zeros:
            expected[known.log == run] -= data.explained(zeros)[known.log == run]
    within = {i: (plausible_size(*known.keys[i], limbs) / 1.96) ** 2 for i in own}
    covariance = error.covariance[np.ix_(shared, shared)]
    # What a log has of its own adds to what the model's error seems to be of it.
    covariance = covariance + np.diag([within.get(i, 0.0) for i in terms])
    own = [i for i in own if i not in terms]
    return Metric(
        data=data,
        robust=robust,
        root=root,
        expected=expected,
        places=np.array([*terms, *own, *(len(known.keys) + i for i in free)], int),
        precision=np.asarray(
            block_diag(
                scaled_inverse(covariance),
                np.diag([1.0 / within[i] for i in own]),
                np.diag(nuisance_precision(known)[free]),
            )
        ),
        terms=np.arange(len(terms) + len(own) + len(free)) < len(terms),
    )


def _with_own(known: Evidence, own: Sequence[int]) -> Evidence:
    """The same, where these candidates are also nuisance parameters of each log by itself."""
    if not own:
        return known
    more = [
        (
            Regressor(one.columns, one.values * (known.log == log)[:, None]),
            plausible_size(*key, known.layout.limbs) / 1.96,
        )
        for key, one in ((known.keys[i], known.X[i]) for i in own)
        for log in range(known.log.max(initial=0) + 1)
    ]
    return replace(
        known,
        Z=(*known.Z, *(one for one, _ in more)),
        deviations=np.append(known.deviations, [deviation for _, deviation in more]),
        bias_of=(*known.bias_of, *(None,) * len(more)),
    )


def noise_of(error: ModelError, layout: Layout) -> np.ndarray:
    """Noise (W,) of the columns, by a model's error; NaN of those that it is not known of."""
    return np.array([error.noise.get(kind, np.nan) for kind in layout.kinds])


def interpolation_weights(
    cases: Sequence[LogUnderModel], known: Evidence, sigma: np.ndarray
) -> np.ndarray:
    """Weights (M, W) in 0..1 for the interpolation error of streams that are shifted in time.

    Linear interpolation between rows errs by up to an eighth of the second difference, and as much
    again when the shift is undone; at touchdown that is far more than the noise. Compensating a
    delay of the other stream instead causes the error only once, which would bias the choice. The
    second differences come from the IMU's readings, since a reference may have been smoothed, and
    from commanded torques, which are free of noise. Unlike noise, the error differs between
    candidates, so a bin in which it dominates is practically dropped.
    """
    weight, begin = np.ones_like(known.table), 0
    if cases[0].fixed:
        return weight
    imu = known.layout.of("imu_gyro", "imu_accel")
    command = known.layout.of("command")
    for case in cases:
        log, first, count = case.log, case.motion.first, case.motion.count[:, None]
        rows = begin + np.arange(len(first))
        begin += len(first)
        moved = []
        if log.has("imu"):
            moved.append((imu, np.hstack([log.gyro, log.accel])))
        if (asked := commanded_torque(log)) is not None:
            moved.append((command, asked))
        for columns, x in moved:
            if not len(columns):
                continue
            lost = np.zeros_like(x)
            lost[1:-1] = 2 / 8 * (x[2:] - 2.0 * x[1:-1] + x[:-2])
            square = np.add.reduceat(lost**2, first, axis=0) / count**2
            noise = sigma[columns] ** 2
            weight[np.ix_(rows, columns)] = (noise / (noise + square)) ** 2
    return weight
