"""Networks and calibration methods in a package of a user's own are like ours: in lists, files,
training, tables and loops."""

import numpy as np
import pytest
from own_package import found
from synthetic import Body, synthetic_walk

from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.calibrate import calibrate
from surefoot.models.calibration.empirical_coverage import coverage
from surefoot.models.calibration.settings import CalibrateSettings
from surefoot.models.observer.observer import Observer, ObserverError
from surefoot.models.observer.predict import predict, prediction_errors
from surefoot.models.observer.samples import observer_samples
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train
from surefoot.models.registry import ARCHITECTURES, CALIBRATORS
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.experiments.file import Experiment
from surefoot.scenarios.experiments.products import learning_choices
from surefoot.scenarios.reporting.calibration_report import CalibratedWalk, methods_table

WALK = 'name = "walk"\nrobot = "spot_class"\n[[segment]]\nduration = 2.0\nforward = 0.5\n'


@pytest.fixture
def learning(tmp_path):
    """The choices of an experiment file with a line in its [observer]."""

    def chosen(line: str):
        (tmp_path / "walk.toml").write_text(WALK)
        (tmp_path / "grid.toml").write_text(f'scenarios = ["walk.toml"]\n[observer]\n{line}\n')
        return Experiment.load(tmp_path / "grid.toml").learning

    return chosen


def test_an_own_network_is_offered_trained_and_run(tmp_path, learning):
    walk, test = (synthetic_walk(seed, 20, noise=0.1) for seed in (0, 1))
    path = tmp_path / "observer.safetensors"
    with found("own_architecture"):
        assert [*ARCHITECTURES] == [*ARCHITECTURES.bundled, "averages"]
        plan = TrainSettings(inputs="q,dq", model="averages", steps=15, batch=2, every=15)
        train(walk, Body(), plan).save(path)
        loaded = Observer.load(path)
        v_I = predict(loaded, test, Body()).v_I
        _, errors = prediction_errors(loaded, test, Body())
        assert np.sqrt((errors**2).mean(axis=0))[0] < test.ref_v.std(axis=0)[0]
        loop, x = loaded.running(), observer_samples(test, loaded.inputs).x
        assert np.allclose([loop(row[None])[0][0] for row in x[:50]], v_I[:50], atol=1e-5)
        assert "averages" in learning_choices(learning('model = "averages"'))["model"]
    with pytest.raises(ObserverError, match=r"unknown model 'averages'; known: gru, mlp"):
        Observer.load(path)


def test_an_own_method_is_offered_calibrates_and_is_compared(tmp_path, learning):
    fit, log = (synthetic_walk(seed, 20, noise=0.1) for seed in range(2))
    observer = train(fit, Body(), TrainSettings(inputs="q,dq", steps=10, batch=2, every=10))
    with found("own_calibrator"):
        every = {"conformal", "outer", "maxnorm", "scenario", "horizontal"}
        assert every <= set(CALIBRATORS)
        bounds = calibrate(observer, log, CalibrateSettings(method="horizontal", K=20), Body())
        bounds.save(tmp_path / "bounds.json")
        loaded = Bounds.load(tmp_path / "bounds.json")
        assert loaded.method == "horizontal"
        assert (loaded.epsilon == bounds.epsilon).all()
        assert bounds.epsilon[0] == bounds.epsilon[1]
        assert bounds.level_per_axis == pytest.approx(0.9)
        rows, errors = prediction_errors(observer, log, Body())
        assert coverage(errors, bounds).joint > 0.75
        walk = CalibratedWalk(log, "calibration", bounds, rows, errors, np.nan)
        assert every <= set(methods_table(bounds, [walk], []).method)
        assert learning('method = "horizontal"').method == "horizontal"


def test_the_command_offers_it(capsys):
    with found("own_calibrator"), pytest.raises(SystemExit):
        main(["calibrate", "--help"])
    assert "horizontal: " in " ".join(capsys.readouterr().out.split())
