"""Sizes on the true residual, which hardly any effect changes in a straight line."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surefoot.models.attribution.evidence import Evidence, Key, LogUnderModel, linearise
from surefoot.models.attribution.fit import NormalEquations, design, fit, loss, normal_equations
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.attribution.robust_weights import RobustWeights
from surefoot.sim.effects import Effect

AT_MOST = 10
"""Steps of Gauss-Newton: a derivative that noise enters falls short of the size at each."""
CLOSE = 1e-3
"""Share of its size by which an effect may still move when it is taken for settled."""


@dataclass(frozen=True)
class Data:
    """What sizes are refined on: the evidence once `explained` are; part (M,) of each bin, as in
    `Split.part`."""

    cases: Sequence[LogUnderModel]
    floor: NoiseFloor
    evidence: Evidence
    explained: Sequence[Effect]
    robust_weights: RobustWeights
    part: np.ndarray

    def about(self, chosen: Sequence[Effect]) -> NormalEquations:
        """Sums of products of the residual once `chosen` are explained, varied about them."""
        keys = [(e.name, e.target) for e in chosen]
        evidence = self.evidence.only(keys)
        if list(chosen) != list(self.explained):
            evidence = linearise(self.cases, chosen, keys, evidence)
        sigma = self.floor.counted(self.robust_weights.sigma)
        return normal_equations(design(evidence), sigma, self.robust_weights.weight, self.part)


def refined(data: Data, chosen: Sequence[Effect], report: int) -> list[Effect]:
    """The effects at the sizes that leave least on all blocks but those of the part `report`, by
    Gauss-Newton."""
    chosen = [clipped(e, e.value) for e in chosen]
    offsets = _offsets(data.floor, [(e.name, e.target) for e in chosen])
    for _ in range(AT_MOST):
        steps = best_near(data, chosen, report)[0] - offsets
        moved = [clipped(e, e.value + d) for e, d in zip(chosen, steps, strict=True)]
        pairs = zip(moved, chosen, strict=True)
        settled = all(abs(a.value - b.value) < CLOSE * abs(a.value) for a, b in pairs)
        chosen = moved
        if settled:
            break
    return chosen


def best_near(data: Data, chosen: Sequence[Effect], report: int) -> tuple[np.ndarray, float]:
    """By how much (C,) the effects' sizes miss the best, in a straight line, and the weighted
    squared error that is left there, on all blocks but those of the part `report`."""
    sums = data.about(chosen)
    sums = sums.rows(sums.part != report)
    found = fit(sums, [(e.name, e.target) for e in chosen], errors=False)
    return found.sizes, float(loss(sums, found.vector).sum())


def _offsets(floor: NoiseFloor, keys: Sequence[Key]) -> np.ndarray:
    """Sizes (C,) that these keys, fitted together, have on walks that lack them."""
    return np.array([floor.sizes([k for k in keys if k != key], key)[0] for key in keys])


def clipped(one: Effect, value: float) -> Effect:
    """The effect of this size, or of the nearest inside its bounds."""
    return replace(one, value=float(np.clip(value, *type(one).inside(one.target))))
