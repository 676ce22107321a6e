"""The block bootstrap: intervals of sums over blocks that are about independent."""

import numpy as np

BLOCK_SECONDS = 2.0
"""Length of the blocks of a walk's residuals [s]: those of one step correlate with the next step's,
those of blocks of this length hardly.
"""


def block_bootstrap_counts(blocks: int, rng: np.random.Generator, count: int = 1000) -> np.ndarray:
    """How often each of K blocks is in each of `count` samples of the block bootstrap, (count, K).

    Multiplied by the sums of the blocks (K, ...) it gives the sum of each sample.
    """
    return rng.multinomial(blocks, np.full(blocks, 1.0 / blocks), size=count)
