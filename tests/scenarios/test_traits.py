"""What estimators say of themselves decides where they are drawn, ranked and compared."""

import re
from pathlib import Path

import pandas as pd
import pytest

from surefoot.scenarios.estimate import bundled
from surefoot.scenarios.estimate.estimators import ESTIMATORS, Traits, traits
from surefoot.scenarios.experiments.file import Condition, Experiment
from surefoot.scenarios.experiments.findings import findings

MODULES = (
    "viewer/recording.py",
    "trace/loop_report.py",
    "trace/filters.py",
    "experiments/findings.py",
    "experiments/report.py",
)


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


@pytest.mark.parametrize("module", MODULES)
def test_no_list_of_filters_is_written_by_hand(module):
    text = (Path(bundled.__file__).parents[1] / module).read_text()
    names = "|".join(ESTIMATORS.bundled)
    compared = re.findall(rf'(?:==|!=|in|startswith)[ (]+(?:"(?:{names})"[, ]*)+', text)
    assert compared == []


def test_findings_rank_an_own_estimator_and_say_why_legs_win(monkeypatch):
    monkeypatch.setitem(ESTIMATORS.bundled, "mine", Mine)
    names = ["coverage", "coverage_persistent", "mine", "imu", "radar_leg"]
    columns = {"condition": "plain", "role": "test", "sequence": "walk", "seed": 0}
    columns |= {"NEES_pos": 3.0, "creep [mm/s]": 1.0, "slip [%]": 1.0, "duration [s]": 10.0}
    rows = pd.DataFrame({"filter": names, "APE_trans [m]": [0.4, 0.3, 0.1, 9.0, 0.01]})
    rows = rows.assign(**columns, **{"APE [% of path]": rows["APE_trans [m]"]})
    rows["fed_mean_x [m/s]"] = float("nan")
    ((_, text),) = findings(rows, Experiment("one", (), conditions=(Condition("plain"),)))
    assert "lowest first: mine 0.100 m" in text
    assert "mine has a lower position error than coverage_persistent on 1 of 1" in text
    assert "creeps by 1.0 mm/s" in text
    assert "radar_leg" not in text
    assert not re.search(r"\bimu\b", text)
