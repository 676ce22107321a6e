"""Split of each log into blocks that fit, blocks that select, and a final part that reports."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surefoot.models.attribution.evidence import LogUnderModel

FIT, SELECT, REPORT = 0, 1, 2
"""Parts of a split."""


@dataclass(frozen=True)
class Split:
    """Masks (M,) of the bins used to fit, to select and to report."""

    fit: np.ndarray
    select: np.ndarray
    report: np.ndarray

    @property
    def part(self) -> np.ndarray:
        """FIT, SELECT or REPORT for each bin (M,), -1 for none."""
        part = np.full(len(self.fit), -1)
        for number, mask in enumerate((self.fit, self.select, self.report)):
            part[mask] = number
        return part


def split_of(cases: Sequence[LogUnderModel]) -> Split:
    """Split each log: alternating FIT and SELECT blocks, then REPORT at the end."""
    parts = []
    for case in cases:
        s, t = case.settings, case.motion.t - case.motion.t[0]
        begin = (1 - s.report_share) * t[-1]
        length = min(s.split_block, begin / s.fewest_split_blocks)
        gap = s.split_gap * length / s.split_block
        block = np.floor(t / length).astype(int)
        used = (t < begin - gap) & (t - length * block >= gap)
        parts.append((used & (block % 2 == 0), used & (block % 2 == 1), t >= begin))
    return Split(*(np.concatenate(masks) for masks in zip(*parts, strict=True)))
