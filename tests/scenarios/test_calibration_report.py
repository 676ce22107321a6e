"""The report of `calibrate`: what it needs, what it writes, and what it says of each walk."""

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from studies.bounds import Ellipsoid
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train
from surefoot.models.registry import CALIBRATORS
from surefoot.scenarios.cli.estimate import Calibrate
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Ranges, Scenario, Segment
from surefoot.sim.walk import walk

SEGMENTS = (Segment(8.0, 0.5), Segment(6.0, 0.4, turn=0.5))
COURSE = Scenario("short", SEGMENTS, Ground(0.8), ranges=Ranges(speed=(0.95, 1.05)))


def calibration(files, out: Path, **options) -> Calibrate:
    return Calibrate(observer=files["observer"], logs=(files["calibrate"],), out=out, **options)


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, Path]:
    """An observer, the walk it learnt, one to calibrate on, one alike, one with a hidden load."""
    folder = tmp_path_factory.mktemp("calibration")
    robot = Robot.load("spot_class")
    hidden = [effect("payload", "all", 12.0)]
    logs = {
        "learnt": walk(COURSE, robot, 0),
        "calibrate": walk(COURSE, robot, 1),
        "alike": walk(COURSE, robot, 2),
        "loaded": walk(COURSE, robot, 2, hidden, declared=False),
    }
    found = {}
    for name, log in logs.items():
        found[name] = folder / f"{name}.parquet"
        replace(log, name=name).write(found[name])
    bare = logs["alike"]
    truth = [c for c in bare.frame.columns if c.startswith(("ref_", "slip_", "mu_"))]
    found["bare"] = folder / "bare.parquet"
    Log(bare.frame.drop(columns=truth), bare.meta, "bare").write(found["bare"])
    found["observer"] = folder / "observer.safetensors"
    schedule = TrainSettings(steps=60, batch=4, every=20)
    train(Log.read(found["learnt"]), settings=replace(schedule, seed=0)).save(found["observer"])
    return found


def test_it_says_where_the_bounds_hold(files, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(CALIBRATORS.bundled, "mine", Ellipsoid)
    on = tuple(files[name] for name in ("learnt", "alike", "loaded", "bare"))
    calibration(files, tmp_path / "bounds.json", K=20,
        report=tmp_path / "report", on=on,
    ).run()  # fmt: skip
    assert "report.html" in capsys.readouterr().out
    page = (tmp_path / "report" / "report.html").read_text()
    assert "http" not in page.replace("http-equiv", "")
    walks = read(tmp_path / "report" / "coverage.csv", "walk")
    roles = [row["role"] for row in walks.values()]
    assert roles == ["calibration", "training", "test", "test", "test"]
    assert walks["alike"]["coverage [%]"] > walks["loaded"]["coverage [%]"] + 5
    assert walks["bare"]["95 % interval"] == "no reference"
    assert walks["bare"]["alarm"] == walks["alike"]["alarm"]
    assert "Coverage is lost" in page
    methods = read(tmp_path / "report" / "methods.csv", "method")
    volume = {name: row["volume [(cm/s)^3]"] for name, row in methods.items()}
    assert volume["mine"] < volume["mine, its box"]
    cases = read(tmp_path / "report" / "cases.csv", "case").values()
    assert {"terrain", "motion", "slip", "stride"} <= {row["split"] for row in cases}


def read(path: Path, key: str) -> dict[str, dict]:
    return {str(row[key]): row for row in pd.read_csv(path).to_dict("records")}


def test_a_method_short_of_errors_says_how_many_it_needs(files, tmp_path):
    calibration(files, tmp_path / "bounds.json", K=60, report=tmp_path / "r").run()
    methods = read(tmp_path / "r" / "methods.csv", "method")
    assert "needs" in methods["scenario"]["note"]
    assert not (tmp_path / "r" / "cases.csv").exists()


def test_what_cannot_be_is_one_line_before_any_work(files, tmp_path):
    bounds = tmp_path / "bounds.json"
    with pytest.raises(SurefootError, match="--report"):
        calibration(files, bounds, on=(files["alike"],)).run()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    with pytest.raises(SurefootError, match="not empty"):
        calibration(files, bounds, report=tmp_path / "full").run()
    with pytest.raises(SurefootError, match="absent"):
        calibration(files, bounds, report=tmp_path / "r",
            on=(tmp_path / "absent.parquet",),
        ).run()  # fmt: skip
    assert not bounds.exists()
    assert not (tmp_path / "r").exists()
