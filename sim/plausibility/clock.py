"""Checks of a log's clock: rate, missing rows, and missing rows behind evenly spaced stamps."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.importing.advice import entries
from surefoot.sim.importing.clock import legs_moving, set_forward
from surefoot.sim.importing.columns import UNITS
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.limits import LIKELY, RESTS, SCALED
from surefoot.sim.plausibility.view import LogView

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


@plausibility_rule("rows")
def stamps(view: LogView) -> Iterator[Finding]:
    """Check that rows come at the stated rate, without gaps.

    Compares: steps of t with each other and with the log's rate.
    Threshold: {STEP_OFF:.0%} of the rate, {SLOWEST_ROWS:g} to {FASTEST_ROWS:g} Hz;
        {MISSING_ROWS:.0%} of the rows missing, or a gap of {LONGEST_GAP:g} s.
    Reason: loops that wait whole time slices are 1 % slow; filters bridge single rows, nothing
        can be interpolated over a tenth of a stride.
    Remedy: state the rate that the rows have; record again, or cut the log at the gap.
    """
    t, rate = view.t, view.log.rate
    if len(t) < 3:
        return
    actual = 1.0 / view.step
    if not SLOWEST_ROWS < actual < FASTEST_ROWS:
        unit = next((u for u, s in UNITS["t"].items() if _USUAL[0] <= actual / s <= _USUAL[1]), "")
        cause = f"in {unit}, not s" if unit else "wrong unit of time"
        if actual < SLOWEST_ROWS and _leaps_from_row_to_row(view):
            unit, cause = "", "too slow for any filter: all moves from row to row; log at 100 Hz"
        changes = entries(("t",), unit=unit) if unit else {}
        yield Finding(("t",), f"rows at {actual:.3g} Hz", cause, changes)
        return
    mean = (len(t) - 1) / (t[-1] - t[0])
    if abs(actual / rate - 1.0) > STEP_OFF and abs(mean / rate - 1.0) > STEP_OFF:
        seen = f"rows at {actual:.4g} Hz, the log says {rate:.4g} Hz"
        yield Finding(("t",), seen, "wrong rate, or wrong unit of time")
    seen, gap = _lost(view)
    if gap:
        cause, leaps = "lost rows", set_forward(t, legs_moving(view.log.frame))
        if leaps.size:
            seen = f"leaps by {t[leaps[0]] - t[leaps[0] - 1]:.2f} s after {t[leaps[0] - 1]:.2f} s"
            cause = "the clock was set: joints go on meanwhile; import both parts separately"
        yield Finding(("t",), seen, cause)


def _leaps_from_row_to_row(view: LogView) -> bool:
    """Whether angles, else the gyro, change as much from row to row as they do in the log."""
    log = view.log
    x = log.q if log.has("q") else log.gyro if log.has("imu") else np.zeros((len(view.t), 1))
    x = x[:, np.ptp(x, axis=0) > RESTS]
    step = np.sqrt(np.mean(np.diff(x, axis=0) ** 2, axis=0)) / x.std(axis=0)
    return bool(step.size) and float(np.median(step)) > LEAPS


@plausibility_rule("single rows", "t", is_note=True)
def single_rows(view: LogView) -> Iterator[Finding]:
    """Find single missing rows, which can be interpolated.

    Compares: stamps with even ones.
    Threshold: {MISSING_ROWS:.0%} of the rows missing, without a gap.
    Reason: loops that share a computer are late for some per cent.
    Remedy: nothing, if it is known: [even] makes rows even.
    """
    if len(view.t) > 2:
        seen, gap = _lost(view)
        if seen and not gap:
            yield Finding(("t",), seen, "lost rows")


def _lost(view: LogView) -> tuple[str, bool]:
    """Missing rows in words, "" if there are too few, and whether they leave a gap."""
    step = np.diff(view.t)
    longest = float(step.max())
    missing = np.maximum(np.round(step / view.step) - 1.0, 0.0)
    share = float(missing.sum() / (len(view.t) + missing.sum()))
    # At low rates, a single late row is no gap.
    gap = longest > LONGEST_GAP and longest > 3.0 * view.step
    if share <= MISSING_ROWS and not gap:
        return "", False
    after = view.t[int(np.argmax(step))]
    seen = f"{missing.sum():.0f} rows missing ({100 * share:.1f} %), longest gap"
    return f"{seen} {1e3 * longest:.0f} ms after {after:.2f} s", gap


@plausibility_rule("speed of time", "t", when="comparable")
def speed(view: LogView) -> Iterator[Finding]:
    """Check that logged rates agree with numerical derivatives in all streams; else the stamps are
    wrong.

    Compares: dq, ref_v and gyro with the change of q, ref_p and ref_q.
    Threshold: all of them off by the same factor, {SCALED:.0%} or more.
    Reason: one factor for all streams is the clock's: 1 ms taken for 2, rows that were thinned
        out.
    Remedy: mend [source] rate, or the unit of t.
    """
    log = view.log
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
        both, size = np.sum(rate * change), np.sum(change**2)
        alike = abs(both) > LIKELY * np.sqrt(np.sum(rate**2) * size) > 0.0
        factors.append(both / size if alike else np.nan)
    factor = float(np.median(factors)) if len(factors) > 1 else np.nan
    together = np.ptp(factors or [0.0]) <= SCALED * abs(factor)
    if together and abs(factor - 1.0) > SCALED + error:
        seen = f"rates are {factor:.3g} times the change of what they are rates of, in all streams"
        cause = "time runs backwards" if factor < 0 else "stamps at a wrong rate"
        yield Finding(("t",), seen, cause)


@plausibility_rule("jumps", beside="t q foot", when="comparable")
def leaps(view: LogView) -> Iterator[Finding]:
    """Check that joints and body do not jump between two rows.

    Compares: joints from row to row.
    Threshold: two in five leap at one row, to five times what one row in a hundred has.
    Reason: rows are missing there, although stamps are even.
    Remedy: record again, with the sensor's own stamps.
    """
    x = legs_moving(view.log.frame)
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
        first = view.t[rows[0]]
        seen = f"{rows.size} rows at which joints jump together, the first at {first:.2f} s"
        yield Finding(("t", "q"), seen, "rows were lost behind even stamps, or put in")
    steps = np.diff(x[:, alive], axis=0)
    power = np.sum(steps**2, axis=0)
    one, two = (np.median(np.sum(steps[k:] * steps[:-k], axis=0) / power) for k in (1, 2))
    if one < _BACK and two > _FORTH:
        seen = f"steps correlate by {one:.2f} with the next, by {two:.2f} with the one after"
        yield Finding(("t", "q"), seen, "rows are out of order")
