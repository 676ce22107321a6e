"""What is not plausible in a log is said by every command that reads it, and kept."""

import json
from dataclasses import replace

import pyarrow.parquet as pq
import pytest
from processes import ended
from recorded import as_recording
from synthetic import resting

from surefoot.scenarios.cli.main import main
from surefoot.sim.log import Log

WORDS = "accel_x, accel_y, accel_z: in g, not m/s^2"


@pytest.fixture
def in_g(tmp_path):
    """A file of an IMU at rest for four seconds that reads g, and its map."""
    log = resting(4.0, 200.0, gravity=1.0)
    as_recording(tmp_path, log)
    log.write(tmp_path / "log.parquet")
    return tmp_path


def test_import_warns_and_the_log_keeps_it(in_g, capsys):
    main(f"import {in_g}/run.csv --map {in_g}/run.toml -o {in_g}/made.parquet".split())
    assert f"warning: run: {WORDS}" in capsys.readouterr().err
    assert any(WORDS in line for line in Log.read(in_g / "made.parquet").meta.warnings)


def test_strict_refuses_with_a_line_each_and_writes_nothing(in_g, capsys):
    line = f"import {in_g}/run.csv --map {in_g}/run.toml -o {in_g}/made.parquet --strict"
    assert "strict: 1 implausible finding in run" in str(ended(line))
    said = capsys.readouterr()
    assert f"error: run: {WORDS}" in said.err
    assert '[columns]\naccel_x = { column = "accel_x", unit = "g" }\n' in said.out
    assert not (in_g / "made.parquet").exists()


def test_info_says_what_a_log_holds_and_what_is_wrong(in_g, capsys):
    main(f"info {in_g}/log.parquet".split())
    said = capsys.readouterr()
    assert "800 samples, 4.0 s at 200 Hz; imu" in said.out
    assert WORDS in said.err
    assert 'unit = "g" in the entry of accel_x, accel_y, accel_z' in said.err


def test_an_estimate_keeps_what_its_log_was_warned_of(in_g):
    log = Log.read(in_g / "log.parquet")
    columns = {f"accel_{a}": 9.81 * log.frame[f"accel_{a}"] for a in "xyz"}
    frame = log.frame.assign(**columns, gyro_y=log.frame["gyro_x"])
    replace(log, frame=frame).write(in_g / "copied.parquet")
    # Whether the filter is to be trusted is another test's.
    ended(f"estimate {in_g}/copied.parquet --filter imu -o {in_g}/out.parquet")
    kept = json.loads(pq.read_schema(in_g / "out.parquet").metadata[b"warnings"])
    assert any("gyro_x, gyro_y: one of two gyro columns was read twice" in line for line in kept)
