"""Checks of streams by themselves: frozen, held, late, noisy, coarse, saturated, spiking, dropping
to zero, copied or derived from another column.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from scipy.ndimage import median_filter

from surefoot.sim.importing.advice import entries
from surefoot.sim.importing.clock import Columns, column_kind
from surefoot.sim.importing.columns import UNITS
from surefoot.sim.importing.streams import held_streams
from surefoot.sim.log.derived import JOINT_WINDOW, REFERENCE_WINDOW, derivative
from surefoot.sim.plausibility.comparison import delay_between
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.limits import LATE, MENDED, RESTS
from surefoot.sim.plausibility.view import REF_V, LogView
from surefoot.sim.sensors.stances import changes

NOISE = {"gyro": 0.2, "accel": 2.0, "q": 0.03, "dq": 1.5, "ref_p": 0.01, "foot": 0.005}
"""Largest noise between rows of a sensor that works, by kind [rad/s, m/s^2, rad, rad/s, m, m], from
which other limits follow.

Gyros: data sheets have 0.01 (MPU-6050, 0.05 deg/s behind a filter, 0.005 deg/s/√Hz), logs of a Go1
and a SCALER 0.03 including vibration. Accelerometers: 0.06 (MPU-6050, 400 ug/sqrt(Hz), over 250
Hz), logs of a Go1, a SCALER and an iCub 0.3 to 0.6. Angles: five counts of 10 bits. Rates: one
count of 12 bits in a row of 1 ms. References: motion capture without a rigid body.
"""
LATE_RATE = 4e-3
"""Delay of joint rates relative to the derivative of their angles [s]: two samples at 500 Hz."""
LATEST_RATE, LATEST_REFERENCE = 0.05, 0.3
"""Largest delays that are searched for [s]: of rates, as for the effects of timing, and of a
reference's velocity, which a tracker may filter.
"""
FROZEN = 0.2
"""Time without a change while related streams move [s]: half a swing."""
_STRAY = 0.02
"""Error of a rate at rest, besides its mean [rad/s]: drives estimate it from encoder counts."""
_OTHER_UNIT = 3.0
"""Ratio to the derivative of its angle from which a rate, or time, is in another unit."""
_WHOLE_TURN = 2.0 * np.pi
"""Angle that no joint of an arm or leg moves through [rad]."""
_MOST_HOLDS = 50
"""Number of constant sections examined, longest first; a log with rests has thousands."""
_FEWEST_ALIKE = 4
"""Least number of equal rows that is no coincidence, for coarse readings at a low rate."""
LIMITED = 0.5
"""Time without a change of torques [s], which drives hold at their limit for a while."""
_SENSORS = ("gyro", "accel", "q", "dq", "tau", "ref_p", "ref_q", "ref_v", "foot")
_ALIVE = 0.25
"""Share of its usual spread from which a related stream moves."""
CLIPPED = 5
"""Rows at exactly the largest value from which a sensor is saturated; there must also be three
times as many as in the 3 % of its span below.
"""
COARSE = 0.25
"""Least difference of two readings that is reported, relative to NOISE: fifty times what sensors of
16 bits and encoders of 12 bits have.
"""
OVERFLOWS = 30.0
"""Least step from row to row that is an overflow, relative to NOISE: nothing with mass does it.
Accelerometers do, at impacts.
"""
FROM_END_TO_END, LEAST_OVERFLOWS = 0.9, 3
"""Least step relative to the readings' whole range, and least number of such steps."""
SPIKE, SPIKES = 12.0, 10.0
"""Least size of a spike, relative to the 99 % quantile of the deviation from the median of five
rows, and to NOISE: no body or joint moves so far and back within a row of 2 to 10 ms.
"""
IMPACT = 150.0
"""Least size of a spike of an accelerometer [m/s^2]: touchdowns reach 70."""
LONE = 4.0
"""Standard deviations of a joint's angle, rate or torque that are a spike at any size."""
SEVERAL = 10
"""Number of rows that may be spikes: in a log of a few seconds, more than 1 % of them."""
DROPS = 5
"""Rows of exactly 0 between other values from which they are drop-outs."""
STRAIGHT = 0.6
"""Share of moving rows whose step equals the last one to a millionth; no sensor has such rows."""
SLOWEST_REFERENCE = 20.0
"""Rate of a reference that is interpolated [Hz], ten samples per stride."""
SLOWER = 0.75
"""Ratio to the rows' rate below which a stream is held: a coarsely quantised one repeats itself by
chance at a sixth of the rows.
"""
_COMMANDS = ("q_des_", "dq_des_", "tau_ff_", "x_")
"""Columns that are no sensor's; a controller may run slower than its log."""
_SAME = 1e-9
"""Relative squared difference of a copy, from rounding; another sensor has its own noise."""
_LEAST_DISTINCT = 20
"""Number of distinct values below which a column is a state or a command, not a reading."""


