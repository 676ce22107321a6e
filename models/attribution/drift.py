"""Check that an effect does not increase the drift of leg odometry.

An effect may improve one channel and still make the odometry worse.
"""

from collections.abc import Sequence

import numpy as np

from surefoot.models.attribution.evidence import Evidence, LogUnderModel, table_of
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.bootstrap import block_bootstrap_counts
from surefoot.sim.effects import Effect

LEAST_GROWTH = 0.1
"""Least growth of the drift, as a share of the declared model's sum of squares; refitting the other
effects alone changes it by some hundredths.
"""


def adds_drift(
    cases: Sequence[LogUnderModel],
    declared: Evidence,
    evidence: Evidence,
    chosen_with: Sequence[Effect],
    use: np.ndarray,
    floor: NoiseFloor | None = None,
) -> bool:
    """Whether the drift of leg odometry grows from one set of effects to another.

    The drift is the apparent motion of the feet over the ground during stance, summed over blocks
    so that noise averages out. It grows if the sum of its squares does in 95 % of the bootstrap
    draws, by more than the share LEAST_GROWTH of its value with nothing compensated, and by more
    than the drift that simulated walks with these effects show even when they are compensated. It
    is not known where a log gives the feet, which then roll by an unknown way.

    Args:
        cases: the logs under the declared model.
        declared: evidence with nothing compensated.
        evidence: with the effects found so far compensated.
        chosen_with: these effects and the new one, refitted.
        use: mask (M,) of the bins that may be used.
        floor: noise floor with those simulated walks; without it their drift counts as zero.
    """
    feet = evidence.layout.by_leg("stance_displacement")
    if not len(feet) or cases[0].by_feet:
        return False
    after_table = np.concatenate([table_of(case, chosen_with) for case in cases])
    tables = declared.table, evidence.table, after_table
    first, before, after = (_squared_drifts(evidence, x[:, feet], use) for x in tables)
    if not len(before):
        return False
    drawn = block_bootstrap_counts(len(before), np.random.default_rng(0)) @ (after - before)
    least = max(LEAST_GROWTH * float(np.sum(first)), len(before) * _own_drift(floor))
    return bool(np.percentile(drawn, 5.0) > least)


def _own_drift(floor: NoiseFloor | None) -> float:
    """Upper limit [m^2] of the mean squared drift per block on the walks of a noise floor.

    The blocks of one walk drift alike, because its feet creep alike, so the spread is taken between
    walks: the largest value plus the range.
    """
    walks = [walk.evidence for walk in floor.walks] if floor else []
    own = []
    for one in walks:
        moved, every = one.layout.by_leg("stance_displacement"), np.ones(len(one.t), dtype=bool)
        own.append(float(np.sqrt(np.mean(_squared_drifts(one, one.table[:, moved], every)))))
    return (2.0 * max(own) - min(own)) ** 2 if own else 0.0


def _squared_drifts(evidence: Evidence, moved: np.ndarray, use: np.ndarray) -> np.ndarray:
    """Squared horizontal drift (K,) [m^2] of each block.

    `moved` (M, L, 2) is the forward and lateral motion of each foot during stance; the drift is its
    sum over a block, averaged over the feet.
    """
    block = np.floor((evidence.t - evidence.t.min()) / evidence.settings.block).astype(int)
    number = evidence.log * (block.max() + 1) + block
    own = [moved[use & (number == one)] for one in np.unique(number[use])]
    drifts = np.array([np.nansum(x, axis=(0, 1)) / moved.shape[1] for x in own])
    return np.sum(drifts.reshape(-1, 2) ** 2, axis=1)
