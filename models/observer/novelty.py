"""How unlike its training walks an observer finds what it sees: a distance without a reference.

A network's features are what it makes of its inputs. Their means and standard deviations over 3 s,
about six strides, have a normal distribution fitted to the training walks, and the distance from it
is Mahalanobis' (Lee et al., A Simple Unified Framework for Detecting Out-of-Distribution Samples
and Adversarial Attacks, NeurIPS 2018). A walk's is the median over its blocks of 3 s.

The unit is the largest distance of a training walk from the distribution of all others. A further
walk, drawn as these n are, exceeds it with probability 1 / (n + 1).
"""

from collections.abc import Sequence

import numpy as np

BLOCK = 300
"""Length of a block in steps of 10 ms."""
FEWEST_BLOCKS = 5
"""Least number of blocks by which a walk is judged."""
FEWEST_WALKS = 19
"""Least number of training walks: one in 20 further walks is then farther than all of these."""
RIDGE = 1e-3
"""Share of each variance that is added to it; of features that hardly vary, this share of the mean
variance counts, so that one that only a single walk moves does not set the unit alone.
"""

TrainingStates = dict[str, np.ndarray]
"""Normal distribution of blocks (B, 2 F) as `mean` (2 F,), and `whitening` (2 F, 2 F): a block's
distance is |(block - mean) whitening|. Empty where it is not known.
"""


def blocks_of(features: np.ndarray) -> np.ndarray:
    """Means and standard deviations (B, 2 F) of features (T, F) over the whole blocks of a walk."""
    count = len(features) // BLOCK
    whole = features[: count * BLOCK].reshape(count, BLOCK, features.shape[1]).astype(float)
    return np.hstack((whole.mean(axis=1), whole.std(axis=1)))


def training_states(walks: Sequence[np.ndarray]) -> TrainingStates:
    """The distribution of blocks (B, 2 F) of each training walk; empty for too few walks."""
    walks = [blocks for blocks in walks if len(blocks) >= FEWEST_BLOCKS]
    if len(walks) < FEWEST_WALKS:
        return {}
    farthest = 0.0
    for k, blocks in enumerate(walks):
        others = _distribution(walks[:k] + walks[k + 1 :])
        farthest = max(farthest, float(np.median(distances(others, blocks))))
    known = _distribution(walks)
    return known | {"whitening": known["whitening"] / farthest} if farthest else {}


def _distribution(walks: Sequence[np.ndarray]) -> TrainingStates:
    blocks = np.concatenate(walks)
    variance = blocks.var(axis=0)
    ridge = RIDGE * np.maximum(variance, RIDGE * variance.mean()) + np.finfo(float).tiny
    covariance = np.cov(blocks.T) + np.diag(ridge)
    return {
        "mean": blocks.mean(axis=0),
        "whitening": np.linalg.cholesky(np.linalg.inv(covariance)),
    }


def distances(known: TrainingStates, blocks: np.ndarray) -> np.ndarray:
    """Distances (B,) of blocks (B, 2 F)."""
    return np.linalg.norm((blocks - known["mean"]) @ known["whitening"], axis=1)


class Novelty:
    """The distance of a walk that comes in pieces: at each sample, of all whole blocks so far."""

    def __init__(self, known: TrainingStates, features: int):
        """Start as at the beginning of a walk. Raises ValueError for states of another network."""
        shapes = {"mean": (2 * features,), "whitening": (2 * features, 2 * features)}
        if known and {name: np.shape(value) for name, value in known.items()} != shapes:
            raise ValueError(f"training_states: not of {features} features")
        self._known = known
        self._begun = np.zeros((0, features), np.float32)
        self._blocks, self._distance = np.zeros(0), np.nan

    def __call__(self, features: np.ndarray) -> np.ndarray:
        """Distances (T,) at the next samples; NaN before FEWEST_BLOCKS, and if not known."""
        if not self._known:
            return np.full(len(features), np.nan)
        seen = np.concatenate((self._begun, features))
        ended = (len(self._begun) + 1 + np.arange(len(features))) // BLOCK
        values = [self._distance]
        for distance in distances(self._known, blocks_of(seen)) if len(seen) >= BLOCK else ():
            self._blocks = np.append(self._blocks, distance)
            many = len(self._blocks) >= FEWEST_BLOCKS
            values.append(float(np.median(self._blocks)) if many else np.nan)
        self._distance = values[-1]
        self._begun = seen[(len(values) - 1) * BLOCK :]
        return np.array(values)[ended]
