"""A calibration method of a user's own: one score for the horizontal axes, one for the vertical."""

import numpy as np

from surefoot.extend import Calibrator, Region, conformal_quantile


class Horizontal(Calibrator):
    label = "a square and a height, each at 1 - (1 - gamma)/2"

    @property
    def level(self):
        return 1 - (1 - self.gamma) / 2

    def conformalize(self, errors):
        sizes = np.abs(errors)
        scores = np.column_stack([sizes[:, :2].max(axis=1), sizes[:, 2]])
        self.side, self.height = conformal_quantile(scores, self.level)

    def bounds(self):
        return Region(np.array([self.side, self.side, self.height]))
