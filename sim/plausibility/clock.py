"""The clock of a log: its rate, lost rows, and rows lost behind even stamps."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.plausibility.view import LogView

STEP_OFF = 0.02
"""Share by which the median step may differ from the metadata's rate: a computer's clock is good
to 1e-4; loops that wait a whole time slice are 1 % slow (10.1 ms instead of 10)."""
MISSING_ROWS = 0.03
"""Share of rows that may be missing: loops that share a computer are late for some per cent, and
filters bridge single rows."""
LONGEST_GAP = 0.05
"""s without a row: a tenth of a stride, over which nothing can be interpolated (as a reference's
gap)."""
SPEED_OFF = 0.1
"""Share by which rates may differ from changes: each blurs some per cent."""
SAME_CLOCK = 0.1
"""Share by which streams may differ in that and still say the same of the clock."""
_JUMP = 5.0
"""Times the change between rows that its fastest hundredth exceeds, in a jump."""
_AT_ONCE = 0.4
"""Share of joints, or of the reference's numbers, that jump at one row."""


def stamps(view: LogView) -> Iterator[Finding]:
    """Rows come at the rate that the log states, and all of them."""
    t, rate = view.t, view.log.rate
    if len(t) < 3:
        return
    step = np.diff(t)
    usual = float(np.median(step))
    actual = 1.0 / usual
    mean = (len(t) - 1) / (t[-1] - t[0])
    if abs(actual / rate - 1.0) > STEP_OFF and abs(mean / rate - 1.0) > STEP_OFF:
        told = f"rows at {actual:.4g} Hz, the log says {rate:.4g} Hz"
        yield Finding(("t",), told, "wrong rate, or wrong unit of time")
    missing = np.maximum(np.round(step / usual) - 1.0, 0.0)
    share = float(missing.sum() / (len(t) + missing.sum()))
    longest = float(step.max())
    # At low rates a single late row is no gap.
    if share > MISSING_ROWS or (longest > LONGEST_GAP and longest > 3.0 * usual):
        told = (
            f"{missing.sum():.0f} rows missing ({100 * share:.1f} %), longest gap "
            f"{1e3 * longest:.0f} ms after {t[int(np.argmax(step))]:.2f} s"
        )
        yield Finding(("t",), told, "lost rows")


def speed(view: LogView) -> Iterator[Finding]:
    """What are rates and what are changes agree, whatever the stream: else the stamps are wrong."""
    log = view.log
    if not view.comparable:
        return
    pairs = []
    if log.has("q") and log.has("dq"):
        pairs.append((view.means(log.dq), view.changes(log.q)))
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
    if len(factors) < 2 or max(abs(f / factors[0] - 1.0) for f in factors) > SAME_CLOCK:
        return
    factor = float(np.median(factors))
    if abs(factor - 1.0) > SPEED_OFF:
        told = f"rates are {factor:.3g} times the change of what they are rates of, in all streams"
        cause = "time runs backwards" if factor < 0 else "stamps at a wrong rate"
        yield Finding(("t",), told, cause)


def leaps(view: LogView) -> Iterator[Finding]:
    """No joint and no body jumps between two rows, least of all together."""
    log = view.log
    streams = [log.q] if log.has("q") else []
    if log.has("foot"):
        streams.append(log.foot_I.reshape(len(view.t), -1))
    if not streams or not view.comparable:
        return
    x = np.column_stack(streams)
    rate = np.abs(np.diff(x, axis=0)) / np.diff(view.t)[:, None]
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
