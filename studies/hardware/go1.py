"""Study of a walking Go1 with motion capture: effects that the model of its legs lacks.

The reference has no time stamps of its own, so its lag relative to each stream is estimated first.
Then `trace` finds the missing effects, and the leg filter is run with and without them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from studies.hardware.drives import BLOCK, between, ratio_interval
from studies.hardware.stream_lags import WALKING, Lag
from surefoot import Learnt, Log, Robot, Trace, evaluate
from surefoot.extend import (
    Effect,
    Trajectory,
    align_first,
    block_bootstrap_counts,
    compensate_all,
    effect,
    joint_velocity,
    reference,
    stance_phase,
)
from surefoot.models.attribution.data import split_of
from surefoot.models.attribution.evidence import log_under_model, table_of
from surefoot.models.residuals.layout import layout_for
from surefoot.scenarios.reporting import AFTER, BEFORE, INK, METRICS, new_figure, set_title
from surefoot.scenarios.trace.filters import filtered

TENTHS = 10
MISSED = "#AA4499"
"""Colour of the model with effects that the trace did not find."""
STANCES = {"all of it": (0.0, 1.0), "10 to 90 %": (0.1, 0.9), "25 to 60 %": (0.25, 0.6)}
"""Parts of the stance in which the radius of the feet is estimated."""
SHOWN_METRICS = {k: v for k, v in METRICS.items() if k not in ("pi<gamma [%]", "NEES_att")}


def lags_table(found: Sequence[Lag]) -> pd.DataFrame:
    """One row for each stream: its lag and interval."""
    late = [between(1e3 * one.late, [1e3 * x for x in one.interval], 1) for one in found]
    return pd.DataFrame({"stream": [one.stream for one in found], "late by [ms]": late})


def stance_profile(log: Log, robot: Robot, effects: Sequence[Effect]) -> np.ndarray:
    """RMS speed (TENTHS, K) [m/s] over the ground of feet in stance while the robot walks, from
    legs and reference, by tenths of the stance and by leg.
    """
    log, robot = compensate_all(effects, log, robot)
    frame = log_under_model(log, robot).motion
    robot = replace(robot, foot_radius=np.maximum(robot.foot_radius, 0.0))
    standing = log.contact & log.ref_ok[:, None]
    v = robot.feet.imu_velocity(log.q, joint_velocity(log), log.gyro, frame.up_I, standing)
    square = np.sum((v - frame.v_I[:, None]) ** 2, axis=2)
    walks = np.linalg.norm(frame.v_I, axis=1) > WALKING
    out = np.full((TENTHS, log.contact.shape[1]), np.nan)
    for leg in range(log.contact.shape[1]):
        phase = stance_phase(log.contact[:, leg])
        for k in range(TENTHS):
            rows = walks & (phase >= k / TENTHS) & (phase < (k + 1) / TENTHS)
            rows &= np.isfinite(square[:, leg])
            out[k, leg] = np.sqrt(square[rows, leg].mean()) if rows.any() else np.nan
    return out


def shares_table(log: Log, robot: Robot, found: Trace, seed: int = 0) -> pd.DataFrame:
    """Share of the legs' velocity residual that each effect explains on the REPORT part."""
    rng = np.random.default_rng(seed)
    case = log_under_model(log, robot)
    late = split_of([case]).report
    block = np.floor(case.motion.t / BLOCK).astype(int)[late]
    velocity = layout_for(robot.limbs).channels["leg_velocity"]

    def squares(chosen: Sequence[Effect]) -> tuple[np.ndarray, np.ndarray]:
        left = table_of(case, chosen)[late][:, velocity] ** 2
        count = np.isfinite(left).sum(axis=1)
        total = np.nansum(left, axis=1)
        numbers = np.unique(block)
        return (
            np.array([total[block == b].sum() for b in numbers]),
            np.array([count[block == b].sum() for b in numbers]),
        )

    before, count = squares(())
    draws = block_bootstrap_counts(len(before), rng)
    rows = []
    for words, chosen in ladder(found.effects, robot, late_ends(found)):
        after, _ = squares(chosen)
        share = 100 * (1 - after.sum() / before.sum())
        spread = 100 * (1 - (draws @ after) / (draws @ before))
        level = np.sqrt(after.sum() / count.sum())
        rows.append(
            {
                "model": words,
                "leg velocity left [m/s]": f"{level:.4f}",
                "explained [% of squares]": between(share, np.percentile(spread, [2.5, 97.5]), 1),
            }
        )
    return pd.DataFrame(rows)


