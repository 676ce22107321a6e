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
        block = min(s.split_block, t[-1] / s.fewest_split_blocks)
        if case.fixed:
            # Long enough for some windows over which torques are averaged.
            block = min(max(block, s.shortest_fixed_block), t[-1] / 3.0)
        block = max(block, 1e-9)
        phase, gap = np.mod(t, 3.0 * block), s.split_gap * block / s.split_block
        fits.append((phase >= gap) & (phase < 2.0 * block))
        reports.append(phase >= 2.0 * block + gap)
    return Split(np.concatenate(fits), np.concatenate(reports))