@plausibility_rule("frozen")
def frozen(view: LogView) -> Iterator[Finding]:
    """Check that a sensor changes while related ones do.

    Compares: a sensor with its siblings: other axes, the joint's own rate, other joints.
    Threshold: no change for {FROZEN:g} s (torques {LIMITED:g} s) while they move.
    Reason: half a swing; every sensor has noise.
    Remedy: leave the column out, or cut the log there.
    """
    kinds = _kinds(view, _SENSORS)
    for kind, columns in kinds.items():
        least = max(LIMITED if kind == "tau" else FROZEN, _FEWEST_ALIKE * view.step)
        for name, x in columns.items():
            sections = still_sections(view.t, x, least)
            if not sections:
                continue
            joint = _of_joint(view, kind, name)
            if kind in ("q", "dq") and _comparable(view, joint):
                hangs = [rows for rows in sections if _contradict(view.t, joint, rows, kind)]
            elif kind in ("q", "dq", "tau") and (view.robot is None or _rests(view.t, joint)):
                hangs = []  # the joints of an arm rest one by one
            else:
                hangs = [rows for rows in sections[:1] if _others_move(kinds, name, rows)]
            if hangs:
                t = view.t[hangs[0]]
                when = f"from {t[0]:.2f} to {t[-1]:.2f} s" if len(t) < len(x) else "throughout"
                seen = "no change while others move"
                yield Finding((name,), seen, f"a sensor that hangs {when}")


def _of_joint(view: LogView, kind: str, name: str) -> Columns:
    """Angle "q" and rate "dq" (N,) of the joint of a column, those that the log has."""
    joint, columns = name.removeprefix(f"{kind}_"), view.log.columns
    return {one: columns[f"{one}_{joint}"] for one in ("q", "dq") if f"{one}_{joint}" in columns}


def _comparable(view: LogView, joint: Columns) -> bool:
    """Whether a joint's angle and rate (N,) are measured, and in the same unit."""
    derived = any(d.startswith("dq") for d in view.log.meta.derived)
    if derived or len(joint) < 2 or not view.comparable or np.ptp(joint["q"]) > _WHOLE_TURN:
        return False
    rate = view.means(joint["dq"][:, None]).std()
    change = view.changes(joint["q"][:, None]).std()
    return bool(change < _OTHER_UNIT * rate < _OTHER_UNIT**2 * change)


def _contradict(t: np.ndarray, joint: Columns, rows: slice, kind: str) -> bool:
    """Whether a joint's angle is not the sum of its rate (N,) at t [s] in rows in which that of a
    kind is constant.
    """
    t, q, dq = t[rows], _median5(joint["q"])[rows], _median5(joint["dq"])
    steps, long = np.abs(np.diff(joint[kind])), float(t[-1] - t[0])
    count = float(steps[steps > 0.0].min(initial=np.inf))
    # Rates of a joint at rest may have an offset, but a joint that moved has a mean, too.
    turned = [np.cumsum((dq[rows] - offset) * np.gradient(t)) for offset in (0.0, dq.mean())]
    strays = min(float(np.ptp(q - one)) for one in turned)
    return strays > max(RESTS, 3.0 * count * (long if kind == "dq" else 1.0)) + _STRAY * long


