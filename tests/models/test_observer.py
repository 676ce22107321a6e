"""An observer is whole on disk, or an error says in one line what is wrong."""

from dataclasses import replace

import numpy as np
import pytest
from observer_file import observer_contents, write_observer
from synthetic import Body, synthetic_walk, without

from surefoot.models.observer.observer import Observer, ObserverError, check_inputs
from surefoot.models.observer.predict import ObserverStream, predict
from surefoot.models.observer.samples import observer_samples


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 9},
        {"robot": "other"},
        {"p_BI": np.array([0, 0, 1e-9])},
        {"loss": "gml"},
        {"model": "rnn"},
    ],
)
def test_the_hash_is_of_everything(mse_observer, change):
    assert replace(mse_observer, **change).hash != mse_observer.hash


def test_a_field_of_the_wrong_kind_is_refused(mse_observer, tmp_path):
    path = tmp_path / "file.safetensors"
    mse_observer.save(path)
    good = observer_contents(path)
    # A robot without feet has no legs.
    for name in set(good) - {"format", "schema", "hash", "legs"}:
        for bad in (None, np.zeros(2), "x"):
            write_observer(path, good | {name: bad})
            with pytest.raises(ObserverError):
                Observer.load(path)


@pytest.mark.parametrize("inputs", ["", (), "q,torque", "q,dq,tau,q", ("q", "q")])
def test_other_inputs_are_refused(inputs):
    with pytest.raises(ObserverError, match="inputs"):
        check_inputs(inputs)


def test_missing_inputs_are_named_and_never_filled(walks):
    with pytest.raises(ObserverError, match=r"lacks tau \(tau_FL_hip.*reads q,dq,tau"):
        observer_samples(without(walks["test"], "tau_"), ("q", "dq", "tau"))


def test_rates_that_a_log_lacks_are_derived_from_the_angles_alike_in_a_stream(mse_observer, walks):
    log = without(walks["test"], "dq_")
    whole = predict(mse_observer, log, Body())
    stream = ObserverStream(mse_observer, Body(), log.rate, log.joints)
    readings = {name: getattr(log, name) if log.has(name) else None for name in ("q", "dq", "tau")}
    seen = stream.advance(log.t, readings)
    np.testing.assert_array_equal(seen.rows, whole.rows)
    np.testing.assert_allclose(seen.v_I, whole.v_I, atol=1e-4)
    known = predict(mse_observer, walks["test"], Body())
    assert np.sqrt(np.mean((whole.v_I - known.v_I) ** 2)) < 0.3 * known.v_I.std()


def test_another_robot_is_refused(mse_observer, walks):
    with pytest.raises(ObserverError, match=r"trained on analytic.*of other"):
        predict(mse_observer, walks["test"], Body("other"))


def test_derived_velocities_are_causal(mse_observer):
    """A zero-phase derivative in the log looks ahead: it is derived again from the past."""
    log = synthetic_walk(5, duration=12)
    marked = replace(log, meta=replace(log.meta, derived=("dq (zero-phase)",)))
    before = predict(mse_observer, marked, Body()).v_I
    frame = marked.frame.copy()
    later = np.arange(len(frame)) > 3000
    columns = [c for c in frame if c.startswith(("q_", "dq_"))]
    frame.loc[later, columns] += 1.0
    after = predict(mse_observer, replace(marked, frame=frame), Body()).v_I
    assert np.array_equal(before[:601], after[:601])
    assert not np.array_equal(before[601:], after[601:])
