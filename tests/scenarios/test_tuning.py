"""The search finds the lowest price within its budget; prices are finite whatever diverges."""

from dataclasses import fields

import numpy as np
import pytest

from surefoot.estimator.metrics import Metrics
from surefoot.scenarios.tune import TuneFilters, tune
from surefoot.scenarios.tuning import PRICE, price_of, search
from surefoot.sim.common.errors import SurefootError


def bowl(values):
    x, y = np.log(values["a"] / 3e-2), np.log(values["b"] / 50.0)
    return x**2 + y**2 + 0.5 * x * y


def test_the_lowest_of_a_bowl_is_found_from_afar():
    found = search(bowl, {"a": 1e-3, "b": 1.0}, 60)
    assert found.best["a"] == pytest.approx(3e-2, rel=0.15)
    assert found.best["b"] == pytest.approx(50.0, rel=0.15)
    assert found.price < 0.02 < found.start_price


def test_the_budget_is_kept_and_no_point_is_paid_for_twice():
    for budget in (1, 2, 7, 30):
        tried: list = []

        def price(values, tried=tried):
            tried.append(tuple(values.items()))
            return bowl(values)

        found = search(price, {"a": 1, "b": 1}, budget)
        assert len(tried) == len(set(tried)) == found.runs == budget
        assert found.price <= found.start_price == bowl({"a": 1, "b": 1})
    with pytest.raises(SurefootError, match="budget"):
        search(bowl, {"a": 1.0}, 0)


def metrics(ape, nees, length=100.0):
    values = dict.fromkeys((f.name for f in fields(Metrics)), 0)
    return Metrics(**values | {"ape_trans": ape, "nees_position": nees, "length": length})


def test_a_price_is_that_of_the_error_and_of_not_knowing_it():
    assert price_of(metrics(1.0, 3.0)) == pytest.approx(np.log(0.01))
    assert price_of(metrics(1.0, 3.0 * np.e)) == pytest.approx(np.log(0.01) + PRICE)
    assert price_of(metrics(1.0, 3.0 / np.e)) == pytest.approx(np.log(0.01) + PRICE)
    worst = price_of(metrics(1e9, 1e9))
    assert price_of(metrics(np.nan, np.inf)) == worst == pytest.approx(PRICE * np.log(1000 / 3))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"seed": 0}, "--seed 0: vision60.toml tests with it"),
        (
            {"conditions": ("as bult",)},
            "--conditions as bult: vision60.toml has as drawn, as built",
        ),
    ],
)
def test_what_cannot_be_tuned_on_is_one_line(tmp_path, options, said):
    with pytest.raises(SurefootError, match=said):
        tune(TuneFilters(out=tmp_path, **options))
