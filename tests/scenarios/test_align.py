"""The command `align`: what is refused leaves nothing behind, both ways to use it are the same."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from pandas.testing import assert_frame_equal
from recorded import POSE, SENSORS, as_named, pasted
from refusals import refused
from scipy.spatial.transform import Rotation
from written import written

from surefoot.scenarios.align import align_file
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.settings import AlignSettings
from surefoot.sim.importing.map_catalog import map_file
from surefoot.sim.importing.recording import import_log
from surefoot.sim.log import Log

MAP = as_named(("t", *SENSORS)) + '[reference]\nfile = "mocap.csv"\np_IM = [0.2, 0.0, 0.0]\n'
MAP += as_named(("t", *POSE), "reference.columns")


def test_what_is_refused_is_one_line_and_leaves_nothing(log, tmp_path):
    log.rows(slice(0, 1000)).write(tmp_path / "seen.parquet")
    line = f"align {tmp_path}/seen.parquet -o {tmp_path}/out"
    message = "seen: IMU and reference share too little to be aligned"
    refused(message, main, line.split(), error=SystemExit)
    assert not (tmp_path / "out").exists()


@pytest.fixture
def recording(log, tmp_path):
    """A recording whose markers are beside the IMU, started later, with a stretch that leaps."""
    log.frame[["t", *SENSORS]].to_csv(tmp_path / "run.csv", index=False)
    mocap = log.frame[["t", *POSE]].iloc[::5].copy()
    q = POSE[3:]
    R_GI = Rotation.from_quat(mocap[q], scalar_first=True)
    mocap[POSE[:3]] += R_GI.apply([0.05, 0.02, 0.11])
    mocap[q] = (R_GI * Rotation.from_euler("z", 20.0, degrees=True)).as_quat(scalar_first=True)
    mocap.loc[mocap.t.between(6.0, 6.05), "ref_p_z"] += 0.4
    mocap["t"] -= 2.5
    mocap.to_csv(tmp_path / "mocap.csv", index=False)
    written(tmp_path / "map.toml", MAP)
    return tmp_path / "run.csv", tmp_path / "map.toml"


def by_both_ways(file, map, folder):
    """The log that `align` writes, and the one that is imported with the lines it prints."""
    _, said = align_file(AlignSettings(file=file, map=str(map), out=folder / "aligned"))
    lines = said[said.index("[reference]") :]
    # The map stays where its files and its robot are looked for.
    written(folder / "pasted.toml", pasted(map_file(map).read_text(), lines))
    return Log.read(folder / "aligned/aligned.parquet"), import_log(file, folder / "pasted.toml")


def test_the_aligned_log_is_the_one_imported_with_the_lines(recording, tmp_path):
    file, rules = recording
    aligned, pasted = by_both_ways(file, rules, tmp_path)
    assert_frame_equal(aligned.frame, pasted.frame, check_exact=True)
    assert aligned.meta.model["reference_offset"] == pasted.meta.model["reference_offset"]
    assert pd.Series(pasted.ref_ok).sum() < len(pasted.t)  # what leaps is in neither


def test_an_aligned_log_keeps_its_name(recording, log, tmp_path):
    file, rules = recording
    aligned, pasted = by_both_ways(file, rules, tmp_path)
    assert aligned.name == pasted.name == "run"
    # So does a log, whose poses are recovered from its rows.
    some = log.rows(slice(0, 4000))
    some.write(tmp_path / "seen.parquet")
    align_file(AlignSettings(file=tmp_path / "seen.parquet", out=tmp_path / "again"))
    again = Log.read(tmp_path / "again/aligned.parquet")
    assert again.name == "seen"
    np.testing.assert_allclose(again.ref_p, some.ref_p[-len(again.t) :], atol=0.02)
    again.write(tmp_path / "renamed.parquet")
    assert Log.read(tmp_path / "renamed.parquet").name == "renamed"
    elsewhere = replace(log, meta=replace(log.meta, model={"log_name": "../../elsewhere"}))
    refused("is no file's name", elsewhere.write, tmp_path / "log.parquet")


def test_what_is_wrong_with_a_log_is_not_said_of_another_of_its_name(log, tmp_path, capsys):
    log = log.rows(slice(0, 2000))
    in_g = log.with_columns({f"accel_{a}": log.frame[f"accel_{a}"] / 9.81 for a in "xyz"})
    for name, one in (("good", log), ("bad", in_g)):
        (tmp_path / name).mkdir()
        one.write(tmp_path / name / "walk.parquet")
    main(["info", "--json", *(f"{tmp_path}/{name}/walk.parquet" for name in ("good", "bad"))])
    said = json.loads(capsys.readouterr().out)
    assert [bool(one["not_plausible"]) for one in said] == [False, True]
