"""Logs of hours are traced on twenty one-minute blocks, and the report says so."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from pendulum import swung

from surefoot.scenarios.cli.main import main
from surefoot.scenarios.trace import long_logs
from surefoot.scenarios.trace.long_logs import (
    TRACED_BLOCK,
    TRACED_BLOCKS,
    in_blocks,
    read_in_blocks,
)
from surefoot.sim.log import LogError


@pytest.fixture(scope="module")
def log():
    return swung(seed=0, seconds=14.0, armature=0.03)


@pytest.fixture
def three_blocks(monkeypatch):
    """Three blocks of four seconds instead of twenty of a minute."""
    monkeypatch.setattr(long_logs, "TRACED_BLOCKS", 3)
    monkeypatch.setattr(long_logs, "TRACED_BLOCK", 4.0)


def test_a_long_log_is_twenty_minutes_at_most():
    assert TRACED_BLOCKS * TRACED_BLOCK == 20 * 60.0


def test_a_short_log_is_traced_whole(log, tmp_path):
    log.write(tmp_path / "short.parquet")
    assert in_blocks(log) == [log]
    (read,) = read_in_blocks(tmp_path / "short.parquet")
    np.testing.assert_array_equal(read.q, log.q)


@pytest.mark.parametrize("from_file", [True, False])
def test_blocks_are_spread_from_the_first_row_to_the_last(log, three_blocks, tmp_path, from_file):
    log.write(tmp_path / "long.parquet")
    blocks = read_in_blocks(tmp_path / "long.parquet") if from_file else in_blocks(log)
    rows = round(4.0 * log.meta.rate)
    assert [len(block.t) for block in blocks] == [rows] * 3
    middle = round((len(log.t) - rows) / 2)
    for block, first in zip(blocks, (0, middle, len(log.t) - rows), strict=True):
        for name in log.frame:
            np.testing.assert_array_equal(block.frame[name], log.frame[name][first : first + rows])
    assert len({block.name for block in blocks}) == 3


def test_a_fault_between_the_blocks_is_still_one(log, three_blocks, tmp_path):
    log.write(tmp_path / "long.parquet")
    frame = log.frame.copy()
    between = round(4.5 * log.meta.rate)
    frame.loc[between, "t"] = frame["t"][between - 1]
    bad = replace(log, frame=frame)
    with pytest.raises(LogError, match="row"):
        bad.write(tmp_path / "bad.parquet")
    table = pq.read_table(tmp_path / "long.parquet")
    column = table.schema.get_field_index("t")
    table = table.set_column(column, "t", [frame["t"].to_numpy()])
    pq.write_table(table, tmp_path / "bad.parquet")
    with pytest.raises(LogError, match=str(between)):
        read_in_blocks(tmp_path / "bad.parquet")


def test_the_report_says_on_how_much_of_a_log_it_stands(log, three_blocks, tmp_path):
    log.write(tmp_path / "long.parquet")
    main(["trace", str(tmp_path / "long.parquet"), "-o", str(tmp_path / "cli")])
    said = json.loads((tmp_path / "cli" / "trace.json").read_text())
    (note,) = [one for one in said["notes"] if "blocks" in one]
    assert "3 blocks of 4 s each" in note
    assert [e["name"] for e in said["effects"]] == ["armature"]
    assert said["effects"][0]["value"] == pytest.approx(0.03, rel=0.2)
    assert len(said["runs"]) == 3