def rolling_table(log: Log, robot: Robot, seed: int = 0) -> pd.DataFrame:
    """Radius of the feet in parts of the stance, from the forward and the lateral velocity of the
    body, each by least squares over walking, with intervals from blocks.
    """
    rng = np.random.default_rng(seed)
    frame = log_under_model(log, robot).motion
    phase = np.column_stack([stance_phase(contact) for contact in log.contact.T])
    walks = (np.linalg.norm(frame.v_I, axis=1) > WALKING) & log.ref_ok
    dq, up = joint_velocity(log), frame.up_I

    def error(radius: float) -> np.ndarray:
        rolling = replace(robot, foot_radius=np.full(len(robot.foot_radius), radius))
        v = rolling.feet.imu_velocity(log.q, dq, log.gyro, up, log.contact & walks[:, None])
        return v - frame.v_I[:, None]

    point, slope = error(0.0), error(1.0) - error(0.0)
    block = np.floor((log.t - log.t[0]) / BLOCK).astype(int)
    rows = []
    for words, (begin, end) in STANCES.items():
        row = {"part of the stance": words}
        use = (phase >= begin) & (phase <= end) & np.isfinite(point).all(axis=2)
        for axis, name in enumerate(("forward", "lateral")):
            y, x = np.where(use, point[..., axis], 0.0), np.where(use, slope[..., axis], 0.0)
            sums = [np.bincount(block, values.sum(axis=1)) for values in (-x * y, x * x)]
            size = 1e3 * sums[0].sum() / sums[1].sum()
            interval = 1e3 * ratio_interval(sums[0], sums[1], rng)
            row[f"radius by {name} velocity [mm]"] = between(size, interval, 1)
        rows.append(row)
    return pd.DataFrame(rows)


def ladder(
    effects: Sequence[Effect], robot: Robot, uncertain: Sequence[Effect] = ()
) -> list[tuple[str, list[Effect]]]:
    """Sets of effects to compare: none, each alone, all, and those not found: feet with the
    radius of the model's file, and fitted effects that are `uncertain`.
    """
    steps: list[tuple[str, list[Effect]]] = [("as declared", [])]
    steps += [(f"{_named(e)} alone", [e]) for e in effects]
    steps += [("all of them", list(effects))] if len(effects) > 1 else []
    drawn = drawn_feet(effects, robot)
    steps += [(f"not found: {_named(e)}, as drawn", [e]) for e in drawn]
    steps += [(f"not found: {_named(e)}, as sized", [e]) for e in uncertain]
    return steps + ([("not found: both", [*drawn, *uncertain])] if drawn and uncertain else [])


def late_ends(found: Trace) -> list[Effect]:
    """The delay of contacts at lift-off as fitted in the last round of the search; none if it is
    among the effects found.
    """
    last = found.attribution.rounds[-1] if found.attribution else ()
    sized = [c.size for c in last if c.key == ("contact_delay", "liftoff")]
    return [effect("contact_delay", "liftoff", size) for size in sized if size > 0]


def drawn_feet(effects: Sequence[Effect], robot: Robot) -> list[Effect]:
    """The difference between the file's and the declared radius of the feet, as an effect; none if
    rolling is among the effects found.
    """
    missing = float(np.mean(Robot.load(robot.file).foot_radius - robot.foot_radius))
    if missing <= 0 or any(e.name == "foot_rolling" for e in effects):
        return []
    return [effect("foot_rolling", "all", missing)]


def _named(one: Effect) -> str:
    return f"{one.name.replace('_', ' ')} {one.target}, {one.value:+.4g} {one.unit}"


