"""Walks whose logs have positions of the feet: clocks, streams, and accuracy of leg odometry.

Feet of closed chains need no leg model. Such a log shows the share by which standing feet move
further than the body: feet creep, a leg is compliant, or angles have another scale. One share is
fitted on the walks of one day and evaluated on those of the other days.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.models.alignment.alignment import Alignment, align, aligned_log
from surefoot.scenarios.estimate.run import run_filter
from surefoot.scenarios.estimate.settings import FilterSettings, NoiseSettings, StartSettings
from surefoot.scenarios.reporting.palette import AFTER, BEFORE, INK
from surefoot.scenarios.reporting.plotting import legend_below, new_figure, set_title
from surefoot.sim.importing.assemble import RawRecording
from surefoot.sim.log import Log
from surefoot.sim.log.derived import JOINT_WINDOW, derivative
from surefoot.sim.plausibility import check_log

DISPLACED_OVER = 1.0
"""Time over which displacements by legs and by the reference are compared [s]: some strides, whose
ripple cancels.
"""
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


def travel_share(logs: Sequence[Log]) -> float:
    """Share by which the displacement by standing legs exceeds the body's: least squares of
    horizontal displacements over DISPLACED_OVER seconds.
    """
    both = [_displacements(log) for log in logs]
    legs, body = (np.concatenate([one[k] for one in both]) for k in (0, 1))
    return 1.0 - float(np.sum(legs * body) / np.sum(legs**2))


def with_share(log: Log, share: float) -> Log:
    """The log with horizontal positions of the feet scaled down by a share, about their medians."""
    middle = np.median(log.foot_I, axis=0)
    feet_I = log.foot_I.copy()
    feet_I[..., :2] = middle[:, :2] + (1.0 - share) * (feet_I - middle)[..., :2]
    columns = {
        f"foot_{leg}_{axis}": feet_I[:, k, i]
        for k, leg in enumerate(log.legs)
        for i, axis in enumerate("xyz")
    }
    return replace(log, frame=log.frame.assign(**columns))


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
    """What is implausible in logs as recorded, with the map line that corrects it; equal findings
    of several logs share a row.
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
    walks: Mapping[str, AlignedWalk], logged: Mapping[str, Log], days: Mapping[str, Sequence[str]]
) -> pd.DataFrame:
    """One row for each model of the feet: the leg filter's end error [% of the path] on each walk,
    and on those to which the model's share was not fitted.

    Args:
        walks: by name.
        logged: the same with the robot's own contacts.
        days: names of the walks of each recording day.
    """
    cases: dict[str, tuple[float, Sequence[str]]] = {"contacts by the gait": (0.0, ())}
    for day, names in days.items():
        share = travel_share([walks[name].log for name in names])
        cases[f"and {100 * share:.1f} % less way, fitted on {day}"] = share, names
    rows = [_errors_row("contacts as logged", logged, 0.0, ())]
    aligned = {name: walk.log for name, walk in walks.items()}
    rows += [_errors_row(words, aligned, *case) for words, case in cases.items()]
    return pd.DataFrame(rows)


def paths_figure(walks: Mapping[str, AlignedWalk], share: float) -> Figure:
    """Figure: each walk from above, with the reference and the leg filter without and with the
    share.
    """
    drawn, axes = new_figure(1, len(walks), (2.4 * len(walks), 3.4))
    for ax, (name, walk) in zip(axes[0], walks.items(), strict=True):
        truth = reference(walk.log)
        forward = truth.p_GI[-1] - truth.p_GI[0]
        heading = np.arctan2(forward[1], forward[0])
        paths = {"motion capture": (truth.p_GI, INK)}
        for words, size, color in (
            ("leg filter", 0.0, BEFORE),
            ("leg filter, way shortened by the fitted share", share, AFTER),
        ):
            log = with_share(walk.log, size)
            paths[words] = run_filter("leg", log, None, None, SETTINGS).trajectory.p_GI, color
        for words, (p, color) in paths.items():
            x, y = (p - p[0])[:, :2].T
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


def _errors_row(
    words: str, logs: Mapping[str, Log], share: float, fitted: Sequence[str]
) -> dict[str, str]:
    errors = {}
    for name, log in logs.items():
        found = run_filter("leg", with_share(log, share), None, None, SETTINGS)
        errors[name] = end_error(log, found.trajectory)
    unseen = [error for name, error in errors.items() if name not in fitted]
    return {
        "feet": words,
        "mean of unseen walks [%]": f"{np.mean(unseen):.1f}",
        "worst of unseen walks [%]": f"{np.max(unseen):.1f}",
        **{f"{name} [%]": f"{error:.1f}" for name, error in errors.items()},
    }


def _displacements(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal displacements (K, 2) [m] over DISPLACED_OVER seconds, by standing legs and by the
    reference.
    """
    t, feet_I = log.t, log.foot_I
    dfeet_I = derivative(t, feet_I.reshape(len(t), -1), JOINT_WINDOW, causal=False)
    v_I = -(dfeet_I.reshape(feet_I.shape) + np.cross(log.gyro[:, None], feet_I))
    stands = log.contact[..., None]
    mean_I = np.sum(np.where(stands, v_I, 0.0), axis=1) / np.maximum(stands.sum(axis=1), 1)
    went = np.cumsum(np.einsum("nij,nj->ni", log.ref_R_GI, mean_I) * np.gradient(t)[:, None], 0)
    starts = np.arange(t[0], t[-1] - DISPLACED_OVER, DISPLACED_OVER)

    def gained(x: np.ndarray) -> np.ndarray:
        return np.column_stack(
            [np.interp(starts + DISPLACED_OVER, t, y) - np.interp(starts, t, y) for y in x.T[:2]]
        )

    return gained(went), gained(log.ref_p)
