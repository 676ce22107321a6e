"""Check whether an effect makes a channel worse on data that no fit has seen."""

import numpy as np

from surefoot.models.attribution.evidence import Evidence, linearise
from surefoot.models.attribution.levels import channel_levels, without_nuisance
from surefoot.models.attribution.refinement import RefinementData
from surefoot.models.attribution.run_fit import fit_runs
from surefoot.models.attribution.run_offsets import is_per_run
from surefoot.models.attribution.split import REPORT
from surefoot.sim.effects import Effect


def find_harmful_effect(known: RefinementData) -> tuple[Effect, str] | None:
    """The first channel that the effects make worse (`ChannelLevel.worse`), and the effect whose
    removal improves it most; None where there is no such channel.

    Per-run effects are compensated on both sides, at each run's own size.

    Args:
        known: the evidence with all effects compensated, and the matching noise floor.
    """
    weights, unseen = known.robust_weights, known.part == REPORT
    several = known.evidence.settings.per_run_offsets
    own = [e for e in known.explained if several and is_per_run(e.name)]
    shared = [e for e in known.explained if e not in own]
    runs = fit_runs(known, shared, own) if own else ()
    cases = [run.case for run in runs] or known.cases

    def left(evidence: Evidence) -> np.ndarray:
        return without_nuisance(evidence, weights, ~unseen)[unseen]

    before = linearise(cases, (), ())
    after = linearise(cases, shared, ()) if own else known.evidence
    levels = channel_levels(left(before), left(after), after, known.floor)
    worse = next((name for name, level in levels.items() if level.worse), None)
    if worse is None or not shared:
        return None

    def without(one: Effect) -> float:
        others = linearise(cases, [e for e in shared if e != one], ())
        return float(np.nanmean(left(others)[:, before.layout.of(worse)] ** 2))

    return min(shared, key=without), worse
