"""The Monte-Carlo study against the same study one trial at a time in numpy."""

from dataclasses import replace

import numpy as np

from surefoot.scenarios.studies.bench.ratio import Progress, Ratio, in_turn, part_of
from surefoot.scenarios.studies.montecarlo.numpy_reference import numpy_trial
from surefoot.scenarios.studies.montecarlo.settings import BIASED, load_study
from surefoot.scenarios.studies.montecarlo.study import Setting, run_trials
from surefoot.scenarios.studies.montecarlo.trials import make_trials, true_motion

_TRIALS, _DURATION = 40, 4.0


def montecarlo_rows(rounds: int, tell: Progress | None = None) -> list[Ratio]:
    """Four seconds of 40 trials on one core, against one trial in numpy; a line a filter."""
    study = replace(load_study(), duration=_DURATION)
    truth = true_motion(study)
    seeds = np.random.SeedSequence(11).spawn(_TRIALS)
    trials = make_trials(study, truth, BIASED.test, seeds)
    settings = {
        "EKF": Setting("velocity", R=np.diag(study.noise_std**2)),
        "coverage": Setting("coverage", epsilon=1.8 * study.noise_std, gamma=0.8),
    }
    rows = []
    for number, (name, setting) in enumerate(settings.items()):
        batch, one = in_turn(
            lambda setting=setting: run_trials(study, truth, trials, setting),
            lambda setting=setting: numpy_trial(study, truth, trials, 0, setting),
            rounds,
            part_of(tell, number, len(settings)),
        )
        note = (
            f"{1e3 * batch / _TRIALS:.2f} against {1e3 * one:.0f} ms a trial of {_DURATION:.0f} s"
        )
        what = f"Monte-Carlo study, {name}"
        rows.append(Ratio(what, "one trial at a time in numpy", one * _TRIALS / batch, 30.0, note))
    return rows
