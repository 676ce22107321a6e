"""Variation between runs of an unchanged machine, against which changes are judged.

No model is exact. Its errors appear a little different in every run, and a fit to a single run
attributes them to effects that the machine does not have. After n runs of the unchanged machine, an
effect in a new run is significant only if it exceeds their variation.
"""

from collections.abc import Sequence

import numpy as np

from surefoot.models.attribution.evidence import Evidence, all_keys, linearise
from surefoot.models.attribution.fit import design, fit, total_normal_equations
from surefoot.models.attribution.levels import trimmed_rms
from surefoot.models.attribution.noise_floor import NoiseFloor, RunVariation
from surefoot.models.attribution.robust_weights import RobustWeights
from surefoot.models.attribution.run_fit import FittedRun
from surefoot.sim.effects import Effect

FEWEST_RUNS = 3
"""Runs needed to estimate the variation."""
PRIOR_FREEDOM = 4
"""Prior degrees of freedom, from all candidates, in the variance of one candidate."""


def run_variation(
    runs: Sequence[FittedRun],
    effects: Sequence[Effect],
    floor: NoiseFloor,
    known: Evidence,
    left: np.ndarray,
    weights: RobustWeights,
) -> RunVariation | None:
    """Estimate the variation between runs with `effects` compensated; None for too few runs.

    A candidate's variance is shrunk towards that of all, each in units of its noise (Smyth,
    Statistical Applications in Genetics and Molecular Biology 3, 2004).

    Args:
        runs: each with its own effects compensated.
        effects: shared by the runs.
        floor: noise floor of the model with the effects.
        known: evidence of the runs with the effects.
        left: its residual table (M, W), less the nuisance parameters.
        weights: of its bins.
    """
    if len(runs) < FEWEST_RUNS:
        return None
    count, sigma = len(runs), floor.effective_noise(weights.sigma)
    keys = [k for k in all_keys(runs[0].case) if all(k in all_keys(r.case) for r in runs)]
    size, precision = np.empty((2, count, len(keys)))
    for number, run in enumerate(runs):
        table = design(linearise([run.case], effects, keys))
        sums = total_normal_equations(table, sigma, weights.weight[known.log == number])
        size[number] = [fit(sums, [key], errors=False).sizes[0] for key in keys]
        precision[number] = np.diag(sums.whole)[1 : 1 + len(keys)]
    square, precision = np.mean(size**2, axis=0), precision.mean(axis=0)
    told = precision > 0.0
    typical = np.median((square * precision)[told]) if told.any() else 0.0
    others = typical / np.where(told, precision, np.inf)
    variance = (count * square + PRIOR_FREEDOM * others) / (count - 1 + PRIOR_FREEDOM)
    deviation = np.sqrt(variance * (1.0 + 1.0 / count))
    differ = {k: float(one) for k, one in zip(keys, deviation, strict=True)}
    most = {}
    for name, columns in known.layout.channels.items():
        parts = [left[known.log == number][:, columns] for number in range(count)]
        levels = [trimmed_rms(part) for part in parts if np.isfinite(part).any()]
        if levels:
            most[name] = 2.0 * max(levels) - min(levels)
    return RunVariation(count, differ, most)
