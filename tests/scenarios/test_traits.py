"""What estimators say of themselves decides where they are drawn, ranked and compared."""

import pandas as pd

from surefoot.scenarios.estimate.estimators import ESTIMATORS, Traits, traits
from surefoot.scenarios.experiments.file import Condition, Experiment
from surefoot.scenarios.experiments.findings import suite_findings, suite_overview


class Mine:
    of_legs = True


def test_traits_are_the_defaults_where_a_class_says_nothing(monkeypatch):
    assert traits("nobody") == Traits()
    monkeypatch.setitem(ESTIMATORS.bundled, "mine", Mine)
    assert traits("mine") == Traits(of_legs=True)


def test_one_of_each_kind_is_no_variant():
    short = [name for name in ESTIMATORS.bundled if not traits(name).variant]
    assert short == ["coverage", "velocity", "leg", "imu"]
    assert [name for name in ESTIMATORS.bundled if not traits(name).drawn] == ["imu"]


def test_findings_rank_an_own_estimator_and_compare_the_proposed_one(monkeypatch):
    monkeypatch.setitem(ESTIMATORS.bundled, "mine", Mine)
    names = ["coverage", "coverage_persistent", "mine", "imu", "radar_leg"]
    columns = {"condition": "plain", "role": "test", "sequence": "walk", "seed": 0, "robot": "r"}
    columns |= {"coverage_n": 0, "coverage [%]": float("nan"), "fed_mean_x [m/s]": float("nan")}
    rows = pd.DataFrame({"filter": names, "APE_trans [m]": [0.4, 0.3, 0.1, 9.0, 0.01]})
    rows = rows.assign(**columns, NEES_pos=[3.0, 5.9, 6.1, 3.0, 3.0])
    text = suite_findings(rows, Experiment("one", (), conditions=(Condition("plain"),)))
    main, rest = text.split("\n\n")
    assert "`mine` (0.100 m, plain)" in main
    assert "`coverage_persistent`" in rest
    assert "0.300 m (plain; lowest on 0 of 1" in rest
    assert "`coverage`, `coverage_persistent` (plain)" in rest  # within a factor of two of 3
    assert "radar_leg" not in text
    assert "imu" not in text
    shown = suite_overview(rows).set_index("filter")
    assert shown.loc["imu", "APE [m], plain"] == 9.0
    assert list(shown.columns) == ["APE [m], plain", "NEES, plain"]


def test_findings_say_how_often_bounds_hold_and_how_the_observer_errs():
    names = ["coverage", "coverage", "coverage_persistent"]
    rows = pd.DataFrame({"filter": names, "sequence": ["a", "b", "a"], "seed": 0, "robot": "r"})
    rows = rows.assign(condition="plain", role="test", NEES_pos=3.0, **{"APE_trans [m]": 1.0})
    rows["coverage_n"], rows["coverage [%]"] = [10, 30, 0], [100.0, 60.0, float("nan")]
    for axis, size in zip("xyz", (3e-3, 4e-3, 0.0), strict=True):
        rows[f"fed_mean_{axis} [m/s]"] = size
    text = suite_findings(rows, Experiment("one", (), conditions=(Condition("plain"),)))
    assert "70 % (plain)" in text  # (10 * 100 + 30 * 60) / 40
    assert "5.0 mm/s (plain)" in text
