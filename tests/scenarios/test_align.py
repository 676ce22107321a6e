"""The command `align`: what is refused leaves nothing behind."""

import pytest
from refusals import refused

from surefoot.scenarios.cli.main import main


@pytest.mark.parametrize(
    ("seconds", "options", "message"),
    [
        (2.0, [], "seen: IMU and reference share too little to be aligned"),
        (8.0, ["--robot", "nobody"], "unknown robot 'nobody'"),
    ],
)
def test_what_is_refused_is_one_line_and_leaves_nothing(log, tmp_path, seconds, options, message):
    log.rows(slice(0, round(seconds * log.rate))).write(tmp_path / "seen.parquet")
    line = ["align", f"{tmp_path}/seen.parquet", "-o", f"{tmp_path}/out", *options]
    refused(message, main, line, error=SystemExit)
    assert not (tmp_path / "out").exists()