def leg_filter_table(
    log: Log, robot: Robot, found: Trace, shifts: Sequence[float], seed: int = 0
) -> pd.DataFrame:
    """Errors of the leg filter over the whole log: as declared, with each effect, with all, with
    sizes drawn from their intervals, and against a reference shifted by `shifts` [s].

    Args:
        log: the measured log.
        robot: as declared.
        found: trace of the log.
        shifts: of the reference [s].
        seed: of the drawn sizes.
    """
    rng = np.random.default_rng(seed)
    steps = ladder(found.effects, robot, late_ends(found))
    rows = [_judged(words, log, robot, chosen) for words, chosen in steps]
    if found.attribution is not None and found.effects:
        drawn = [
            _judged(
                "", log, robot, [_drawn(f.effect, f.interval, rng) for f in found.attribution.found]
            )
            for _ in range(30)
        ]
        for end, percent in (("lower", 2.5), ("upper", 97.5)):
            row: dict[str, str | float] = {
                "model": f"all, sizes drawn from their intervals, {end} end"
            }
            for key in SHOWN_METRICS:
                row[key] = float(np.percentile([float(one[key]) for one in drawn], percent))
            rows.append(row)
    for shift in shifts:
        moved = compensate_all([effect("reference_delay", "all", shift)], log, robot)[0]
        words = f"reference moved by {1e3 * shift:+.0f} ms"
        rows.append(_judged(f"as declared, {words}", moved, robot, []))
        rows.append(_judged(f"all of them, {words}", moved, robot, list(found.effects)))
    return pd.DataFrame(rows)


def _drawn(one: Effect, interval: tuple[float, float], rng: np.random.Generator) -> Effect:
    spread = (interval[1] - interval[0]) / (2 * 1.96)
    low, high = one.bounds
    return replace(one, value=float(np.clip(rng.normal(one.value, spread), low, high)))


def _judged(words: str, log: Log, robot: Robot, chosen: Sequence[Effect]) -> dict[str, str | float]:
    compensated, model = compensate_all(chosen, log, robot)
    m = evaluate(reference(log), filtered("leg", compensated, model, Learnt()))
    return {"model": words} | {name: getattr(m, metric) for name, metric in SHOWN_METRICS.items()}


def square_figure(log: Log, robot: Robot, found: Trace, late: Sequence[Lag]) -> Figure:
    """Figure: the walk from above, speeds of standing feet by tenths of the stance, and lags of
    streams.
    """
    drawn, axes = new_figure(1, 3, (12.0, 4.2))
    above, stance, times = axes[0]
    truth = reference(log)
    models: list[tuple[str, Sequence[Effect], str, str]] = [
        ("as declared", (), BEFORE, "--"),
        ("with what was found", found.effects, AFTER, "-"),
    ]
    if missed := [*drawn_feet(found.effects, robot), *late_ends(found)]:
        models.append(("with what was not", missed, MISSED, "-"))
    for words, chosen, color, line in models:
        path = align_first(truth, filtered("leg", *compensate_all(chosen, log, robot), Learnt()))
        above.plot(*_plan(path), line, color=color, label=f"leg filter, {words}")
    above.plot(*_plan(truth), color=INK, linewidth=2.0, label="motion capture")
    above.set_aspect("equal", adjustable="datalim")
    above.set_xlabel("x [m]")
    above.set_ylabel("y [m]")
    above.legend(fontsize=7.5, frameon=False, loc="center")
    set_title(above, "the walk from above")
    where = (np.arange(TENTHS) + 0.5) * 100 / TENTHS
    for words, chosen, color, line in models:
        speed = np.sqrt(np.nanmean(stance_profile(log, robot, chosen) ** 2, axis=1))
        stance.plot(where, speed, line, marker="o", markersize=3, color=color, label=words)
    stance.set_ylim(0.0, None)
    stance.set_xlabel("share of the stance that has passed [%]")
    stance.set_ylabel("speed of the foot [m/s]")
    stance.legend(fontsize=8.0, frameon=False)
    set_title(stance, "how fast 'standing' feet move")
    rows = np.arange(len(late))
    middle = 1e3 * np.array([one.late for one in late])
    half = np.abs(1e3 * np.array([one.interval for one in late]).T - middle)
    times.errorbar(middle, rows, xerr=half, fmt="o", color=AFTER)
    times.axvline(0.0, color=INK, linestyle=":", linewidth=1.2)
    times.set_yticks(rows, [one.stream.split(",")[0].replace(" ", "\n", 1) for one in late])
    times.set_ylim(len(late) - 0.5, -0.5)
    times.set_xlabel("late against motion capture [ms]")
    set_title(times, "do the clocks agree? (95 %)")
    return drawn


def _plan(path: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    return path.p_GI[:, 0], path.p_GI[:, 1]