def _rests(t: np.ndarray, joint: Columns) -> bool:
    """Whether a joint rests throughout, by angle and rate (N,) at t [s].

    An angle that never changes and has no rate beside it may also be a dead sensor.
    """
    turned = [np.ptp(joint["q"])] if "q" in joint else []
    if "dq" in joint:
        # Without its mean, since rates of a joint at rest may have an offset.
        turned.append(np.ptp(np.cumsum((joint["dq"] - joint["dq"].mean()) * np.gradient(t))))
    return max(turned, default=np.inf) < RESTS and (len(turned) > 1 or max(turned) > 0.0)


def _others_move(kinds: dict[str, Columns], name: str, rows: slice) -> bool:
    """Whether streams that go with a column move in some rows: others of its kind, else gyro,
    angles and positions; `kinds` are columns (N,) by kind and name.
    """
    siblings, elsewhere = [], []
    for kind, columns in kinds.items():
        moves = [_moves(x, rows) for other, x in columns.items() if other != name]
        if name in columns:
            siblings = moves
        elif kind in ("gyro", "q", "ref_p"):
            elsewhere += moves
    if sum(siblings) >= max(1, 0.5 * len(siblings)):
        return True
    return len(elsewhere) > 2 and sum(elsewhere) > 0.7 * len(elsewhere)


def _moves(x: np.ndarray, rows: slice) -> bool:
    """Whether a column moves in both halves of some rows."""
    low, high = np.quantile(x, (0.05, 0.95))
    half = (len(x[rows]) - 1) // 2
    least = min(np.ptp(x[rows][: half + 1]), np.ptp(x[rows][half:]))
    return bool(high > low) and float(least) > _ALIVE * float(high - low)


@plausibility_rule("held", beside="t", is_note=True)
def held(view: LogView) -> Iterator[Finding]:
    """Find columns that are sampled more slowly than the rows.

    Compares: rows of a sensor with the rows before.
    Threshold: repeated so often that it has {SLOWER:g} of the rate of the rows.
    Reason: a slower sensor; coarse readings repeat at a sixth of the rows by chance.
    Remedy: nothing, if it is known: rates from differences are wrong, noise is less than it
        seems.
    """
    rate, cause = view.log.rate, "a slower sensor, read more often than it measures"
    for kind, columns in held_streams(view.log).items():
        usual = float(np.median([*columns.values()]))
        if usual < SLOWER * rate and not next(iter(columns)).startswith(_COMMANDS):
            seen = f"sampled at {usual:.0f} Hz and repeated, rows at {rate:.0f} Hz"
            yield Finding(tuple(columns), seen, cause, {"even": {"held": (kind,)}})


@plausibility_rule("interpolated", beside="t", is_note=True)
def interpolated(view: LogView) -> Iterator[Finding]:
    """Find readings on straight lines between samples, which have been interpolated.

    Compares: steps of a sensor from row to row.
    Threshold: {STRAIGHT:.0%} of them as the one before.
    Reason: every sensor has noise.
    Remedy: nothing, if it is known: noise is less than it seems, and impacts are missing.
    """
    known = " ".join(view.log.meta.derived)
    for kind, name, x in _each(view, "gyro", "accel", "q", "dq", "tau", "foot", "ref_p"):
        if f"{kind} (between held readings)" in known:
            continue
        share = _straight(x)
        rate = view.log.rate * (1.0 - share)
        if share > STRAIGHT and (kind != "ref_p" or rate < SLOWEST_REFERENCE):
            seen = f"on straight lines between readings at {rate:.0f} Hz"
            yield Finding((name,), seen, "a slower sensor, interpolated: its noise is not that")


