"""Evaluate the effects found on held-out logs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surefoot.models.attribution.evidence import Evidence, LogUnderModel, all_keys, linearise
from surefoot.models.attribution.fit import design
from surefoot.models.attribution.levels import (
    ChannelLevel,
    channel_gains,
    channel_levels,
    without_nuisance,
)
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.attribution.robust_weights import RobustWeights, robust_weights
from surefoot.models.attribution.run_fit import FittedRun, fit_run
from surefoot.models.attribution.sticking import sticks
from surefoot.models.bootstrap import block_bootstrap_counts
from surefoot.sim.effects import Effect


@dataclass(frozen=True)
class HeldOutRuns:
    """Result on held-out logs.

    Attributes:
        channels: residual of each channel over all logs.
        runs: effects of each log's own.
        worsened: a sentence for each effect that makes its own channel worse on a log.
    """

    channels: dict[str, ChannelLevel]
    runs: tuple[FittedRun, ...]
    worsened: tuple[str, ...]


def evaluate_held_out(
    cases: Sequence[LogUnderModel],
    effects: Sequence[Effect],
    start: Sequence[Effect],
    floor: NoiseFloor,
    rng: np.random.Generator,
    declared: Sequence[Effect] = (),
) -> HeldOutRuns:
    """Evaluate effects on held-out logs, fitting only each log's own zeros and biases.

    Where a joint of a fixed base may stick, nothing is evaluated, as on the logs of the fit.

    Args:
        cases: the held-out logs under the declared model.
        effects: found, shared by all runs.
        start: per-run effects found, refitted on each held-out run.
        floor: noise floor of the model with the effects.
        rng: of the block bootstrap.
        declared: effects of the declared model.
    """
    runs, worsened, before, after = [], [], [], []
    known = None
    for number, case in enumerate(cases, 1):
        whole = design(linearise([case], [*effects, *start], all_keys(case)))
        weights = robust_weights(whole, floor.sigma)
        run = fit_run(case, effects, start, floor, weights.weight, weights.sigma)
        runs.append(run)
        plain, known = (linearise([run.case], these, ()) for these in ((), effects))
        every = np.ones(len(known.t), dtype=bool)
        still = sticks([run.case], [*declared, *effects], known.layout)
        for tables, evidence in ((before, plain), (after, known)):
            tables.append(np.where(still, np.nan, without_nuisance(evidence, weights, every)))
        moving = replace(weights, weight=np.where(still, 0.0, weights.weight))
        for one in effects:
            others = linearise([run.case], [e for e in effects if e != one], ())
            if worse := _made_worse(others, known, floor, moving, rng):
                worsened.append(
                    f"held-out run {number}: {one.name} {one.target} makes {worse} worse"
                )
    assert known is not None
    levels = channel_levels(np.concatenate(before), np.concatenate(after), known, floor)
    return HeldOutRuns(levels, tuple(runs), tuple(worsened))


def _made_worse(
    without: Evidence,
    known: Evidence,
    floor: NoiseFloor,
    weights: RobustWeights,
    rng: np.random.Generator,
) -> str:
    """The channel that an effect changes most, if the effect makes it worse; else "".

    Judged by the weighted squared error of blocks, with a 95 % bootstrap interval.

    Args:
        without: evidence with all effects but this one compensated.
        known: with all effects compensated.
        floor: noise floor.
        weights: of the log.
        rng: of the block bootstrap.
    """
    gains = channel_gains(without, known, weights.weight, floor.effective_noise(weights.sigma))
    if not gains:
        return ""
    most = max(gains, key=lambda name: abs(gains[name].sum()))
    high = np.percentile(block_bootstrap_counts(len(gains[most]), rng) @ gains[most], 97.5)
    return most if high < 0 else ""
