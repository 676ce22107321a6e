"""Split of each log into blocks that effects are fitted on, and blocks that only report."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surefoot.models.attribution.evidence import LogUnderModel


@dataclass(frozen=True)
class Split:
    """Masks (M,) of the bins used to fit and to report."""

    fit: np.ndarray
    report: np.ndarray


def split_of(cases: Sequence[LogUnderModel]) -> Split:
    """Split each log: every third block reports, so that both parts have all that a robot does."""
    fits, reports = [], []
    for case in cases:
        s, t = case.settings, case.motion.t - case.motion.t[0]
        length = min(s.split_block, t[-1] / s.fewest_split_blocks) if len(t) > 1 else s.split_block
        block, gap = np.floor(t / length).astype(int), s.split_gap * length / s.split_block
        inside = t - length * block >= gap
        fits.append((block % 3 != 2) & inside)
        reports.append((block % 3 == 2) & inside)
    return Split(np.concatenate(fits), np.concatenate(reports))
