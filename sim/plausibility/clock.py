"""Checks of a log's clock: rate, missing rows, and missing rows behind evenly spaced stamps."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.plausibility.view import RESTS, LogView

STEP_OFF = 0.02
"""Relative difference between the median step and the metadata's rate: a computer's clock is good
to 1e-4; loops that wait for whole time slices are 1 % slow (10.1 ms instead of 10).
"""
SLOWEST_ROWS, FASTEST_ROWS = 4.0, 2e4
"""Range of rates [Hz]: two rows per stride, which show nothing of it, and more than any sensor of a
robot is read at; IMUs have 8 kHz (InvenSense MPU-6050 product specification, gyro output rate).
"""
MISSING_ROWS = 0.03
"""Share of rows that may be missing: on a shared computer a few percent are late, and filters
bridge single rows.
"""
LONGEST_GAP = 0.05
"""Largest gap between rows [s]: a tenth of a stride, too long for interpolation (as for a
reference).
"""
SPEED_OFF = 0.1
"""Relative difference between logged rates and numerical derivatives; each is smoothed by a few
percent.
"""
SAME_CLOCK = 0.1
"""Largest difference between streams in that factor for which they agree on the clock."""
_UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Unit of time in a map -> seconds."""
_USUAL = (20.0, 1e4)
"""Usual rates of logs [Hz]."""
LEAPS = 0.6
"""Step from row to row, relative to the standard deviation, of a motion with ten rows a period; 1.4
where rows have nothing to do with each other.
"""
_JUMP = 5.0
"""Ratio of a jump to the 99 % quantile of the changes between rows."""
_BACK, _FORTH = -0.2, 0.5
"""Correlation of a joint's steps with the next and the second next: 1 for smooth motion, -0.5 and 0
for noise.
"""
_AT_ONCE = 0.4
"""Share of joints, or of the reference's columns, that jump at one row."""


def stamps(view: LogView) -> Iterator[Finding]:
    """Check that rows come at the stated rate, without gaps."""
    t, rate = view.t, view.log.rate
    if len(t) < 3:
        return
    step = np.diff(t)
    usual = float(np.median(step))
    actual = 1.0 / usual
    if not SLOWEST_ROWS < actual < FASTEST_ROWS:
        unit = next((u for u, s in _UNITS.items() if _USUAL[0] <= actual / s <= _USUAL[1]), "")
        if actual < SLOWEST_ROWS and _leaps_from_row_to_row(view):
            cause = "too slow for any filter: a stride has two rows; log at 100 Hz or more"
            yield Finding(("t",), f"rows at {actual:.3g} Hz, between which all moves", cause)
            return
        cause = f"in {unit}, not s" if unit else "wrong unit of time"
        line = f't = {{ ..., unit = "{unit}" }}' if unit else ""
        yield Finding(("t",), f"rows at {actual:.3g} Hz", cause, line)
        return
    mean = (len(t) - 1) / (t[-1] - t[0])
    if abs(actual / rate - 1.0) > STEP_OFF and abs(mean / rate - 1.0) > STEP_OFF:
        told = f"rows at {actual:.4g} Hz, the log says {rate:.4g} Hz"
        yield Finding(("t",), told, "wrong rate, or wrong unit of time")
    told, gap = _lost(view)
    if gap:
        yield Finding(("t",), told, "lost rows")


def _leaps_from_row_to_row(view: LogView) -> bool:
    """Whether angles, else the gyro, change as much from row to row as they do in the log."""
    log = view.log
    x = log.q if log.has("q") else log.gyro if log.has("imu") else np.zeros((len(view.t), 1))
    x = x[:, np.ptp(x, axis=0) > RESTS]
    step = np.sqrt(np.mean(np.diff(x, axis=0) ** 2, axis=0)) / x.std(axis=0)
    return bool(step.size) and float(np.median(step)) > LEAPS


