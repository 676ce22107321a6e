"""Methods of calibration for comparison alone, beside surefoot's in `make study-bounds`.

They are plug-ins, like a user's own: `surefoot calibrate` offers them where the studies are
installed.
"""

import numpy as np

from surefoot.extend import Calibrator, Conformal, Region, conformal_quantile, mahalanobis


class Bonferroni(Conformal):
    """Each axis at 1 - (1 - gamma)/3."""

    label = "each axis at level 1 - (1 - gamma)/3: joint level gamma or more for any dependence"

    @property
    def level(self) -> float:
        return 1 - (1 - self.gamma) / 3


class Ellipsoid(Calibrator):
    """The Mahalanobis norm about zero."""

    label = (
        "one score for all axes, the Mahalanobis norm: an ellipsoid; filters use the box around it"
    )
    fit_share = 0.25

    def fit(self, errors: np.ndarray) -> None:
        self.shape = errors.T @ errors / len(errors)

    def conformalize(self, errors: np.ndarray) -> None:
        score = mahalanobis(errors, self.shape)
        self.square = conformal_quantile(score[:, None], self.level)[0]

    def bounds(self) -> Region:
        return Region(np.sqrt(self.square * np.diag(self.shape)), self.square * self.shape)
