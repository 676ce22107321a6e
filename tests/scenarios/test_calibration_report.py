"""The report of `calibrate`: what it needs, what it writes, and what it says of each walk."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from refusals import refused
from synthetic import without

from studies.bounds import Ellipsoid
from surefoot.models.registry import CALIBRATORS
from surefoot.scenarios.cli.estimate import Calibrate
from surefoot.sim.effects import effect
from surefoot.sim.walk import walk


def calibration(files, out: Path, **options) -> Calibrate:
    return Calibrate(
        observer=files["observer"], sources=(str(files["calibrate"]),), out=out, **options
    )


@pytest.fixture(scope="module")
def files(tmp_path_factory, robot, course, walks, learnt) -> dict[str, Path]:
    """An observer, the walk it learnt, one to calibrate on, one alike, one with a hidden load."""
    folder = tmp_path_factory.mktemp("calibration")
    loaded = walk(course, robot, 2, [effect("payload", "all", 12.0)], declared=False)
    logs = dict(zip(("learnt", "calibrate", "alike"), walks, strict=True)) | {"loaded": loaded}
    logs["bare"] = without(walks[2], "ref_", "slip_", "mu_")
    found = {name: folder / f"{name}.parquet" for name in logs}
    for name, log in logs.items():
        replace(log, name=name).write(found[name])
    found["observer"] = folder / "observer.safetensors"
    learnt.observers[0].save(found["observer"])
    return found


def test_it_says_where_the_bounds_hold(files, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(CALIBRATORS.bundled, "mine", Ellipsoid)
    on = tuple(files[name] for name in ("learnt", "alike", "loaded", "bare"))
    calibration(files, tmp_path / "bounds.json", K=20, report=tmp_path / "report", on=on).run()
    assert "report.html" in capsys.readouterr().out
    page = (tmp_path / "report" / "report.html").read_text()
    assert "http" not in page.replace("http-equiv", "")
    walks = read(tmp_path / "report" / "coverage.csv", "walk")
    roles = [row["role"] for row in walks.values()]
    assert roles == ["calibration", "training", "test", "test", "test"]
    assert walks["alike"]["coverage [%]"] > walks["loaded"]["coverage [%]"] + 5
    assert walks["bare"]["95 % interval"] == "no reference"
    assert np.isnan(walks["bare"]["distance"])  # of an observer of one walk
    assert "Coverage is lost" in page
    methods = read(tmp_path / "report" / "methods.csv", "method")
    volume = {name: row["volume [(cm/s)^3]"] for name, row in methods.items()}
    assert volume["mine"] > 0.0
    cases = read(tmp_path / "report" / "cases.csv", "case").values()
    assert {"terrain", "motion", "slip", "stride"} <= {row["split"] for row in cases}


def read(path: Path, key: str) -> dict[str, dict]:
    return {str(row[key]): row for row in pd.read_csv(path).to_dict("records")}


def test_a_method_short_of_errors_says_how_many_it_needs(files, tmp_path):
    calibration(files, tmp_path / "bounds.json", K=100, report=tmp_path / "r").run()
    methods = read(tmp_path / "r" / "methods.csv", "method")
    assert "needs" in methods["scenario"]["note"]
    assert not (tmp_path / "r" / "cases.csv").exists()


def test_what_cannot_be_is_one_line_before_any_work(files, tmp_path):
    bounds = tmp_path / "bounds.json"
    refused("--report", calibration(files, bounds, on=(files["alike"],)).run)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    refused("not empty", calibration(files, bounds, report=tmp_path / "full").run)
    absent = {"report": tmp_path / "r", "on": (tmp_path / "absent.parquet",)}
    refused("absent", calibration(files, bounds, **absent).run)
    assert not bounds.exists()
    assert not (tmp_path / "r").exists()
