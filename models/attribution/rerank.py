"""Which of the candidates that come near the best is it? The true residual says.

An IMU that is late looks like a reference that is early in all that the two have in common, which
is by far the loudest. The legs know better: they agree with only one of the two. But they are heard
only where the loud channel does not choose by how streams are moved between their rows.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from surefoot.models.attribution.evidence import Key
from surefoot.models.attribution.fit import NormalEquations, fit, loss
from surefoot.models.attribution.refinement import Data, best_near, refined
from surefoot.models.attribution.selection import Candidate
from surefoot.models.attribution.split import FIT, REPORT, SELECT
from surefoot.sim.effects import Effect, effect

CLOSE_BEHIND = 0.3
"""Share of the best gain from which a candidate might be better than linear regressors say."""
TRIED = 3
"""Candidates that are tried on the true residual in a round."""
HALF = 0.5
"""Share of a gain: with less of it than that left, another candidate explains the same."""
A_SIZE = 2.0
"""How many times its size on walks that lack it one must have that did not earn a place itself."""


def contenders(
    data: NormalEquations, candidates: Sequence[Candidate], chosen: Sequence[Key]
) -> list[Candidate]:
    """The few that might be the best, by gain: of those that earn a place, and of those that
    explain what the first of them does, and more, but are too small to earn one alone."""
    earned = [c for c in candidates if c.earned]
    near = [c for c in earned if c.gain > CLOSE_BEHIND * earned[0].gain]
    near += [c for c in candidates if earned and _outdoes(data, c, earned[0], chosen)]
    return sorted(near, key=lambda c: -c.gain)[:TRIED]


def _outdoes(data: NormalEquations, one: Candidate, best: Candidate, chosen: Sequence[Key]) -> bool:
    """Whether a candidate that did not earn a place gains more than the best that did, and leaves
    little for that one to explain."""
    sized = abs(one.size) > A_SIZE * np.hypot(one.error, one.floor)
    if one.earned or one.at_bound or not sized or one.interval[0] <= best.gain:
        return False
    seen, unseen = data.rows(data.part == FIT), data.rows(data.part == SELECT)
    alone, both = (
        float(loss(unseen, fit(seen, [*chosen, *keys], errors=False).vector).sum())
        for keys in ((one.key,), (one.key, best.key))
    )
    return alone - both < HALF * best.gain


def rerank(data: Data, few: Sequence[Candidate]) -> tuple[Candidate, list[Effect]]:
    """The candidate that leaves least of the true residual, and all effects at their sizes with it.

    For the choice an IMU counts as far as its readings can be told between rows.
    """
    before = list(data.explained)
    tried = [(c, refined(data, [*before, effect(*c.key, c.size)], REPORT)) for c in few]
    if len(tried) == 1:
        return tried[0]
    weight = data.robust_weights.weight * told_between_rows(data)
    fair = replace(data, robust_weights=replace(data.robust_weights, weight=weight))
    return min(tried, key=lambda one: best_near(fair, one[1], REPORT)[1])


def told_between_rows(data: Data) -> np.ndarray:
    """Weights (M, W) in 0..1 against what a stream that was moved in time, and back, has lost.

    A line from row to row errs by up to an eighth of the second difference of what it follows, and
    as much again when the move is undone; at the touch of a foot that is far more than noise. Undo
    the delay of the other stream instead, and it is lost once. The IMU's own readings say how fast
    they change: a reference may have been smoothed before it was written down. The loss is no
    noise, which would be as large for each candidate: where it is larger the bin tells nothing.
    """
    weight, begin = np.ones_like(data.robust_weights.weight), 0
    imu = data.evidence.layout.of("imu_gyro", "imu_accel")
    for case in data.cases:
        first, count = case.frame.first, case.frame.count[:, None]
        rows = begin + np.arange(len(first))
        begin += len(first)
        if case.fixed or not case.log.has("imu"):
            continue
        x = np.hstack([case.log.gyro, case.log.accel])
        lost = np.zeros_like(x)
        lost[1:-1] = 2 / 8 * (x[2:] - 2.0 * x[1:-1] + x[:-2])
        square = np.add.reduceat(lost**2, first, axis=0) / count**2
        noise = data.robust_weights.sigma[imu] ** 2
        weight[np.ix_(rows, imu)] = (noise / (noise + square)) ** 2
    return weight
