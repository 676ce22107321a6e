"""Noise, priors and the start from a file and from single lines, and exit code 3."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from processes import ended

from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.initial import initial_state, start_covariance
from surefoot.scenarios.estimate.estimators import estimator_named
from surefoot.scenarios.estimate.run import parameters_of
from surefoot.scenarios.estimate.settings import FilterSettings, read_settings
from surefoot.sim.robot import Robot

FILE = """
[noise]
gyro = 1e-3
encoder = 4e-3
[start]
tilt = 0.1
height = 0.5
[state]
b_g = [0.0, 0.0, 0.01]
[filters.leg]
gyro = 2e-3
"""


@pytest.fixture
def settings(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text(FILE)
    return path


def test_parameters(settings):
    robot, found = Robot.load("spot_class"), read_settings(settings, ("noise.gyro=5e-3",))
    leg, imu = (estimator_named(name) for name in ("leg", "imu"))
    assert parameters_of(leg, robot, found)["gyro"] == 2e-3
    assert parameters_of(imu, robot, found)["gyro"] == 5e-3
    assert parameters_of(leg, robot, found)["encoder"] == 4e-3
    assert "encoder" not in parameters_of(imu, robot, found)
    assert parameters_of(leg, robot, FilterSettings()) == parameters_of(leg, robot)


def test_the_start(log, settings):
    state, P = read_settings(settings).beginning(log)
    assert_allclose(state.b_g, [0.0, 0.0, 0.01])
    std = np.sqrt(P.diagonal())
    assert_allclose(std[:2], 0.1)
    assert std[8] >= 0.5 > std[5]
    assert_allclose(std[12:], 5e-3)  # of a bias that is given, not that of having stood still
    plain, (usual, std) = FilterSettings().beginning(log), initial_state(log)
    assert_allclose(plain[0].pack(), usual.pack())
    assert_allclose(plain[1], start_covariance(usual, std))
    turned, _ = read_settings(None, ("state.q_GI=[0, 0, 0, 1]",)).beginning(log)
    assert_allclose(turned.R_GI, np.diag([-1.0, -1.0, 1.0]), atol=1e-12)


def test_a_lost_filter_ends_with_code_3_and_its_trajectory(log, tmp_path, capsys):
    path, out = tmp_path / "short.parquet", tmp_path / "leg.parquet"
    log.write(path)
    wrong = "--set state.b_g=[0.05,0,0] --set start.b_g=1e-4"
    assert ended(f"estimate {path} --filter leg -o {out} {wrong}") == 3
    assert "leg is not to be trusted: " in capsys.readouterr().err
    assert len(Trajectory.read(out).t) > 100
    assert not ended(f"compare {path} -o {tmp_path / 'all'} {wrong}")
    assert "not to be trusted from" in (tmp_path / "all" / "table.md").read_text()
