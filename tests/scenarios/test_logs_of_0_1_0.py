"""A log and a trajectory that surefoot 0.1.0 wrote load, and lead to the same estimate.

Made by 0.1.0: the last 50 rows of a second's walk of spot_class with a declared gyro bias, and what
its leg filter makes of them.
"""

from pathlib import Path

from numpy.testing import assert_allclose

from surefoot import Log, Robot, run_filter
from surefoot.extend import Trajectory

FILES = Path(__file__).resolve().parents[1] / "data" / "0.1.0"


def test_a_log_is_estimated_as_it_was():
    log, before = Log.read(FILES / "log.parquet"), Trajectory.read(FILES / "trajectory.parquet")
    assert [effect["name"] for effect in log.meta.effects] == ["gyro_bias"]
    now = run_filter("leg", log, Robot.load("spot_class")).trajectory
    assert_allclose(now.t, before.t, rtol=0, atol=0)
    assert_allclose(now.p_GI, before.p_GI, rtol=0, atol=1e-12)
    assert_allclose(now.R_GI, before.R_GI, rtol=0, atol=1e-12)
    assert now.covariance is not None
    assert before.covariance is not None
    assert_allclose(now.covariance, before.covariance, rtol=1e-9, atol=1e-15)
