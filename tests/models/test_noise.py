"""Allan deviation: known noise is recovered with honest intervals, and becomes settings."""

import numpy as np
import pandas as pd
import pytest
from refusals import refused

from surefoot.models.noise import allan_curve, axis_noise, rest_noise, rest_of
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.estimate.settings import read_settings
from surefoot.sim.log import Log, Meta

RATE = 200.0
N, K = 2e-3, 5e-4
GYRO = 5e-4


def readings(rng, seconds, white=N, walk=K):
    n = round(seconds * RATE)
    bias = np.cumsum(rng.normal(size=n)) * walk / np.sqrt(RATE)
    return bias + rng.normal(size=n) * white * np.sqrt(RATE)


def test_the_curve_against_the_definition():
    """Averages over tau of all pairs of neighbouring stretches, taken one by one."""
    x = readings(np.random.default_rng(0), 2.0)
    curve = allan_curve(x, RATE)
    for tau, sigma in zip(curve.tau, curve.sigma, strict=True):
        m = round(tau * RATE)
        means = np.array([x[k : k + m].mean() for k in range(len(x) - m + 1)])
        assert sigma == pytest.approx(np.sqrt(0.5 * np.mean((means[m:] - means[:-m]) ** 2)))


def test_white_noise_and_walk_are_recovered_and_lie_in_their_intervals():
    rng = np.random.default_rng(1)
    found = [axis_noise(readings(rng, 240.0), RATE) for _ in range(60)]
    assert np.median([one.white.value for one in found]) == pytest.approx(N, rel=0.02)
    assert np.median([one.walk.value for one in found]) == pytest.approx(K, rel=0.15)
    # 95 % intervals: of 60, fewer than 50 hold the truth less than once in 10 000 times.
    assert sum(one.white.low <= N <= one.white.high for one in found) >= 50
    assert sum(one.walk.low <= K <= one.walk.high for one in found) >= 50


def test_a_walk_that_is_not_there_is_not_resolved():
    rng = np.random.default_rng(2)
    found = [axis_noise(readings(rng, 20.0, walk=0.0), RATE).walk for _ in range(40)]
    assert sum(one.resolved for one in found) <= 4


def resting_log(seconds=60.0):
    """It walks, rests for `seconds` from t = 5 s, and walks."""
    rng = np.random.default_rng(3)
    t = np.arange(round((seconds + 10.0) * RATE)) / RATE
    moving = np.where((t < 5.0) | (t >= seconds + 5.0), 1.0, 0.0)
    columns = {"t": t}
    for k, axis in enumerate("xyz"):
        swing = moving * np.sin(12.0 * t + k)
        columns[f"gyro_{axis}"] = swing + readings(rng, seconds + 10.0, GYRO, GYRO / 5)
        columns[f"accel_{axis}"] = 9.81 * (k == 2) + 5 * swing + readings(rng, seconds + 10.0, 0.01)
    return Log(pd.DataFrame(columns), Meta(rate=RATE), "resting")


def test_the_rest_is_found_and_its_noise():
    log = resting_log()
    rows = rest_of(log)
    assert log.t[rows[0]] == pytest.approx(5.0, abs=0.51)
    assert log.t[rows[-1]] == pytest.approx(65.0, abs=0.51)
    found = rest_noise(log)
    for one in found.gyro:
        assert one.white.value == pytest.approx(GYRO, rel=0.1)
    walking = log.rows(log.t < 4.5)
    refused("nowhere at rest", rest_noise, walking)


def test_the_command_writes_settings_that_filters_take(tmp_path, capsys):
    path, out = tmp_path / "resting.parquet", tmp_path / "noise.toml"
    resting_log().write(path)
    main(f"noise {path} -o {out}".split())
    assert "at rest from" in capsys.readouterr().out
    settings = read_settings(out)
    assert settings.noise.gyro == pytest.approx(GYRO, rel=0.15)
    assert settings.noise.accel == pytest.approx(0.01, rel=0.15)
    assert out.with_suffix(".png").stat().st_size > 10_000
    refused(r"noise\.toml", main, f"noise {path} -o {out}".split(), error=SystemExit)
