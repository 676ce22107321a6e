"""The conformal quantile of MAPIE, an independent implementation."""

import numpy as np


def mapie_quantile(scores: np.ndarray, level: float) -> float:
    """Of scores (n,)."""
    from mapie.regression import SplitConformalRegressor
    from sklearn.dummy import DummyRegressor

    X = np.zeros((len(scores), 1))
    zero = DummyRegressor(strategy="constant", constant=0.0).fit(X, scores)
    oracle = SplitConformalRegressor(zero, confidence_level=level, prefit=True)
    return oracle.conformalize(X, scores).predict_interval(X[:1])[1][0, 1, 0]