def single_rows(view: LogView) -> Iterator[Finding]:
    """Find single missing rows, which can be interpolated."""
    if len(view.t) > 2:
        told, gap = _lost(view)
        if told and not gap:
            yield Finding(("t",), told, "lost rows")


def _lost(view: LogView) -> tuple[str, bool]:
    """Missing rows in words, "" if there are too few, and whether they leave a gap."""
    step = np.diff(view.t)
    usual, longest = float(np.median(step)), float(step.max())
    missing = np.maximum(np.round(step / usual) - 1.0, 0.0)
    share = float(missing.sum() / (len(view.t) + missing.sum()))
    # At low rates, a single late row is no gap.
    gap = longest > LONGEST_GAP and longest > 3.0 * usual
    if share <= MISSING_ROWS and not gap:
        return "", False
    told = (
        f"{missing.sum():.0f} rows missing ({100 * share:.1f} %), longest gap "
        f"{1e3 * longest:.0f} ms after {view.t[int(np.argmax(step))]:.2f} s"
    )
    return told, gap


def speed(view: LogView) -> Iterator[Finding]:
    """Check that logged rates agree with numerical derivatives in all streams; else the stamps are
    wrong.
    """
    log = view.log
    if not view.comparable:
        return
    pairs, error = [], 0.0
    if log.has("q") and log.has("dq"):
        pairs.append((view.means(log.dq), view.changes(log.q)))
        error = float(np.median(view.between_samples(log.dq, log.q)))
    if log.has("ref_v"):
        pairs.append((view.means(log.ref_v)[view.ok], view.ref_v[view.ok]))
    if view.compares_turning:
        pairs.append((view.gyro[view.ok], view.turning[view.ok]))
    factors = []
    for rate, change in pairs:
        both = np.sum(rate * change)
        size = np.sum(change**2)
        if size == 0.0 or abs(both) < 0.8 * np.sqrt(np.sum(rate**2) * size):
            return
        factors.append(float(both / size))
    if len(factors) < 2:
        return
    if max(abs(f - factors[0]) for f in factors) > SAME_CLOCK * abs(factors[0]):
        return
    factor = float(np.median(factors))
    if abs(factor - 1.0) > SPEED_OFF + error:
        told = f"rates are {factor:.3g} times the change of what they are rates of, in all streams"
        cause = "time runs backwards" if factor < 0 else "stamps at a wrong rate"
        yield Finding(("t",), told, cause)


def leaps(view: LogView) -> Iterator[Finding]:
    """Check that joints and body do not jump between two rows."""
    log = view.log
    streams = [log.q] if log.has("q") else []
    if log.has("foot"):
        streams.append(log.foot_I.reshape(len(view.t), -1))
    if not streams or not view.comparable:
        return
    x = np.column_stack(streams)
    # Rows very close together have a late or an early stamp; no joint jumped.
    step = np.diff(view.t)
    rate = np.abs(np.diff(x, axis=0)) / np.maximum(step, 0.5 * np.median(step))[:, None]
    fast = np.quantile(rate, 0.99, axis=0)
    alive = fast > 0.0
    if alive.sum() < 3:
        return
    jumped = np.mean(rate[:, alive] > _JUMP * fast[alive], axis=1) > _AT_ONCE
    rows = np.flatnonzero(jumped)
    if rows.size:
        told = (
            f"{rows.size} rows at which joints jump together, the first at {view.t[rows[0]]:.2f} s"
        )
        yield Finding(("t", "q"), told, "rows were lost behind even stamps, or put in")
    steps = np.diff(x[:, alive], axis=0)
    power = np.sum(steps**2, axis=0)
    next_, second = (np.sum(steps[k:] * steps[:-k], axis=0) / power for k in (1, 2))
    if np.median(next_) < _BACK and np.median(second) > _FORTH:
        told = (
            f"steps correlate by {np.median(next_):.2f} with the next, by {np.median(second):.2f}"
        )
        yield Finding(("t", "q"), f"{told} with the one after", "rows are out of order")
