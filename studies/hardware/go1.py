"""Study of a walking Go1 with motion capture: effects that the model of its legs lacks.

`trace` finds the missing effects, and the leg filter is run with and without them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

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
from surefoot.models.attribution.evidence import log_under_model
from surefoot.scenarios.reporting import AFTER, BEFORE, INK, METRICS, new_figure, set_title
from surefoot.scenarios.trace.filters import filtered

BLOCK = 2.0
"""Length of the blocks of the bootstrap [s], whose errors are nearly independent."""
WALKING = 0.15
"""Speed of the base from which a row counts as walking [m/s]."""
TENTHS = 10
MISSED = "#AA4499"
"""Colour of the model with effects that the trace did not find."""
STANCES = {"all of it": (0.0, 1.0), "10 to 90 %": (0.1, 0.9), "25 to 60 %": (0.25, 0.6)}
"""Parts of the stance in which the radius of the feet is estimated."""
SHOWN_METRICS = {k: v for k, v in METRICS.items() if k not in ("pi<gamma [%]", "NEES_att")}


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
            interval = 1e3 * _ratio_interval(sums[0], sums[1], rng)
            row[f"radius by {name} velocity [mm]"] = _between(size, interval)
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


def leg_filter_table(log: Log, robot: Robot, found: Trace, shifts: Sequence[float]) -> pd.DataFrame:
    """Errors of the leg filter over the whole log: as declared, with each effect, with all, and
    against a reference shifted by `shifts` [s].
    """
    steps = ladder(found.effects, robot, late_ends(found))
    rows = [_judged(words, log, robot, chosen) for words, chosen in steps]
    for shift in shifts:
        moved = compensate_all([effect("reference_delay", "all", shift)], log, robot)[0]
        words = f"reference moved by {1e3 * shift:+.0f} ms"
        rows.append(_judged(f"as declared, {words}", moved, robot, []))
        rows.append(_judged(f"all of them, {words}", moved, robot, list(found.effects)))
    return pd.DataFrame(rows)


def _judged(words: str, log: Log, robot: Robot, chosen: Sequence[Effect]) -> dict[str, str | float]:
    compensated, model = compensate_all(chosen, log, robot)
    m = evaluate(reference(log), filtered("leg", compensated, model, Learnt()))
    return {"model": words} | {name: getattr(m, metric) for name, metric in SHOWN_METRICS.items()}


def square_figure(log: Log, robot: Robot, found: Trace) -> Figure:
    """Figure: the walk from above, and speeds of standing feet by tenths of the stance."""
    drawn, axes = new_figure(1, 2, (9.0, 4.2))
    above, stance = axes[0]
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
    return drawn


def _plan(path: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    return path.p_GI[:, 0], path.p_GI[:, 1]


def _ratio_interval(top: np.ndarray, bottom: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """95 % interval (2,) of sum(top) / sum(bottom) over blocks (B,), by bootstrap."""
    draws = block_bootstrap_counts(len(top), rng)
    return np.percentile((draws @ top) / (draws @ bottom), [2.5, 97.5])


def _between(value: float, interval: Sequence[float] | np.ndarray) -> str:
    """'12.0 (11.0 – 13.0)'."""
    low, high = interval
    return f"{value:.1f} ({low:.1f} – {high:.1f})"
