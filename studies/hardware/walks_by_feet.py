"""Walks whose logs have positions of the feet: clocks, streams, and accuracy of leg odometry.

Feet of closed chains need no leg model. Such a log shows how much further standing feet move than
the body. A model of their creep has one size for all walks, which is fitted on the walks of one day
and evaluated on those of the other days.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from surefoot import (
    Alignment,
    FilterSettings,
    Log,
    NoiseSettings,
    RawRecording,
    StartSettings,
    align,
    aligned_log,
    check_log,
    run_filter,
)
from surefoot.extend import Effect, Trajectory, compensate_all, machine_for_log, reference
from surefoot.scenarios.reporting import AFTER, BEFORE, INK, legend_below, new_figure, set_title

PATH_STEP = 0.5
"""Sampling time of the reference for the length of a path [s]; at shorter times its noise adds to
it.
"""
SETTINGS = FilterSettings(
    noise=NoiseSettings(contact=0.05, kinematics=5e-3, accel=0.5),
    start=StartSettings(b_a=0.3, b_g=2e-2),
)
"""Settings for a walk with servo motors: creeping feet, readings at 60 Hz, an uncalibrated IMU."""


@dataclass(frozen=True)
class AlignedWalk:
    """A walk on its IMU's clock: the log with contacts from its gait, and its alignment."""

    log: Log
    alignment: Alignment


def aligned_walk(recording: RawRecording) -> AlignedWalk:
    """Align a recording whose reference has its own clock and axes.

    Raises SurefootError if it has no reference, or IMU and reference overlap too little.
    """
    log = recording.without_reference().log()
    found = align(log, recording.poses)
    return AlignedWalk(aligned_log(log, found, recording.poses), found)


def end_error(log: Log, estimate: Trajectory) -> float:
    """Horizontal error at the end [% of the path], with position and yaw aligned at the start."""
    truth = reference(log)
    p_GI = np.column_stack([np.interp(estimate.t, truth.t, x) for x in truth.p_GI.T])
    turn = truth.R_GI[0] @ estimate.R_GI[0].T
    yaw = np.arctan2(turn[1, 0], turn[0, 0])
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    went = (estimate.p_GI[-1] - estimate.p_GI[0])[:2]
    missed = R @ went - (p_GI[-1] - p_GI[0])[:2]
    at = np.arange(truth.t[0], truth.t[-1], PATH_STEP)
    path = np.column_stack([np.interp(at, truth.t, x) for x in truth.p_GI.T])
    length = np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1))
    return 100.0 * float(np.linalg.norm(missed) / length)


def alignment_table(walks: Mapping[str, AlignedWalk]) -> pd.DataFrame:
    """One row for each walk: clock offset from the whole log and from each half, and position of
    the tracked body.
    """
    rows = []
    for name, walk in walks.items():
        one = walk.alignment
        first, second = 1e3 * (one.halves - one.offset)
        rows.append(
            {
                "walk": name,
                "clock [s]": f"{one.offset:.4f} ± {one.offset_half_width:.4f}",
                "halves off it [ms]": f"{first:.1f}, {second:.1f}",
                "halves apart [ms]": f"{abs(second - first):.1f}",
                "tracked point in I [mm]": ", ".join(f"{1e3 * x:.0f}" for x in one.p_IM),
                "turning that is not the body's [%]": f"{100 * one.turn_missed:.1f}",
                "gyro bias [mrad/s]": ", ".join(f"{1e3 * x:.1f}" for x in one.bias_gyro),
            }
        )
    return pd.DataFrame(rows)


def findings_table(logs: Sequence[Log]) -> pd.DataFrame:
    """Implausible data in logs as recorded, with the map line that corrects it; equal findings in
    several logs share a row.
    """
    seen: dict[tuple[str, str, str], dict[str, None]] = {}
    for log in logs:
        for one in check_log(log):
            streams = one.line.split(":")[0]
            seen.setdefault((streams, one.cause, one.map_line), {})[log.name] = None
    return pd.DataFrame(
        {"streams": streams, "finding": cause, "in the map": line, "logs": ", ".join(names)}
        for (streams, cause, line), names in seen.items()
    )


def end_errors_table(
    walks: Mapping[str, AlignedWalk],
    logged: Mapping[str, Log],
    found: Mapping[str, tuple[Sequence[str], Effect]],
) -> pd.DataFrame:
    """One row for each model of the feet: the leg filter's end error [% of the path] on each walk,
    and on those to which the model was not fitted.

    Args:
        walks: by name.
        logged: the same with the robot's own contacts.
        found: words -> the walks that an effect of the feet was found in, and the effect.
    """
    aligned = {name: walk.log for name, walk in walks.items()}
    rows = [
        _errors_row("contacts as logged", logged, None, ()),
        _errors_row("contacts by the gait", aligned, None, ()),
    ]
    for words, (names, one) in found.items():
        size = f"{one.name} of {one.value:.3f} {one.unit}, found on {words}"
        rows.append(_errors_row(f"and {size}", aligned, one, names))
    return pd.DataFrame(rows)


def paths_figure(walks: Mapping[str, AlignedWalk], one: Effect) -> Figure:
    """Figure: each walk from above, with the reference and the leg filter without and with an
    effect of the feet.
    """
    drawn, axes = new_figure(1, len(walks), (2.4 * len(walks), 3.4))
    for ax, (name, walk) in zip(axes[0], walks.items(), strict=True):
        truth = reference(walk.log)
        forward = truth.p_GI[-1] - truth.p_GI[0]
        heading = np.arctan2(forward[1], forward[0])
        paths = {
            "motion capture": (truth, INK),
            "leg filter": (leg_path(walk.log, None), BEFORE),
            f"leg filter with {one.name}": (leg_path(walk.log, one), AFTER),
        }
        for words, (path, color) in paths.items():
            x, y = (path.p_GI - path.p_GI[0])[:, :2].T
            along = np.cos(heading) * x + np.sin(heading) * y
            aside = np.sin(heading) * x - np.cos(heading) * y
            style = "--" if color == BEFORE else "-"
            ax.plot(aside, along, style, color=color, label=words)
        ax.set_aspect("equal", "datalim")
        ax.set_xlabel("to its right [m]")
        set_title(ax, name, 9.0)
    axes[0, 0].set_ylabel("along the walk [m]")
    legend_below(drawn, axes[0, 0], 3)
    return drawn


def leg_path(log: Log, one: Effect | None) -> Trajectory:
    """The leg filter's estimate of a log, with an effect compensated."""
    log, _ = compensate_all([one] if one else [], log, machine_for_log(log))
    return run_filter("leg", log, None, None, SETTINGS).trajectory


def _errors_row(
    words: str, logs: Mapping[str, Log], one: Effect | None, fitted: Sequence[str]
) -> dict[str, str]:
    errors = {name: end_error(log, leg_path(log, one)) for name, log in logs.items()}
    unseen = [error for name, error in errors.items() if name not in fitted]
    return {
        "feet": words,
        "mean of unseen walks [%]": f"{np.mean(unseen):.1f}",
        "worst of unseen walks [%]": f"{np.max(unseen):.1f}",
        **{f"{name} [%]": f"{error:.1f}" for name, error in errors.items()},
    }
