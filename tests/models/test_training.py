"""Training recovers a velocity that is a known function of the joints, twice the same."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from scipy.spatial.transform import Rotation
from synthetic import Body, synthetic_walk, without

from surefoot.models.observer.data import SHORTEST, validation_rows
from surefoot.models.observer.observer import ObserverError
from surefoot.models.observer.odometry import move_velocity
from surefoot.models.observer.predict import predict, prediction_errors
from surefoot.models.observer.samples import body_velocity, decimate, observer_samples
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train
from surefoot.sim.log import LogError

TINY = TrainSettings(steps=6, batch=2, every=3)


def test_a_known_velocity_is_recovered(mse_observer, walks):
    _, errors = prediction_errors(mse_observer, walks["test"], Body())
    spread = walks["test"].ref_v.std(axis=0)
    assert np.all(np.sqrt((errors**2).mean(axis=0)) < 0.35 * spread)
    assert np.all(mse_observer.rmse < 0.35 * spread)


def test_the_predicted_covariance_is_of_the_size_of_the_errors(gml_observer, walks):
    prediction = predict(gml_observer, walks["test"], Body())
    _, errors = prediction_errors(gml_observer, walks["test"], Body())
    assert prediction.covariance is not None
    nees = np.einsum("mi,mij,mj->m", errors, np.linalg.inv(prediction.covariance), errors)
    assert 1.0 < nees.mean() < 12.0


def test_the_same_seed_gives_the_same_observer(walks):
    first, again, other = (
        train(walks["fit"], Body(), replace(TINY, inputs="q", loss="gml", seed=s))
        for s in (4, 4, 5)
    )
    assert first.hash == again.hash
    assert first.hash != other.hash


@pytest.mark.parametrize("loss", ["mse", "gml"])
def test_ten_seconds_of_another_machine_tune_an_observer(loss, mse_observer, gml_observer, walks):
    """Legs that are a tenth longer, and an encoder that is off: half of the error goes at least."""
    start = {"mse": mse_observer, "gml": gml_observer}[loss]

    def other(log):
        moved = {f"q_{log.joints[0]}": log.q[:, 0] + 0.1}
        moved |= {f"ref_v_{axis}": 1.1 * log.ref_v[:, i] for i, axis in enumerate("xyz")}
        return log.with_columns(moved)

    short = other(synthetic_walk(7, 12, noise=0.1, name="real"))
    tuned = train(short, Body(), TrainSettings(steps=300, every=75), start=start)
    before, after = (
        np.sqrt(np.mean(prediction_errors(one, other(walks["test"]), Body())[1] ** 2))
        for one in (start, tuned)
    )
    assert after < 0.85 * before
    assert (tuned.inputs, tuned.loss, tuned.width) == (start.inputs, start.loss, start.width)
    assert [one.name for one in tuned.logs] == ["fit", "real"]
    # What is stored has the error that is stated.
    _, errors = prediction_errors(tuned, short, Body())
    np.testing.assert_allclose(errors, tuned.errors, atol=1e-5)
    refused("trained on analytic", train, short, Body("other"), TINY, start=start)


def check_same_weights(ours, theirs):
    for name, weight in ours.weights.items():
        assert np.array_equal(weight, theirs.weights[name])


@pytest.mark.parametrize("walk", [None, "calibrate"])
def test_held_out_labels_are_scored_and_not_trained_on(walk, walks):
    """Of blocks of the log, or of another walk: other ones change the score, never a weight."""
    fit = walks["fit"]
    log = walks[walk] if walk else fit
    labels = np.repeat(validation_rows(len(log.t) // 5), 5) if walk is None else np.ones(len(log.t))
    other = log.with_columns({"ref_v_x": log.ref_v[:, 0] + labels})
    plan = replace(TINY, inputs="q", steps=2, every=2)
    ours, theirs = (
        train(iter([fit]), Body(), plan, held_out=[x]) if walk else train(x, Body(), plan)
        for x in (log, other)
    )
    assert theirs.rmse[0] > ours.rmse[0]
    check_same_weights(ours, theirs)
    assert [one.name for one in ours.logs] == ["fit", *([walk] if walk else [])]


def test_filtering_the_last_samples_is_filtering_the_log(walks):
    """A robot in its loop keeps 20 ms of samples, no more."""
    log = walks["test"]
    seen = observer_samples(log, ("q",))
    t, q = log.t, log.q
    for m in (5, 250):
        last = slice(seen.rows[m] - 11, seen.rows[m] + 1)
        assert decimate(t[last], q[last], np.array([11]))[0] == pytest.approx(seen.x[m])


def test_the_state_runs_through_and_knows_no_future(mse_observer, walks):
    log = walks["test"]
    whole = predict(mse_observer, log, Body())
    part = predict(mse_observer, log.rows(slice(0, 10_000)), Body())
    assert np.array_equal(part.v_I, whole.v_I[: len(part.v_I)])


@pytest.mark.parametrize("rate", [400.0, 333.0])
def test_an_observer_serves_logs_of_other_rates(mse_observer, rate):
    log = synthetic_walk(2, 20, rate=rate)
    _, errors = prediction_errors(mse_observer, log, Body())
    assert np.all(np.sqrt((errors[100:] ** 2).mean(axis=0)) < 0.4 * log.ref_v.std(axis=0))


def test_another_mounting_gets_its_own_velocity(mse_observer, walks):
    """The rigid body decides: v at p' is v + omega x (p' - p), in the frame of the new IMU."""
    log = walks["test"]
    R = Rotation.from_euler("xyz", [0.3, -0.2, 1.1]).as_matrix()
    moved = Body(p_BI=np.array([0.1, -0.05, 0.02]), R_BI=R)
    frame = log.frame.copy()
    frame[["gyro_x", "gyro_y", "gyro_z"]] = log.gyro @ R
    ours = predict(mse_observer, log, Body())
    theirs = predict(mse_observer, replace(log, frame=frame), moved)
    for m in (0, 57, 900):
        omega = log.gyro[ours.rows[m]]
        expected = R.T @ (ours.v_I[m] + np.cross(omega, moved.p_BI))
        assert theirs.v_I[m] == pytest.approx(expected, abs=1e-12)
    bare = replace(log, frame=frame.drop(columns=["gyro_x"]))
    refused("gyro", predict, mse_observer, bare, moved, error=ObserverError)


def test_moving_there_and_back_is_staying():
    rng = np.random.default_rng(0)
    a, b = (
        Body(p_BI=rng.normal(size=3), R_BI=Rotation.random(rng=rng).as_matrix()) for _ in range(2)
    )
    v, omega_B = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    P = np.tile(np.diag([1.0, 2.0, 3.0]), (5, 1, 1))
    there, P_there = move_velocity(v, P, omega_B @ b.R_BI, a, b)
    back, P_back = move_velocity(there, P_there, omega_B @ a.R_BI, b, a)
    assert back == pytest.approx(v)
    assert P_back == pytest.approx(P)


def test_labels_without_a_measured_reference_are_left_alone(walks):
    """Even where a whole batch has none; nonsense in rows with ref_ok = 0 changes nothing."""
    log = walks["fit"]
    measured = np.arange(len(log.t)) < 6000
    frame = log.frame.assign(ref_ok=measured.astype(float))
    nonsense = frame.copy()
    nonsense.loc[~measured, "ref_v_x"] = 1e6
    ours, theirs = (
        train(replace(log, frame=f), Body(), replace(TINY, inputs="q", seed=2, batch=1))
        for f in (frame, nonsense)
    )
    assert np.all(np.isfinite(ours.rmse))
    check_same_weights(ours, theirs)


def test_what_cannot_be_trained_on_is_said(walks):
    fit = walks["fit"]
    with pytest.raises(ObserverError, match="10 s at least"):
        train(fit.rows(slice(0, 5 * SHORTEST - 10)), Body(), TINY)
    refused("lacks tau", train, without(fit, "tau_"), Body(), TINY, error=ObserverError)
    refused("reference", train, without(fit, "ref_"), Body(), TINY, error=LogError)
    refused("loss", train, fit, Body(), replace(TINY, loss="l1"), error=ObserverError)
    refused("no log", train, [], Body(), error=ObserverError)
    refused("steps must be", replace, TINY, steps=0)
    refused("rate must be", replace, TINY, rate=float("nan"))
    refused("width must be", train, fit, Body(), replace(TINY, width=0), error=ObserverError)


def test_labels_are_the_velocity_in_the_imus_frame(walks):
    """v_I = R_GI^T v_GI, the rotation by scipy."""
    log, rows = walks["test"], np.array([0, 57, 900, 20_000])
    q = log.frame[[f"ref_q_{axis}" for axis in "xyzw"]].to_numpy()[rows]
    v_I, measured = body_velocity(log, rows)
    assert measured.all()
    assert v_I == pytest.approx(Rotation.from_quat(q).inv().apply(log.ref_v[rows]))


def test_an_error_is_what_is_predicted_less_what_is_true(mse_observer, walks):
    log = walks["test"]
    prediction = predict(mse_observer, log, Body())
    rows, errors = prediction_errors(mse_observer, log, Body())
    assert np.array_equal(rows, prediction.rows)
    true = np.einsum("nji,nj->ni", log.ref_R_GI[rows], log.ref_v[rows])
    assert errors == pytest.approx(prediction.v_I - true)
