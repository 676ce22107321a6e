"""Parameters of filters: searched for, written, and read again."""

from dataclasses import fields, replace

import numpy as np
import pytest
from estimates import metrics_of
from refusals import refused

from surefoot import Learnt, Log, Robot
from surefoot.estimator.metrics import Metrics
from surefoot.scenarios import tune
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.estimate.run import ESTIMATORS, estimator_named
from surefoot.scenarios.estimate.settings import BUNDLED_PARAMETERS, read_tuned, tuned
from surefoot.scenarios.settings import TuneSettings
from surefoot.scenarios.tune import PRICE, price_of, search


def bowl(values):
    x, y = np.log(values["a"] / 3e-2), np.log(values["b"] / 50.0)
    return x**2 + y**2 + 0.5 * x * y


def test_the_lowest_of_a_bowl_is_found_from_afar():
    start = {"a": 1e-3, "b": 1.0}
    found = search(bowl, start, 60)
    assert found == pytest.approx({"a": 3e-2, "b": 50.0}, rel=0.15)
    assert bowl(found) < 0.02 < bowl(start)


def test_the_budget_is_kept_and_no_point_is_paid_for_twice():
    for budget in (1, 2, 7, 30):
        tried: list = []

        def price(values, tried=tried):
            tried.append(tuple(values.items()))
            return bowl(values)

        found = search(price, {"a": 1, "b": 1}, budget)
        assert len(tried) == len(set(tried)) == budget
        assert bowl(found) <= bowl({"a": 1, "b": 1})


def metrics(ape, nees, length=100.0):
    values = dict.fromkeys((f.name for f in fields(Metrics)), 0)
    return Metrics(**values | {"ape_trans": ape, "nees_position": nees, "length": length})


def test_a_price_is_that_of_the_error_and_of_not_knowing_it():
    assert price_of(metrics(1.0, 3.0)) == pytest.approx(np.log(0.01))
    assert price_of(metrics(1.0, 3.0 * np.e)) == pytest.approx(np.log(0.01) + PRICE)
    assert price_of(metrics(1.0, 3.0 / np.e)) == pytest.approx(np.log(0.01) + PRICE)
    worst = price_of(metrics(1e9, 1e9))
    assert price_of(metrics(np.nan, np.inf)) == worst == pytest.approx(PRICE * np.log(1000 / 3))


@pytest.fixture(scope="module")
def log(log, tmp_path_factory):
    path = tmp_path_factory.mktemp("tune") / "walk.parquet"
    log.rows(slice(0, 4000)).write(path)
    return path


def test_the_command_tunes_any_filter_and_its_file_is_what_filters_take(log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tune, "stage", lambda pool, label, jobs: ran(jobs))
    seen: list = []

    def ran(jobs):
        seen.append(set(jobs))
        return {key: work(*arguments) for key, (work, *arguments) in jobs.items()}

    main(f"tune {log} --filters leg,leg_slip --budget 4 -o out".split())
    assert seen == [{("spot_class", "leg"), ("spot_class", "leg_slip")}]
    entry = read_tuned(tmp_path / "out" / "tuned.toml")["spot_class"]
    assert set(entry.filters["leg"]) == {"accel", "gyro", "contact"}
    assert entry.reason == "surefoot tune, budget 4, 1 logs"
    assert read_tuned(tmp_path / "out" / "tuned.toml")["default"] == read_tuned()["default"]
    text = (tmp_path / "out" / "tuned.md").read_text()
    row = next(line.split("|") for line in text.splitlines() if "| leg " in line)
    assert float(row[8]) <= float(row[4])
    tried = Log.read(log), Robot.load("spot_class")
    plain = price_of(metrics_of("leg", *tried))
    monkeypatch.setenv("SUREFOOT_TUNED", str(tmp_path / "out" / "tuned.toml"))
    assert price_of(metrics_of("leg", *tried)) < plain


def test_a_search_that_is_done_is_not_run_again(log, tmp_path, monkeypatch):
    out = tmp_path / "out"
    how = TuneSettings(out, filters=("imu",), budget=3)
    first = tune.tune([log], how, Learnt())
    monkeypatch.setattr(tune, "search", lambda *_: pytest.fail("searched again"))
    assert tune.tune([log], replace(how, force=True), Learnt()) == first
    refused("exists already", tune.tune, [log], how, Learnt())


def test_filters_that_the_inputs_do_not_allow_are_left_out_or_one_line(log, tmp_path):
    text = tune.tune([log], TuneSettings(tmp_path / "all", budget=1), Learnt())
    assert "left out for spot_class: coverage (needs observer" in text
    one = TuneSettings(tmp_path / "one", filters=("velocity",), budget=1)
    refused("filter velocity, spot_class: needs observer", tune.tune, [log], one, Learnt())


def test_every_filter_has_its_own_parameters_for_every_robot():
    for robot in ("v60_class", "spot_class", "default"):
        found = read_tuned().get(robot, read_tuned()["default"])
        assert set(found.filters) <= set(ESTIMATORS)
        for name in ESTIMATORS:
            one = estimator_named(name)
            values = found.of(one)
            assert list(values) == [parameter.name for parameter in one.parameters]
            assert all(value > 0 for value in values.values())
            assert all(part.unit and part.meaning for part in one.parameters)
    assert tuned(Robot.load("v60_class")) == read_tuned()["v60_class"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mounting", "mountings", r"\[default\] must have mounting"),
        ("[default]", "[other]", "is missing"),
        ("leg = {", "leg = 3 #", r"\[v60_class\] leg must be a table"),
        ("contact = ", "contact = -", r"contact must be .*> 0"),
        ("leg = { contact", "leg = { contacts", "leg: unknown parameter 'contacts'; known: accel"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path, old, new, said):
    path = tmp_path / "tuned.toml"
    path.write_text(BUNDLED_PARAMETERS.read_text().replace(old, new))
    refused(said, lambda: read_tuned(path)["v60_class"].of(estimator_named("leg")))
