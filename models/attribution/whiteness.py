"""How far a residual of the declared model is from white noise, as the candidates see it."""

import numpy as np

from surefoot.models.attribution.fit import Design, fit, normal_equations
from surefoot.models.attribution.robust_weights import RobustWeights
from surefoot.models.residuals.registry import channels


def variance_inflation(data: Design, weights: RobustWeights) -> np.ndarray:
    """How much more (W,) than white noise of its own size each column has along the candidates.

    data: of a walk that lacks every effect, so that what is left is noise and what contacts fake.
    Along a regressor x the score x'r of white noise r of size sigma has the variance sigma^2 x'x:
    the mean ratio of its square to that, over the candidates and over columns that are alike. A
    residual that goes on for a whole swing is worth only its few independent values: the
    noise that a column counts with is sigma times the root of this.
    """
    sums = normal_equations(data, weights.sigma, weights.weight).total()
    free = fit(sums, (), errors=False).vector[1:]
    left = np.where(data.there, data.y - data.explained(-free), np.nan)
    layout = data.evidence.layout
    known = [name for name in layout.channels if channels()[name].known_to]
    for columns in layout.alike:
        if known and np.isin(columns, layout.of(*known)).all() and data.there[:, columns].any():
            # How well their mean is known is said, and counts as a doubt of sizes.
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
