"""Correlation of the declared model's residual with the candidates, compared with white noise."""

import numpy as np

from surefoot.models.attribution.fit import Design, fit, total_normal_equations
from surefoot.models.attribution.robust_weights import RobustWeights
from surefoot.models.residuals.registry import channels


def variance_inflation(data: Design, weights: RobustWeights) -> np.ndarray:
    """Variance of each column (W,) along the candidates, relative to white noise of the same size.

    `data` is of a walk without any effect, whose residual is noise and contact dynamics. For white
    noise r of standard deviation sigma, the score x'r along a regressor x has the variance sigma^2
    x'x; the result is the mean of (x'r)^2 / (sigma^2 x'x) over the candidates and over similar
    columns, at least one. A residual that persists for a whole swing phase has only a few
    independent values. The effective noise of a column is sigma times the square root of this
    factor.
    """
    sums = total_normal_equations(data, weights.sigma, weights.weight)
    free = fit(sums, (), errors=False).vector[1:]
    left = np.where(data.there, data.y - data.explained(-free), np.nan)
    layout = data.evidence.layout
    known = [name for name in layout.channels if channels()[name].level_spread]
    for columns in layout.alike:
        if known and np.isin(columns, layout.of(*known)).all() and data.there[:, columns].any():
            # The uncertainty of their mean is declared: see `NoiseFloor.size_uncertainty`.
            left[:, columns] -= np.nanmean(left[:, columns])
    left = np.nan_to_num(left)
    candidates = len(data.evidence.X)
    ratios = np.ones(data.evidence.layout.width)
    for columns in data.evidence.layout.alike:
        found: list[float] = []
        for c in columns:
            own = (data.which[c] < candidates) & data.evidence.single[data.which[c]]
            X, rows = data.X[c][:, own], data.rows[c]
            if not X.size:
                continue
            weight = weights.weight[rows, c]
            expected = weights.sigma[c] ** 2 * (weight @ X**2)
            score = (weight * left[rows, c]) @ X
            seen = expected > 1e-12 * max(float(expected.max()), 1e-300)
            found += list(score[seen] ** 2 / expected[seen])
        if found:
            ratios[columns] = max(1.0, float(np.mean(found)))
    return ratios
