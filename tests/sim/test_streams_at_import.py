"""Streams that are held between slower samples, or late, are recognised."""

import tracemalloc

import numpy as np
import pandas as pd
import pytest

from surefoot.sim.importing.streams import held_streams
from surefoot.sim.log import Log, Meta
from surefoot.sim.plausibility import check_log
from surefoot.sim.plausibility.comparison import delay_between

T = np.arange(0.0, 8.0, 1 / 400)


def log_of(**columns):
    return Log(pd.DataFrame({"t": T} | columns), Meta(400.0))


def angle(t, rng=None):
    noise = 0.0 if rng is None else rng.normal(0.0, 1e-3, t.shape)
    return 0.4 * np.sin(9.0 * t) + 0.1 * np.cos(23.0 * t) + noise


def held(x, rate):
    """x as a sensor of a lower rate has it, read at every row."""
    return x[np.searchsorted(T, np.floor(T * rate + 1e-9) / rate - 1e-9)]


@pytest.mark.parametrize("rate", [200.0, 100.0, 150.0])
def test_a_slower_sensor_is_found_with_its_rate(rate):
    rng = np.random.default_rng(0)
    slow = {f"gyro_{axis}": held(angle(T, rng), rate) for axis in "xyz"}
    fast = {f"accel_{axis}": angle(T, rng) for axis in "xyz"}
    found = held_streams(log_of(**slow, **fast))
    assert {kind: [*columns] for kind, columns in found.items()} == {"gyro": [*slow]}
    assert np.median([*found["gyro"].values()]) == pytest.approx(rate, rel=0.02)


def test_neither_whole_counts_nor_rest_are_held():
    rng = np.random.default_rng(1)
    counted = np.round(angle(T) / 4e-4) * 4e-4
    still = np.where(T < 4.0, 0.0, angle(T, rng))
    resting = np.where(T < 4.0, 0.3, angle(T, rng))
    assert held_streams(log_of(q_knee=counted, x_a=still, x_b=resting)) == {}


MILLIDEGREE = np.radians(1e-3)


@pytest.mark.parametrize("rate", [200, 500, 1000, 2000])
@pytest.mark.parametrize(
    ("amplitude", "resolution", "noise"),
    [
        (0.3, MILLIDEGREE, 0.0),  # radians, and their noise in resolutions
        (0.05, MILLIDEGREE, 0.5),
        (0.01, MILLIDEGREE, 0.0),
        (0.01, MILLIDEGREE, 1.0),
        (0.3, 2.0 * np.pi / 4096, 0.0),
        (0.1, 2.0 * np.pi / 16384, 1.0),
    ],
)
def test_rounded_readings_are_of_no_slower_sensor(rate, amplitude, resolution, noise):
    rng = np.random.default_rng(3)
    t = np.arange(8 * rate) / rate
    x = amplitude * (np.sin(4.0 * t) + 0.25 * np.cos(11.0 * t)) + noise * resolution * rng.normal(
        size=len(t)
    )
    rounded = resolution * np.round(x / resolution)
    assert held_streams(Log(pd.DataFrame({"t": t, "q_knee": rounded}), Meta(float(rate)))) == {}


def test_rounded_readings_of_a_slower_sensor_are_found():
    step = 2.0 * np.pi / 16384
    found = held_streams(log_of(q_knee=held(step * np.round(angle(T) / step), 100.0)))
    assert found["q"]["q_knee"] == pytest.approx(100.0, rel=0.1)


@pytest.mark.parametrize(
    ("stamps", "close"),
    [(T + 3600.0 * (T > 4.0), 2e-4), (T + 30.0 * np.floor(2.0 * T), 1e-3)],
    ids=["an hour", "sixteen times half a minute"],
)
def test_pauses_without_rows_are_not_filled_with_them(stamps, close):
    """A grid at their rate would have 1.4 million rows and 190 000, all but 3200 between two."""
    early, now = angle(T), angle(T - 8e-3)
    tracemalloc.start()
    delay = delay_between(stamps, now[:, None], early[:, None], 0.05)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert delay == pytest.approx(8e-3, abs=close)
    assert most < 5e6


@pytest.mark.parametrize("late", [8e-3, -6e-3, 0.0])
def test_rates_that_come_late_are_found(late):
    h = 1e-4
    rates = (angle(T - late + h) - angle(T - late - h)) / (2 * h)
    lines = [one.line for one in check_log(log_of(q_knee=angle(T), dq_knee=rates))]
    said = f"{1e3 * abs(late):.1f} ms {'late' if late > 0.0 else 'early'}"
    assert [said in line for line in lines] == [True] * bool(late)


def test_what_is_not_alike_has_no_delay():
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, len(T), 1))
    assert delay_between(T, a, b, 0.05) == 0.0


@pytest.mark.parametrize(("late", "said"), [(5.1e-3, False), (5.4e-3, True), (-5.4e-3, True)])
def test_two_samples_and_more_than_averages_lag_are_reported(late, said):
    found = check_log(log_of(q_knee=angle(T), dq_knee=rate_of(T - late)))
    assert [one.rule for one in found] == ["late"] * said


def rate_of(t):
    return 3.6 * np.cos(9.0 * t) - 2.3 * np.sin(23.0 * t)
