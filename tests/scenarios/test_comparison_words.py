"""What a comparison says: who errs least, who is overconfident, what did not run, what is best."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from surefoot.estimator.metrics import Metrics
from surefoot.scenarios.compare import (
    ONE_WALK,
    Comparison,
    _pictures,
    command_line,
    error_summary,
    with_best_marked,
)
from surefoot.scenarios.estimate.run import Result


@pytest.fixture
def metrics() -> Metrics:
    values: Any = {one.name: 1.0 for one in fields(Metrics)}
    return Metrics(**(values | {"nees_position": 3.0}))


def test_the_summary_names_the_least_error_and_who_claims_too_much(metrics):
    bold = replace(metrics, ape_trans=0.5, nees_position=149.0)
    shy = replace(metrics, ape_trans=0.02, nees_position=0.01)
    text = error_summary("yard", {"bold": bold, "even": metrics, "shy": shy})
    assert text.startswith("On yard: shy has the least error, 0.020 m (APE_trans)")
    assert "overconfident (NEES_pos, 3 if consistent): bold (149.00)" in text
    assert "underconfident (NEES_pos, 3 if consistent): shy (0.01)" in text
    assert "even" not in text


def test_a_consistent_filter_stays_within_the_interval_on_19_of_20_walks():
    nees = np.square(np.random.default_rng(0).normal(size=(20000, 3))).sum(axis=1)
    low, high = ONE_WALK
    assert np.mean((nees > low) & (nees < high)) == pytest.approx(0.95, abs=0.005)


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
    marked = with_best_marked(found)
    assert "coverage [%]" not in marked
    assert list(marked["APE_trans [m]"]) == [
        0.2,
        "**0.100**",
        "**0.100**",
        9.0,
    ]  # one alone has none
    assert list(marked["NEES_pos"]) == ["**2.000**", 90.0, 0.1, 1.0]
    found["NEES_pos"] = [0.1, 90.0, 0.1, 1.0]
    assert list(with_best_marked(found)["NEES_pos"]) == [0.1, 90.0, 0.1, 1.0]  # none is right


def test_a_command_is_kept_without_the_folders_of_its_paths():
    given = ["/home/me/.venv/bin/surefoot", "compare", "/home/me/a.parquet", "-o", "out"]
    assert command_line(given) == "surefoot compare a.parquet -o out"
    assert command_line(["/usr/bin/pytest", "-q"]) == ""


def test_the_imu_alone_is_drawn_where_nothing_else_ran(walk):
    """It is kept out of pictures that it would spoil; alone, its chart was empty."""
    health: Any = None
    imu = Result("imu", "arc", walk.trajectories["leg"], None, 0.0, health)
    alone = Comparison(walk.log, walk.robot, (imu,), {}, None, None, {})
    (drawn,) = [p.figure for p in _pictures(alone, None) if "position_error" in p.file]
    assert isinstance(drawn, Figure)
    assert drawn.axes[0].lines
