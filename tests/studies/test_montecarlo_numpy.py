"""The study's filters against plain numpy ones of textbook formulas, in numbers and in time."""

from dataclasses import replace

import numpy as np
import pytest

from studies.montecarlo.numpy_reference import numpy_moments, numpy_trial
from studies.montecarlo.settings import BIASED, load_study
from studies.montecarlo.study import Setting, run_trials
from studies.montecarlo.trials import make_trials, true_motion
from surefoot.estimator.box import box_moments


@pytest.mark.parametrize("kind", ["gaussian", "coverage"])
def test_the_filters_are_the_textbooks(kind):
    study = replace(load_study(), duration=4.0)
    truth = true_motion(study)
    seeds = np.random.SeedSequence(11).spawn(2)
    trials = make_trials(study, truth, BIASED.test, seeds)
    setting = Setting("velocity", R=np.diag(study.noise_std**2))
    if kind == "coverage":
        setting = Setting("coverage", epsilon=1.5 * study.noise_std, gamma=0.8)
    found = run_trials(study, truth, trials, setting).distance
    for k in range(2):
        plain = numpy_trial(study, truth, trials, k, setting)
        # The integrators differ by what second order leaves of a step: far below a millimetre.
        assert np.abs(found[k] - plain).max() < 5e-4


def test_the_moments_in_numpy_are_those_of_the_filter():
    rng = np.random.default_rng(0)
    for _ in range(20):
        A = np.eye(3) + 0.3 * rng.standard_normal((3, 3))
        cov, centre, half = A @ A.T, rng.uniform(-1, 1, 3), rng.uniform(0.5, 2, 3)
        pi, mean, spread = numpy_moments(cov, centre - half, centre + half)
        log_prob, m, C = box_moments(np.zeros(3), cov, centre - half, centre + half)
        assert abs(np.log(pi) - log_prob) < 1e-8
        assert np.abs(mean - m).max() < 1e-8
        assert np.abs(spread - C).max() < 1e-8
