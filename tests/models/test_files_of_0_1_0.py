"""Observers and bounds that earlier versions of surefoot wrote load, and say what they said then.

Those of 0.1.0: observers of four units, trained for 60 steps on `synthetic_walk(0, 20, noise=0.1)`,
one of q and dq with a covariance, one of leg odometry; bounds of the first; and what each predicted
at every 50th row of `synthetic_walk(2, 12, noise=0.1)`.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic import Body, synthetic_walk

from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.regions import BoundsError
from surefoot.models.observer.observer import Observer, ObserverError, observer_of_torch
from surefoot.models.observer.predict import predict
from surefoot.scenarios.export import export
from surefoot.sim.common.files import plain_json
from surefoot.sim.robot import Robot

FILES = Path(__file__).resolve().parents[1] / "data" / "0.1.0"


@pytest.fixture(scope="module")
def predicted():
    return np.load(FILES / "predictions.npz")


def test_an_observer_predicts_what_it_did(predicted):
    observer = observer_of_torch(FILES / "observer_q_dq_gml.pt")
    found = predict(observer, synthetic_walk(2, 12, noise=0.1), Body())
    assert found.covariance is not None
    assert found.v_I[::50] == pytest.approx(predicted["gru_qdq_gml_v_I"], abs=1e-6)
    assert found.covariance[::50] == pytest.approx(predicted["gru_qdq_gml_covariance"], rel=1e-5)


def test_an_observer_with_leg_odometry_predicts_what_it_did(predicted):
    observer = observer_of_torch(FILES / "observer_feet_mse.pt")
    log = synthetic_walk(2, 12, noise=0.1, robot="spot_class")
    found = predict(observer, log, Robot.load("spot_class"))
    assert found.v_I[::50] == pytest.approx(predicted["gru_feet_mse_v_I"], abs=1e-6)


def test_extreme_weights_are_named():
    observer = observer_of_torch(FILES / "observer_q_dq_gml.pt")
    extreme = {name: np.full_like(one, 1e30) for name, one in observer.weights.items()}
    with pytest.raises(ObserverError, match="weights") as error:
        predict(replace(observer, weights=extreme), synthetic_walk(2, 12, noise=0.1), Body())
    assert "\n" not in str(error.value)


def test_a_converted_observer_still_has_its_bounds(tmp_path):
    export(FILES / "observer_q_dq_gml.pt", tmp_path / "new.safetensors")
    assert (
        Observer.load(tmp_path / "new.safetensors").hash
        == Bounds.load(FILES / "bounds.json").observer
    )


def test_bounds_say_what_they_said(tmp_path):
    observer = observer_of_torch(FILES / "observer_q_dq_gml.pt")
    bounds = Bounds.load(FILES / "bounds.json")
    assert bounds.observer == observer.hash
    values = json.loads((FILES / "bounds.json").read_text())
    assert bounds.epsilon.tolist() == values["epsilon"]
    assert (bounds.gamma, bounds.K, bounds.n) == (0.8, values["K"], values["n"])
    assert bounds.mixing is not None
    assert bounds.mixing.beta.tolist() == values["mixing"]["beta"]
    part = bounds.persistent_at(np.eye(3))
    for name in ("covariance", "course", "epsilon", "within", "variance"):
        assert getattr(part, name) == pytest.approx(np.array(values["persistent"][name]), rel=1e-12)
    assert part.max_error.tolist() == values["persistent"]["reach"]
    bounds.save(tmp_path / "again.json")
    again = Bounds.load(tmp_path / "again.json")
    assert plain_json(again.persistent_at(np.eye(3))) == plain_json(part)


def test_a_file_with_a_digest_stays_valid(tmp_path):
    values = {
        "format": "surefoot bounds",
        "schema": 2,
        "epsilon": [0.03333333333333333, 1e-07, 125000.0],
        "gamma": 0.8,
        "level_per_axis": 0.9283177667225558,
        "method": "conformal",
        "K": 20,
        "n": 334,
        "observer": "0f" * 32,
        "R_BI": np.eye(3).tolist(),
        "log": "a/\u00fc walk.parquet",
        "mixing": None,
        "confidence": None,
        "persistent": None,
        "warnings": [],
    }
    digest = "7587f2d91efed66c089df27a5c1931ce68f390ab7cca430ebe730ed005381dbe"
    path = tmp_path / "bounds.json"
    path.write_text(json.dumps({"digest": digest} | values))
    assert Bounds.load(path).epsilon.tolist() == values["epsilon"]
    path.write_text(json.dumps({"digest": digest} | values | {"K": 21}))
    with pytest.raises(BoundsError, match="were changed"):
        Bounds.load(path)
