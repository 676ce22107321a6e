"""The command `align`: what is refused leaves nothing behind."""

import pytest

from surefoot.scenarios.cli.main import main
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk


@pytest.mark.parametrize(
    ("seconds", "options", "message"),
    [
        (2.0, [], "seen: IMU and reference share too little to be aligned"),
        (8.0, ["--robot", "nobody"], "unknown robot 'nobody'"),
    ],
)
def test_what_is_refused_is_one_line_and_leaves_nothing(tmp_path, seconds, options, message):
    course = (Segment(4.0, 0.4), Segment(2.0, 0.4, turn=0.5))
    log = walk(Scenario("seen", course, Ground(0.8)), Robot.load("spot_class"), 0)
    log.rows(slice(0, round(seconds * log.rate))).write(tmp_path / "seen.parquet")
    with pytest.raises(SystemExit) as stopped:
        main(["align", f"{tmp_path}/seen.parquet", "-o", f"{tmp_path}/out", *options])
    line = str(stopped.value.code)
    assert message in line
    assert "\n" not in line
    assert not (tmp_path / "out").exists()
