"""An estimator of a user's own package appears wherever the bundled ones do."""

import pandas as pd
import pytest
from own_package import run_with

LISTS = """
from surefoot.scenarios.estimate.estimators import ESTIMATORS
from surefoot.scenarios.estimate.settings import tuned
from surefoot.scenarios.experiments.file import Experiment
from surefoot.scenarios.reporting.palette import estimator_color, estimator_line
from surefoot.sim.robot import Robot

assert list(ESTIMATORS)[-1] == "standing_feet"
assert "standing_feet" in Experiment("one", ()).filters
mine = ESTIMATORS["standing_feet"]()
assert tuned(Robot.load("v60_class")).of(mine) == {"accel": 0.02, "spread": 0.1}
assert estimator_color("standing_feet").startswith("#")
assert estimator_line("standing_feet") in ("-", "--", "-.", ":")
"""


@pytest.fixture(scope="module")
def file(log, tmp_path_factory):
    path = tmp_path_factory.mktemp("walk") / "walk.parquet"
    log.rows(slice(0, 3500)).write(path)
    return path


def test_it_is_in_every_list():
    done = run_with("own_estimator", "-c", LISTS)
    assert done.returncode == 0, done.stderr


def test_it_is_tabled_and_drawn(file, tmp_path):
    done = run_with(
        "own_estimator", "-m", "surefoot", "compare", str(file), "-o", "out", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "out" / "table.csv")
    assert list(table["filter"]) == ["leg", "leg_slip", "imu", "standing_feet"]
    errors = dict(zip(table["filter"], table["APE_trans [m]"], strict=True))
    assert errors["standing_feet"] < errors["imu"]
    report = (tmp_path / "out" / "report.html").read_text()
    assert "Mean velocity of the standing feet" in report