@plausibility_rule("late", beside="t ref")
def lagging(view: LogView) -> Iterator[Finding]:
    """Find columns that lag another measurement of the same quantity.

    Compares: dq with the change of q, ref_v with that of ref_p.
    Threshold: {LATE_RATE:g} s; {LATE:g} s.
    Reason: two samples; a filter's delay moves what filters and traces see.
    Remedy: nothing, if it is known: trace has rate_delay.
    """
    log, t, pairs = view.log, view.t, []
    if log.has("q") and log.has("dq"):
        moved, columns = derivative(t, log.q, JOINT_WINDOW, causal=False), view.columns("dq")
        usual = delay_between(t, log.dq, moved, LATEST_RATE)
        pairs.append((columns, log.dq, moved, usual, LATE_RATE, "q", "dq"))
        for j, column in enumerate(columns) if view.resolves else ():
            one = log.dq[:, [j]], moved[:, [j]]
            delay = delay_between(t, *one, LATEST_RATE)
            if abs(delay - usual) > LATE_RATE:
                pairs.append(((column,), *one, delay, LATE_RATE, column[1:], column))
    if log.has("ref_v"):
        moved = derivative(t, log.ref_p, REFERENCE_WINDOW, causal=False)
        delay = delay_between(t, log.ref_v, moved, LATEST_REFERENCE)
        # A reference has a clock of its own, so that the map cannot move its velocity alone.
        pairs.append((REF_V, log.ref_v, moved, delay, LATE, "ref_p", ""))
    for columns, x, moved, delay, least, of, key in pairs:
        shifted = np.column_stack([np.interp(t + delay, t, y) for y in x.T])
        explained = np.sum((shifted - moved) ** 2) < MENDED * np.sum((x - moved) ** 2)
        if explained and abs(delay) >= view.least_lag(least):
            when = "late" if delay > 0 else "early"
            seen = f"{1e3 * abs(delay):.1f} ms {when} against the change of {of}"
            mended = {"even": {"late": {key: round(delay, 4)}}} if key else {}
            yield Finding(columns, seen, "a filter, or stamps of another clock", mended)


@plausibility_rule("noise", beside="t gyro accel dq", when="comparable resolves")
def noisy(view: LogView) -> Iterator[Finding]:
    """Check the noise of gyro, accelerometer and joint rates.

    Third differences hold little of a body's smooth motion.

    Compares: gyro, accelerometer and joint rates with themselves from row to row.
    Threshold: {NOISE[gyro]:g} rad/s, {NOISE[accel]:g} m/s², {NOISE[dq]:g} rad/s (joints).
    Reason: data sheets of IMUs have a twentieth; encoders of 12 bits, read at 1 kHz and not
        filtered, have as much; a body with mass moves smoothly.
    Remedy: leave the log or the column out; of rates, or filter them: surefoot derives them from
        angles, and says so; a filter takes such noise for 0.01 rad/s and 0.1 m/s².
    """
    cause = "a broken sensor, a drive that chatters, or readings of several samples mixed up"
    for kind, name, x in _each(view, "gyro", "accel", "dq"):
        # Third differences of white noise have 20 times its variance; the median ignores impacts.
        rough = np.median(np.abs(np.diff(x, n=3))) / 0.6745 / np.sqrt(20.0)
        if rough > NOISE[kind]:
            unit = next(iter(UNITS[kind]))
            yield Finding((name,), f"{rough:.2f} {unit} from row to row", cause)


@plausibility_rule("coarse", beside="gyro accel q", is_note=True)
def coarse(view: LogView) -> Iterator[Finding]:
    """Check that readings resolve what they measure.

    Compares: readings of gyro, accelerometer and angles with each other.
    Threshold: nothing between readings that are {COARSE:g} times as far apart as the largest
        noise of a sensor that works.
    Reason: fifty times what sensors of 16 bits and encoders of 12 bits have.
    Remedy: record more digits.
    """
    for kind, name, x in _each(view, "gyro", "accel", "q"):
        least = float(np.diff(np.unique(x)).min(initial=np.inf))
        if COARSE * NOISE[kind] < least < np.inf:
            seen = f"readings are {least:.3g} apart or more"
            yield Finding((name,), seen, "rounded, or the numbers of a sensor not converted")


