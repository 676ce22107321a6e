"""Study of a Go2 hung in the air: the time between rows of its log, and effects of its drives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from studies.hardware.drives import (
    EFFECTS,
    RIVALS,
    Balance,
    balance,
    between,
    fit_sizes,
    left,
    level_interval,
    rms,
    select,
)
from studies.hardware.row_times import RowTimes, row_times
from surefoot import Log
from surefoot.extend import Modelled
from surefoot.scenarios.reporting import AFTER, BEFORE, INK, new_figure, set_title

HANGING_WIDTH = 0.03
"""Width of the kernel [s]."""
STOPS = 0.1
"""Distance from the end of a joint's range [rad] within which the calves lean on compliant stops.
"""
REPORT_SHARE = 0.35
"""Share of the log, at its end, that no fit uses."""
SOURCE = 0.002
"""Time between the states that the robot publishes [s] (unitree_sdk2's examples: 500 Hz)."""
ROW_PERIODS = (0.005, 0.0044)
"""Period of a row [s]: the nominal one, and that from rates and positions."""
JOINT_KINDS = ("hips", "thighs", "calves")
_SMALL = ("torque_bias", "torque_delay", "viscous_friction")
HANGING_MODELS: dict[str, tuple[str, ...]] = {
    "as declared": (),
    "bias, delay and viscous friction": _SMALL,
    "and a torque scale": (*_SMALL, "torque_scale"),
    "and another armature": (*_SMALL, "armature"),
    "and other armature and dry friction": (*_SMALL, "armature", "coulomb_friction"),
    "and torque scale, armature, dry friction": tuple(EFFECTS),
    "and heavier links instead of a torque scale": (
        *_SMALL,
        "gravity",
        "inertia",
        "armature",
        "coulomb_friction",
    ),
}
"""Explanations that are compared on the part that no fit has seen."""


@dataclass(frozen=True)
class Drives:
    """The drives, given the period of a row: the part for fit and selection, and the part that
    reports.
    """

    period: float
    seen: Balance
    unseen: Balance


def drives(log: Log, machine: Modelled, period: float) -> Drives:
    """The balance of the log if a row takes `period` [s]."""
    retimed = log.with_columns({"t": period * np.arange(len(log.t))})
    one = balance(retimed, machine, HANGING_WIDTH, STOPS)
    late = one.t > (1 - REPORT_SHARE) * one.t[-1]
    return Drives(
        period,
        replace(one, good=one.good & ~late[:, None]),
        replace(one, good=one.good & late[:, None]),
    )


def clock(log: Log, seed: int = 0) -> RowTimes:
    """Estimate the times between rows from the joints."""
    return row_times(log.q, log.dq, np.random.default_rng(seed))


def clock_table(times: RowTimes, joints: Sequence[str]) -> pd.DataFrame:
    """One row for each joint: mean time of a row by its angle and rate, and the scale of its rate
    if a row takes 5 ms.
    """
    rows = []
    for joint, period, interval in zip(joints, times.period, times.periods, strict=True):
        scale = [ROW_PERIODS[0] / x for x in (period, *interval[::-1])]
        rows.append(
            {
                "joint": joint,
                "ms a row, if its rate is right": between(1e3 * period, 1e3 * interval, 2),
                "its rate reads, if a row is 5 ms": between(scale[0], scale[1:], 3),
            }
        )
    return pd.DataFrame(rows)


def ticks_table(times: RowTimes) -> pd.DataFrame:
    """The two lengths of rows, as multiples of the period of the source."""
    low, high = (3.0 - share for share in times.share_interval[::-1])
    ticks = 3.0 - times.share
    row = between(1e3 * SOURCE * ticks, (1e3 * SOURCE * low, 1e3 * SOURCE * high))
    values = {
        "short rows, by the rates [ms]": f"{1e3 * times.short:.2f}",
        "long rows, by the rates [ms]": f"{1e3 * times.long:.2f}",
        "long / short (3 / 2 if rows are 2 and 3 ticks of a source)": between(
            times.ratio, times.ratio_interval
        ),
        "share of short rows": between(times.share, times.share_interval),
        "ticks a row": between(ticks, (low, high)),
        "a row, if the source ticks at 500 Hz [ms]": row,
    }
    return pd.DataFrame([{"what": name, "value": value} for name, value in values.items()])


def drives_table(found: Drives, seed: int = 0) -> pd.DataFrame:
    """One row for each joint: effects with intervals, and the residual torque of the part not
    fitted.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for j, joint in enumerate(found.seen.joints):
        names = select([found.seen], j, tuple(EFFECTS))
        sizes = fit_sizes([found.seen], j, names, rng)
        every = fit_sizes([found.seen], j, (*EFFECTS, *RIVALS), rng, samples=0)
        before, after = left(found.unseen, j), left(found.unseen, j, sizes)
        good = (found.seen.good | found.unseen.good)[:, j]
        of_before = level_interval([(found.unseen, before)], rng)
        of_after = level_interval([(found.unseen, after)], rng)
        rows.append(
            {
                "joint": joint,
                "before [N m]": between(rms(before), of_before, 2),
                "after [N m]": between(rms(after), of_after, 2),
                "every term [N m]": f"{rms(left(found.unseen, j, every)):.2f}",
                "jitter [N m]": f"{found.seen.floor[j]:.3f}",
                "masked [%]": f"{100 * (1 - good.mean()):.0f}",
                "effects (95 % interval)": "; ".join(
                    f"{name.replace('_', ' ')} {between(*size)} {_unit(name)}".strip()
                    for name, *size in zip(sizes.names, sizes.values, sizes.interval, strict=True)
                ),
            }
        )
    return pd.DataFrame(rows)


def _unit(effect: str) -> str:
    return EFFECTS[effect].replace("ratio", "")


def hanging_rivals_table(found: Drives, seed: int = 0) -> pd.DataFrame:
    """One row for each explanation: residual torque of the part not fitted, over joints of each
    kind.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for words, names in HANGING_MODELS.items():
        squares = []
        for j in range(len(found.seen.joints)):
            sizes = fit_sizes([found.seen], j, names, rng, samples=0) if names else None
            squares.append(rms(left(found.unseen, j, sizes)) ** 2)
        of_kind = np.sqrt(np.reshape(squares, (-1, 3)).mean(axis=0))
        row: dict[str, object] = {"explanation": words}
        rows.append(
            row
            | {f"{kind} [N m]": f"{x:.2f}" for kind, x in zip(JOINT_KINDS, of_kind, strict=True)}
        )
    return pd.DataFrame(rows)


def hanging_figure(times: RowTimes, joints: Sequence[str], found: Drives, seed: int = 0) -> Figure:
    """Figure: times of single rows, each joint's mean, and the residual torque before and after."""
    drawn, axes = new_figure(1, 3, (12.0, 4.2))
    heaps, means, torque = axes[0]
    above: Any = {
        "xycoords": ("data", "axes fraction"),
        "ha": "center",
        "va": "bottom",
        "fontsize": 8.0,
    }
    heaps.hist(
        1e3 * times.each[np.isfinite(times.each)], bins=np.arange(2.0, 7.01, 0.08), color=AFTER
    )
    tick = 1e3 * (times.short + times.long) / 5.0
    for count in (2, 3):
        heaps.axvline(count * tick, color=INK, linestyle=":", linewidth=1.2)
        heaps.annotate(f"{count} ticks", (count * tick, 1.0), **above)
    heaps.set_xlabel("time of a row by turn / rate [ms]")
    heaps.set_ylabel("rows")
    set_title(heaps, "rows come short and long, 2 : 3\n")
    where = np.arange(len(joints))
    half = 1e3 * np.abs(times.periods.T - times.period)
    means.errorbar(1e3 * times.period, where, xerr=half, fmt="o", color=AFTER, markersize=3.5)
    means.axvline(5.0, color=INK, linestyle="--", linewidth=1.2)
    means.annotate("nominal", (5.0, 1.0), **above)
    means.set_yticks(where, joints)
    means.invert_yaxis()
    means.set_xlabel("mean time of a row by turn / rate [ms]")
    set_title(means, "hips, thighs and calves disagree\n")
    rng = np.random.default_rng(seed)
    levels = []
    for j in range(len(joints)):
        chosen = select([found.seen], j, tuple(EFFECTS))
        sizes = fit_sizes([found.seen], j, chosen, rng, samples=0)
        levels.append((rms(left(found.unseen, j)), rms(left(found.unseen, j, sizes))))
    before, after = np.array(levels).T
    torque.barh(where - 0.2, before, 0.38, color=BEFORE, label="declared model")
    torque.barh(where + 0.2, after, 0.38, color=AFTER, label="with the effects found")
    torque.set_yticks(where, joints)
    torque.invert_yaxis()
    torque.set_xlabel("residual torque, last third [N m]")
    torque.legend(fontsize=8.0, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    set_title(torque, "torque by the motor law less the model's\n")
    return drawn
