"""What a comparison says: best filters, claims, and traits of a user's own estimators."""

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from surefoot.estimator.metrics import Metrics
from surefoot.models.calibration.empirical_coverage import EmpiricalCoverage
from surefoot.scenarios import compare
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.estimators import ESTIMATORS
from surefoot.scenarios.estimate.run import Result
from surefoot.scenarios.experiments.file import Condition, Experiment
from surefoot.scenarios.experiments.findings import suite_findings, suite_overview
from surefoot.sim.common.errors import SurefootError


@pytest.fixture
def metrics() -> Metrics:
    values: Any = {one.name: 1.0 for one in fields(Metrics)}
    return Metrics(**(values | {"nees_position": 3.0}))


def test_the_summary_names_the_least_error_and_who_claims_too_much(metrics):
    bold = replace(metrics, ape_trans=0.5, nees_position=149.0)
    shy = replace(metrics, ape_trans=0.02, nees_position=0.01)
    text = compare.error_summary("yard", {"bold": bold, "even": metrics, "shy": shy})
    assert text.startswith("On yard: shy has the least error, 0.020 m (APE_trans)")
    assert "overconfident (NEES_pos, 3 if consistent): bold (149.00)" in text
    assert "underconfident (NEES_pos, 3 if consistent): shy (0.01)" in text
    assert "even" not in text


def test_bounds_that_do_not_hold_are_said_to():
    found = EmpiricalCoverage(0.28, np.array([0.09, 0.56]), 12)
    assert "28 (9–56) %" in compare._not_held(found, 0.8)
    for low, high in ((0.09, 0.81), (0.804, 0.9)):  # the second is shown as 80–90
        assert compare._not_held(replace(found, joint_interval=np.array([low, high])), 0.8) == ""


@pytest.mark.parametrize(
    ("losses", "calibrated", "loss", "words"),
    [
        (["mse"], [0], "gml", "one trained with loss gml, with one file of bounds; given: mse"),
        (["mse", "gml"], [0], "gml", "those given belong to another"),
        (["mse", "mse"], [0, 1], None, "one trained with loss mse, .*; given: mse, mse"),
        (["mse"], [0, 0], "mse", "with one file of bounds; given: mse"),
    ],
)
def test_what_a_filter_lacks_of_observers_and_bounds_is_said(losses, calibrated, loss, words):
    observers: Any = [SimpleNamespace(loss=one, hash=str(k)) for k, one in enumerate(losses)]
    bounds: Any = [SimpleNamespace(observer=str(k)) for k in calibrated]
    with pytest.raises(SurefootError, match=words):
        Learnt(tuple(observers), tuple(bounds)).bounded(loss)


def test_the_best_of_each_log_is_marked_and_empty_columns_go():
    found = pd.DataFrame(
        {
            "log": ["one", "one", "one", "two"],
            "filter": ["a", "b", "c", "a"],
            "APE_trans [m]": [0.2, 0.1, 0.10001, 9.0],
            "NEES_pos": [2.0, 90.0, 0.1, 1.0],
            "coverage [%]": [None] * 4,
        }
    )
    marked = compare.with_best_marked(found)
    assert "coverage [%]" not in marked
    best = "**0.100**"
    assert list(marked["APE_trans [m]"]) == [0.2, best, best, 9.0]  # one alone has none
    assert list(marked["NEES_pos"]) == list(found["NEES_pos"])


def test_the_imu_alone_is_drawn_where_nothing_else_ran(walk):
    """It is kept out of pictures that it would spoil; alone, its chart was empty."""
    health: Any = None
    imu = Result("imu", "arc", walk.trajectories["leg"], None, 0.0, health)
    alone = compare.Comparison(walk.log, walk.robot, (imu,), {}, None, None, {})
    (drawn,) = [p.figure for p in compare._pictures(alone) if "position_error" in p.file]
    assert isinstance(drawn, Figure)
    assert drawn.axes[0].lines


class Mine:
    of_legs = True


def test_findings_rank_an_own_estimator_and_compare_the_proposed_one(monkeypatch):
    monkeypatch.setitem(ESTIMATORS.bundled, "mine", Mine)
    names = ["coverage", "coverage_persistent", "mine", "imu", "radar_leg"]
    columns = {"condition": "plain", "role": "test", "sequence": "walk", "seed": 0, "robot": "r"}
    columns |= {compare.LOST_FROM: [None, 12.0, None, None, None]}
    columns |= {"coverage_n": 0, "coverage [%]": float("nan"), "fed_mean_x [m/s]": float("nan")}
    rows = pd.DataFrame({"filter": names, "APE_trans [m]": [0.4, 0.3, 0.1, 9.0, 0.01]})
    rows = rows.assign(**columns, NEES_pos=[3.0, 5.9, 6.1, 3.0, 3.0])
    text = suite_findings(rows, Experiment("one", (), conditions=(Condition("plain"),)))
    main, rest = text.split("\n\n")
    assert "`mine` (0.100 m, plain)" in main
    assert "`coverage_persistent`" in rest
    assert "0.300 m (plain; lowest on 0 of 1" in rest
    assert "not to be trusted on 1 of 1 (plain)" in rest
    assert "`coverage`, `coverage_persistent` (plain)" in rest  # within a factor of two of 3
    assert "radar_leg" not in text
    assert "imu" not in text
    shown = suite_overview(rows).set_index("filter")
    assert list(shown.columns) == ["APE [m] (NEES), plain"]
    assert shown.loc["imu", "APE [m] (NEES), plain"] == "9.000 (3.000)"
