"""100 Hz out of any rate, causally, with the delay that is stated."""

import tracemalloc

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surefoot.models.observer.samples import (
    ANTI_ALIAS_SPAN,
    DecimationError,
    anti_alias,
    decimate,
    observer_rows,
)
from surefoot.sim.log import Log, Meta

RATES = (500.0, 400.0, 333.0, 250.0, 1000.0, 120.0, 100.0)


def log_at(t, rate):
    return Log(pd.DataFrame({"t": t}), Meta(rate=rate))


@pytest.mark.parametrize("rate", RATES)
def test_a_slow_signal_comes_out_late_by_the_stated_delay(rate):
    t = np.arange(int(4 * rate)) / rate
    rows = observer_rows(log_at(t, rate))
    ramp = decimate(t, t[:, None], rows)[:, 0]
    settled = t[rows] > ANTI_ALIAS_SPAN
    late = t[rows][settled] - ramp[settled]
    age = np.arange(0.0, ANTI_ALIAS_SPAN, 1.0 / rate)
    weight = anti_alias(age)
    assert late == pytest.approx(weight @ age / weight.sum(), abs=1e-9)
    assert late == pytest.approx(0.010, abs=2e-4)


@pytest.mark.parametrize("rate", RATES)
def test_updates_come_at_100_hz(rate):
    t = 3.7 + np.arange(int(4 * rate)) / rate
    rows = observer_rows(log_at(t, rate))
    assert rows[0] == 0
    assert np.all(np.diff(rows) > 0)
    assert np.abs(t[rows] - t[0] - 0.01 * np.arange(len(rows))).max() <= 0.5 / rate + 1e-6
    assert len(rows) == pytest.approx(400, abs=1)


@pytest.mark.parametrize("rate", [1000.0, 500.0, 400.0, 100.0])
def test_whole_ratios_take_every_nth_row(rate):
    t = np.arange(int(4 * rate)) / rate
    assert np.array_equal(observer_rows(log_at(t, rate)), np.arange(0, len(t), round(rate / 100)))


@given(k=st.integers(0, 390), bump=st.floats(-100, 100))
@settings(max_examples=30, deadline=None)
def test_no_output_knows_the_future(k, bump):
    rng = np.random.default_rng(0)
    t = np.arange(2000) / 500
    x = rng.standard_normal((2000, 2))
    rows = observer_rows(log_at(t, 500.0))
    before = decimate(t, x, rows)
    x[rows[k] + 1 :] += bump
    after = decimate(t, x, rows)
    assert np.array_equal(before[: k + 1], after[: k + 1])


def test_what_would_fold_onto_standstill_is_removed():
    t = np.arange(5000) / 500
    rows = observer_rows(log_at(t, 500.0))
    for frequency, most in ((100.0, 1e-6), (200.0, 1e-6), (85.0, 0.15), (5.0, 1.0)):
        tone = np.sin(2 * np.pi * frequency * t + 0.7)[:, None]
        assert np.abs(decimate(t, tone, rows)[5:]).max() <= most + 1e-9
    slow = np.sin(2 * np.pi * 5.0 * t)[:, None]
    assert np.abs(decimate(t, slow, rows)).max() > 0.97


def test_constants_pass_from_the_first_row_on():
    t = np.arange(100) / 500
    rows = observer_rows(log_at(t, 500.0))
    assert decimate(t, np.full((100, 3), 2.5), rows) == pytest.approx(2.5)


def test_a_gap_has_no_updates():
    t = np.arange(1000) / 500
    t = np.delete(t, np.arange(400, 470))  # 140 ms
    rows = observer_rows(log_at(t, 500.0))
    assert np.diff(t[rows]).max() == pytest.approx(0.142, abs=0.006)
    assert np.diff(t[rows]).min() >= 0.005
    assert np.all(np.isfinite(decimate(t, t[:, None], rows)))


def test_a_gap_of_months_takes_no_memory():
    t = np.arange(1000) / 500
    short, long = (np.concatenate([t, t + gap]) for gap in (10.0, 1e7))
    tracemalloc.start()
    rows = observer_rows(log_at(long, 500.0))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e6  # a grid over the gap has 8 GB
    assert np.array_equal(rows, observer_rows(log_at(short, 500.0)))


def test_a_slow_log_is_refused():
    with pytest.raises(DecimationError, match="50 Hz"):
        observer_rows(log_at(np.arange(100) / 50, 50.0))
