"""Does an effect make the odometry of the legs worse? What a channel gains by it is no proof."""

from collections.abc import Sequence

import numpy as np

from surefoot.models.attribution.evidence import LogUnderModel, table_of
from surefoot.models.bootstrap import block_draws
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.effects import Effect

GROWN = 0.05
"""Share of the sum of its squares by which a drift must grow: sizes that are settled again move it
by hundredths."""


def adds_drift(
    cases: Sequence[LogUnderModel],
    chosen: Sequence[Effect],
    chosen_with: Sequence[Effect],
    use: np.ndarray,
) -> bool:
    """Whether the drift of dead reckoning by the legs grows from one set of effects to another.

    The drift is what the feet seem to move over the ground while they stand, added up over blocks
    in which chance averages out; it grows if the sum of its squares does by GROWN in 19 of 20 draws
    of the blocks.

    Args:
        cases: the logs under the declared model.
        chosen: effects found so far.
        chosen_with: the same and another, sizes settled.
        use: bins (M,) of all logs that may be looked at.
    """
    before, after = (_drifts(cases, these, use) for these in (chosen, chosen_with))
    if not len(before):
        return False
    grown = np.sum(after**2, axis=1) - np.sum(before**2, axis=1)
    drawn = block_draws(len(grown), np.random.default_rng(0)) @ grown
    return bool(np.percentile(drawn, 5.0) > GROWN * np.sum(before**2))


def _drifts(
    cases: Sequence[LogUnderModel], chosen: Sequence[Effect], use: np.ndarray
) -> np.ndarray:
    """Forward and lateral drift (K, 2) [m] over each block: the mean over the feet of what each
    moves while it stands, added up."""
    layout = layout_for(cases[0].robot.limbs)
    feet = layout.by_leg("stance_displacement")
    if not len(feet):
        return np.zeros((0, 2))
    sums, begin = [], 0
    for case in cases:
        own = use[begin : begin + len(case.frame.t)]
        begin += len(own)
        moved = np.where(own[:, None, None], table_of(case, chosen)[:, feet], np.nan)
        block = np.floor((case.frame.t - case.frame.t[0]) / case.settings.block).astype(int)
        for one in np.unique(block[own]):
            here = moved[own & (block == one)]
            if np.isfinite(here).any():
                sums.append(np.nansum(here, axis=(0, 1)) / len(feet))
    return np.array(sums).reshape(-1, 2)