@plausibility_rule("overflow")
def overflows(view: LogView) -> Iterator[Finding]:
    """Check that readings do not wrap around at the ends of their range.

    Compares: steps of gyro and angles from row to row with the range of their readings.
    Threshold: {LEAST_OVERFLOWS} steps over {FROM_END_TO_END:.0%} of it, not back at once, of
        {OVERFLOWS:g} times the largest noise of a sensor that works.
    Reason: what has mass passes the middle of a range on its way to the other end.
    Remedy: a sensor of larger range, or wider numbers; wrap for angles.
    """
    even = np.diff(view.t) < 2.0 * np.median(np.diff(view.t)) if len(view.t) > 2 else False
    for kind, name, x in _each(view, "gyro", "q"):
        steps, span = np.abs(np.diff(x)), float(np.ptp(x))
        over = even & (steps > max(FROM_END_TO_END * span, OVERFLOWS * NOISE[kind]))
        over[1:-1] &= ~(over[:-2] | over[2:])  # a row there and back is a spike
        if np.sum(over) < LEAST_OVERFLOWS or not _varied(x):
            continue
        seen = f"{np.sum(over)} steps from one end of its range to the other, {span:.3g} away"
        turns = kind == "q" and abs(span / _WHOLE_TURN - 1.0) < 0.05
        cause = "an angle that starts again after a turn" if turns else "numbers that overflow"
        yield Finding((name,), seen, cause, entries((name,), wrap=_WHOLE_TURN) if turns else {})


@plausibility_rule("saturated", is_note=True)
def saturated(view: LogView) -> Iterator[Finding]:
    """Check that readings do not accumulate at their largest value.

    Compares: readings of IMU and joint rates with their largest.
    Threshold: {CLIPPED} rows at exactly it, and three times as many as near it.
    Reason: a sensor's noise spreads what does not clip.
    Remedy: a sensor of larger range; filters take clipped readings for true ones.
    """
    for _, name, x in _each(view, "gyro", "accel", "dq"):
        for sign in (1.0, -1.0):
            y = sign * x
            top = float(y.max())
            at_top = y == top
            # A coarse sensor may have no reading within 3 % of it.
            next_to_it = float(y[~at_top].max(initial=-np.inf))
            near = max(0.03 * (top - float(np.median(y))), 1.5 * (top - next_to_it))
            # One row more below: a coarse reading's peak may leave out a step by chance.
            below = int(np.sum((y < top) & (y > top - near))) + 1
            times = int(np.sum(np.diff(at_top.astype(int)) > 0))
            if at_top.sum() > max(CLIPPED - 1, 3 * below) and times > 1 and _varied(y):
                side = "largest" if sign > 0 else "smallest"
                seen = f"{at_top.sum()} rows at exactly {sign * top:.4g}, its {side}"
                yield Finding((name,), seen, "the sensor's range, or a clip")


@plausibility_rule("spikes", beside="t q dq")
def spikes(view: LogView) -> Iterator[Finding]:
    """Check that no stream jumps for a row and back.

    Compares: each row with the median of five.
    Threshold: {SPIKE:g} times what one row in a hundred has, and {SPIKES:g} times the largest noise
        of a sensor that works, or {LONE:g} standard deviations of a joint;
        {DROPS} rows of exactly 0 between others.
    Reason: nothing with mass leaps for a few milliseconds and back; chatter shows in angles
        too.
    Remedy: leave such rows out before the import.
    """
    for kind, name, x in _each(view, *NOISE, "tau"):
        if kind == "tau" and not view.on_fixed_base:
            continue  # a leg that lands asks for any torque
        if len(x) < 50 or not np.ptp(x):
            continue
        # Drives report no rate below some speed.
        zeros = _drop_outs(x, most=2 if kind in ("dq", "tau") else None)
        rows, off = _leaps(view, kind, name, x)
        if zeros >= DROPS:
            seen = f"{zeros} rows read exactly 0 between rows that do not"
            yield Finding((name,), seen, "drop-outs filled with zeros")
        elif rows.size:
            first = view.t[rows[0]]
            seen = f"leaps by up to {off.max():.3g} and back, first at {first:.2f} s"
            yield Finding((name,), seen, "readings corrupted in transmission")


