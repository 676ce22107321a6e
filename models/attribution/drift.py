"""Does an effect make the odometry of the legs worse? What a channel gains by it is no proof."""

from collections.abc import Sequence

import numpy as np

from surefoot.models.attribution.evidence import Evidence, LogUnderModel, table_of
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.bootstrap import block_draws
from surefoot.sim.effects import Effect

GROWN = 0.1
"""Share of the declared model's drift, as a sum of squares, by which it must grow: sizes that are
settled again move it by hundredths."""


def adds_drift(
    cases: Sequence[LogUnderModel],
    declared: Evidence,
    evidence: Evidence,
    chosen_with: Sequence[Effect],
    use: np.ndarray,
    floor: NoiseFloor | None = None,
) -> bool:
    """Whether the drift of dead reckoning by the legs grows from one set of effects to another.

    The drift is what the feet seem to move over the ground while they stand, added up over blocks
    in which chance averages out; it grows if the sum of its squares does in 19 of 20 draws of the
    blocks, by a share GROWN of what it was with nothing explained, and by more than a walk may
    drift of a robot that has these effects, for a model that knows of them.

    Args:
        cases: the logs under the declared model.
        declared: with nothing explained.
        evidence: once the effects found so far are explained.
        chosen_with: the same effects and another, sizes settled.
        use: bins (M,) of all logs that may be looked at.
        floor: those walks; without them they have no drift.
    """
    feet = evidence.layout.by_leg("stance_displacement")
    if not len(feet):
        return False
    after_table = np.concatenate([table_of(case, chosen_with) for case in cases])
    tables = declared.table, evidence.table, after_table
    first, before, after = (_squared_drifts(evidence, x[:, feet], use) for x in tables)
    if not len(before):
        return False
    drawn = block_draws(len(before), np.random.default_rng(0)) @ (after - before)
    least = max(GROWN * float(np.sum(first)), len(before) * _own_drift(floor))
    return bool(np.percentile(drawn, 5.0) > least)


def _own_drift(floor: NoiseFloor | None) -> float:
    """The most [m^2] that the drift over a block of a floor's walks is, in the mean square.

    A walk's blocks drift alike, by how feet creep on it, so it is the walks that differ: as far
    again as those walked do.
    """
    walks = [repeat.evidence for repeat in floor.repeats] if floor else []
    own = []
    for one in walks:
        moved, every = one.layout.by_leg("stance_displacement"), np.ones(len(one.t), dtype=bool)
        own.append(float(np.sqrt(np.mean(_squared_drifts(one, one.table[:, moved], every)))))
    return (2.0 * max(own) - min(own)) ** 2 if own else 0.0


def _squared_drifts(evidence: Evidence, moved: np.ndarray, use: np.ndarray) -> np.ndarray:
    """Square (K,) [m^2] of the forward and lateral drift over each block: the mean over the feet of
    what each moves while it stands, (M, L, 2), added up."""
    block = np.floor((evidence.t - evidence.t.min()) / evidence.settings.block).astype(int)
    number = evidence.log * (block.max() + 1) + block
    own = [moved[use & (number == one)] for one in np.unique(number[use])]
    drifts = np.array([np.nansum(x, axis=(0, 1)) / moved.shape[1] for x in own])
    return np.sum(drifts.reshape(-1, 2) ** 2, axis=1)
