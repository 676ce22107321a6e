"""A calibration method in a package of a user's own is one like ours: in help, files, tables."""

from own_package import lines_of_script, run_with

USE = """
import numpy as np
from synthetic import Body, synthetic_walk

from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.calibrate import calibrate
from surefoot.models.calibration.settings import CalibrateSettings
from surefoot.models.calibration.empirical_coverage import coverage
from surefoot.models.observer.predict import prediction_errors
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train
from surefoot.models.registry import CALIBRATORS
from surefoot.scenarios.experiments.file import Experiment
from surefoot.scenarios.reporting.calibration_report import CalibratedWalk, methods_table

print(*CALIBRATORS)
fit, log, test = (synthetic_walk(seed, 20, noise=0.1) for seed in range(3))
observer = train(fit, Body(), TrainSettings(inputs="q,dq", steps=10, batch=2, every=10))
bounds = calibrate(observer, log, CalibrateSettings(method="horizontal", K=20), Body())
bounds.save("bounds.json")
loaded = Bounds.load("bounds.json")
assert loaded.method == "horizontal"
assert (loaded.epsilon == bounds.epsilon).all()
assert bounds.epsilon[0] == bounds.epsilon[1]
assert abs(bounds.level_per_axis - 0.9) < 1e-12
rows, errors = prediction_errors(observer, log, Body())
assert coverage(errors, bounds).joint > 0.75
nothing = np.zeros(0)
table = methods_table(
    [CalibratedWalk(log, "calibration", bounds, rows, errors, nothing, nothing, nothing)], []
)
print(*table.method)
print(Experiment.load("grid.toml").learning.method)
"""


def test_an_own_method_is_offered_calibrates_and_is_compared(tmp_path):
    names, table, chosen = lines_of_script("own_calibrator", USE, 'method = "horizontal"', tmp_path)
    every = {"conformal", "outer", "maxnorm", "scenario", "horizontal"}
    assert every <= set(names.split())
    assert every <= set(table.split())
    assert chosen == "horizontal"


def test_the_command_offers_it():
    done = run_with("own_calibrator", "-m", "surefoot", "calibrate", "--help")
    assert "horizontal: " in " ".join(done.stdout.split())