def _leaps(view: LogView, kind: str, name: str, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (K,) at which a column x (N,) leaps and back, and how far (K,).

    A joint's rate does not where its angle changes as it says, as for a leg that chatters on the
    ground.
    """
    off = np.abs(x - _median5(x))
    least = IMPACT if kind == "accel" else SPIKES * NOISE.get(kind, np.inf)
    if kind in ("q", "dq", "tau"):
        least = min(least, LONE * float(x.std()))
    usual = float(np.quantile(off, 1.0 - max(0.01, SEVERAL / len(x))))
    rows = np.flatnonzero(off > max(least, SPIKE * usual))
    joint = _of_joint(view, kind, name)
    if kind == "dq" and "q" in joint:
        change = np.diff(joint["q"]) / np.diff(view.t)
        beside = change[np.clip([rows - 1, rows], 0, len(change) - 1)]
        rows = rows[np.abs(beside - x[rows]).min(axis=0) >= 0.25 * off[rows]]
    return rows, off[rows]


@plausibility_rule("copied")
def copies(view: LogView) -> Iterator[Finding]:
    """Check that no two sensors read exactly the same.

    Compares: columns of one kind with each other.
    Threshold: equal, or of opposite sign, to 1e-9 of their mean square.
    Reason: two sensors have noise of their own.
    Remedy: one of two columns of the map names the wrong one of theirs.
    """
    kinds = _kinds(view, ("gyro", "accel", "q", "dq", "tau", "force", "foot"))
    for kind, columns in kinds.items():
        apart = {name: x - x.mean() for name, x in columns.items() if _varied(x)}
        units = {name: x / np.linalg.norm(x) for name, x in apart.items()}
        for (a, x), (b, y) in combinations(units.items(), 2):
            if 2.0 - 2.0 * abs(x @ y) < _SAME:
                seen = "alike to 1 part in 1e9 of the mean square"
                cause = f"one of two {kind} columns was read twice: {b} is {a}"
                yield Finding((a, b), seen, cause)


@plausibility_rule("derived", when="comparable", is_note=True)
def derived(view: LogView) -> Iterator[Finding]:
    """Find columns that follow exactly from others and are no measurement.

    Compares: dq with the difference of q, tau with the motor law.
    Threshold: equal to 1e-8 of the mean square.
    Reason: what follows from others is no measurement, and has their errors.
    Remedy: leave the column out: surefoot derives it, and says so.
    """
    log = view.log
    if log.has("q") and log.has("dq") and not any(d.startswith("dq") for d in log.meta.derived):
        change = np.diff(log.q, axis=0) / np.diff(view.t)[:, None]
        central = np.gradient(log.q, view.t, axis=0)
        made = np.zeros(len(log.joints), dtype=bool)
        for one, rates in ((change, log.dq[1:]), (change, log.dq[:-1]), (central, log.dq)):
            made |= np.sum((one - rates) ** 2, axis=0) < 1e-8 * np.sum(log.dq**2, axis=0)
        if made.any():
            seen = "the difference of q from row to row, to 1e-4 of its size"
            yield Finding(view.columns("dq", made), seen, "computed from q, not measured")
    law = log.meta.motor_law
    if law and all(log.has(group) for group in ("tau", "q", "q_des", "dq")):
        commanded = np.asarray(law["kp"]) * (log.q_des - log.q) - np.asarray(law["kd"]) * log.dq
        if np.any(log.tau) and np.sum((commanded - log.tau) ** 2) < 1e-8 * np.sum(log.tau**2):
            seen = "the motor law of q_des, q and dq, to 1e-4 of its size"
            yield Finding(view.columns("tau"), seen, "commanded, not measured")


def _each(view: LogView, *wanted: str) -> Iterator[tuple[str, str, np.ndarray]]:
    """Kind, name and values (N,) of the columns of some kinds."""
    for kind, columns in _kinds(view, wanted).items():
        yield from ((kind, name, x) for name, x in columns.items())


def _kinds(view: LogView, wanted: tuple[str, ...]) -> dict[str, Columns]:
    """Columns (N,) of a log by kind, such as gyro, accel, q, foot, ref_p or ref_q, and name; of a
    reference that is mostly interpolated over gaps, none.
    """
    found: dict[str, Columns] = {}
    gaps = view.log.has("reference") and view.log.ref_ok.mean() < 0.5
    for name, x in view.log.columns.items():
        if gaps and name.startswith("ref_"):
            continue
        kind = name.rsplit("_", 1)[0] if name.startswith("ref_") else column_kind(name)
        if kind in wanted:
            found.setdefault(kind, {})[name] = x
    return found


def still_sections(t: np.ndarray, x: np.ndarray, least: float) -> list[slice]:
    """Rows of the sections of at least `least` [s] in which x (N,) is constant, longest first.

    t (N,) [s] are the times of the rows.
    """
    first = np.concatenate([[0], changes(x)])
    last = np.append(first[1:], len(x)) - 1
    long = np.flatnonzero(t[last] - t[first] >= least)
    order = long[np.argsort(first[long] - last[long], kind="stable")]
    return [slice(int(first[k]), int(last[k]) + 1) for k in order[:_MOST_HOLDS]]


def _straight(x: np.ndarray) -> float:
    """Share of the moving rows at which x (N,) continues its last step; 0 for coarsely quantised
    streams.
    """
    steps = np.diff(x)
    moves = steps[1:] != 0.0
    if moves.sum() < 50:
        return 0.0
    counts = steps[steps != 0.0] / np.abs(steps[steps != 0.0]).min()
    if np.median(np.abs(counts - np.round(counts))) < 1e-3:
        return 0.0
    on = np.abs(np.diff(steps)) < 1e-6 * np.abs(steps[1:]) + 1e-14 * np.abs(x).max()
    return float(np.mean(on[moves]))


def _varied(x: np.ndarray) -> bool:
    return len(np.unique(x)) > _LEAST_DISTINCT


def _median5(x: np.ndarray) -> np.ndarray:
    """Median (N,) of each value of x (N,) and the two on either side."""
    return median_filter(x, 5, mode="nearest")


def _drop_outs(x: np.ndarray, most: int | None = None) -> int:
    """Number of rows at exactly 0 that x (N,) leaps to and from, of runs of at most `most` rows. At
    a single row it may have crossed 0 to the other sign.

    0 if as many rows are nearly 0, as in coarsely quantised streams that cross it.
    """
    zero = x == 0.0
    if np.mean(zero) > 0.5:
        return 0
    steps = np.abs(np.diff(x))
    count, usual = float(steps[steps > 0.0].min(initial=np.inf)), float(np.quantile(steps, 0.9))
    far = 3.0 * max(usual, count)
    edges = np.flatnonzero(np.diff(zero)) + 1
    edges = edges[1 if zero[0] else 0 :]
    first, last = edges[: len(edges) // 2 * 2].reshape(-1, 2).T
    leaps = np.minimum(np.abs(x[first - 1]), np.abs(x[last])) > far
    leaps &= (last - first > 1) | (x[first - 1] * x[last] > 0.0)
    if most is not None:
        leaps &= last - first <= most
    dropped = int(np.sum((last - first)[leaps]))
    nearly = (x != 0.0) & (np.abs(x) < usual) & (np.abs(_median5(x)) > 3.0 * usual)
    return dropped if dropped > np.sum(nearly) else 0
