"""The loop as files: one before-and-after table, a report, and a recording with both."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.models.observer.predict import prediction_errors
from surefoot.scenarios.estimate.compare import Comparison
from surefoot.scenarios.estimate.error_series import error_series
from surefoot.scenarios.estimate.estimators import traits
from surefoot.scenarios.estimate.run import Learnt, declared_model
from surefoot.scenarios.reporting.figures import height_figure, trajectories, velocity_figure
from surefoot.scenarios.reporting.html import Picture, Section, write_report
from surefoot.scenarios.reporting.tables import to_csv, to_markdown
from surefoot.scenarios.trace.words import caution
from surefoot.scenarios.viewer.recording import write_recording
from surefoot.sim.common.files import whole_file
from surefoot.sim.effects import Effect
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

LOOP_METRICS = {
    "ape_trans": "APE_trans [m]",
    "ape_rot": "APE_rot [deg]",
    "rpe_trans": "RPE_trans [m]",
    "nees_position": "NEES_pos",
    "nees_velocity": "NEES_vel",
}


@dataclass(frozen=True)
class Side:
    """One of the two worlds: its model's effects, what was learnt in it, and the estimates."""

    name: str
    effects: tuple[Effect, ...]
    learnt: Learnt
    comparison: Comparison


def write_loop(log: Log, robot: Robot, sides: Sequence[Side], out: Path) -> pd.DataFrame:
    """Write table.md, table.csv, loop.json, report.html and loop.rrd; returns the table."""
    table = pd.DataFrame(_rows(sides))
    for name, text in (("table.md", to_markdown(table) + "\n"), ("table.csv", to_csv(table))):
        with whole_file(out / name, True) as path:
            path.write_text(text, encoding="utf-8")
    found = json.loads((out / "trace" / "trace.json").read_text(encoding="utf-8"))
    rmse = {side.name: observer_rmse(side) for side in sides}
    summary = {"trace": found, "sides": {s.name: _summary(s, rmse[s.name]) for s in sides}}
    with whole_file(out / "loop.json", True) as path:
        path.write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    shown = _trajectories(sides)
    last = sides[-1].comparison
    seen = (last.prediction, last.bounds)
    write_recording(out / "loop.rrd", log, robot, shown, *seen, force=True)
    sections = [
        Section("Before and after", _prose(found, sides, rmse), table),
        *_of_trace(found),
        *_pictures(log, sides, shown),
    ]
    write_report(
        out / "report.html", "The loop: what the model lacked, put into it", sections, True
    )
    return table


def _of_trace(found: dict[str, Any]) -> list[Section]:
    """What a trace.json says of its channels, as sections of the loop's report."""
    words = "".join(f"Since {why}.\n\n" for why in found["reasons"])
    words += "On the end of the log, which no fit has seen. All of the trace: trace/report.html."
    parts = [("The trace: residuals", words, found["channels"])]
    if held_out := found.get("holdout"):
        words = "".join(f"{one}.\n\n" for one in held_out["against"])
        words += "Logs of which no fit has seen anything."
        parts.append(("The trace: held-out logs", words, held_out["channels"]))
    return [Section(title, prose, _channel_rows(c)) for title, prose, c in parts if c]


def _channel_rows(channels: dict[str, Any]) -> list[dict[str, Any]]:
    return [
        {
            "channel": name,
            "before": c["before"],
            "after": c["after"],
            "noise floor": c["noise_floor"],
            "unit": c["unit"],
        }
        for name, c in channels.items()
    ]


def _rows(sides: Sequence[Side]) -> list[dict[str, Any]]:
    filters = dict.fromkeys(r.filter for side in sides for r in side.comparison.results)
    rows = []
    for name in filters:
        row: dict[str, Any] = {"filter": name}
        for key, heading in LOOP_METRICS.items():
            for side in sides:
                metrics = _metrics(side.comparison, name)
                row[f"{heading} {side.name}"] = getattr(metrics, key) if metrics else None
        for side in sides:
            held = side.comparison.held.get(name)
            row[f"coverage [%] {side.name}"] = 100 * held.joint if held else None
        rows.append(row)
    return rows


def _metrics(comparison: Comparison, name: str):
    return next((r.metrics for r in comparison.results if r.filter == name), None)


def _summary(side: Side, rmse: dict[str, list[float]]) -> dict[str, Any]:
    filters = {
        r.filter: {key: float(getattr(r.metrics, key)) for key in LOOP_METRICS}
        for r in side.comparison.results
        if r.metrics is not None
    }
    return {
        "effects": [e.as_dict() for e in side.effects],
        "observer_rmse": rmse,
        "coverage": {name: held.joint for name, held in side.comparison.held.items()},
        "filters": filters,
    }


def observer_rmse(side: Side) -> dict[str, list[float]]:
    """RMSE (3,) [m/s] on the measured log of each observer of the side, by its loss."""
    log, robot = declared_model(side.comparison.log, side.comparison.robot)
    rmse = {}
    for observer in side.learnt.observers:
        errors = prediction_errors(observer, log, robot)[1]
        rmse[observer.loss] = [float(x) for x in (errors**2).mean(axis=0) ** 0.5]
    return rmse


def _trajectories(sides: Sequence[Side]) -> dict[str, Trajectory]:
    return {
        f"{r.filter} {side.name}": r.trajectory
        for side in sides
        for r in side.comparison.results
        if (own := traits(r.filter)).drawn and not own.variant
    }


def _prose(
    found: dict[str, Any], sides: Sequence[Side], rmse: dict[str, dict[str, list[float]]]
) -> str:
    form = "{name} of {target}, {value:.4g} {unit}"
    zeros = [one for run in found["runs"] for one in run if one["compensated"]]
    added = [form.format(**effect) for effect in (*found["effects"], *zeros)]
    text = f"The trace's verdict: {found['verdict']}. "
    text += f"Put into the simulation: {'; '.join(added)}." if added else "Nothing to add."
    if warned := caution(found):
        text += f"\n\n{warned[0].upper()}{warned[1:]}."
    text += (
        "\n\nObservers are trained and calibrated in simulation alone, on walks in the style of "
        "the measured one; the coverage column is the share of the measured errors within the "
        "bounds, and the level asked for holds only as far as the simulation is like the robot."
    )
    for side in sides:
        for loss, (x, y, z) in rmse[side.name].items():
            text += (
                f"\n\n{side.name}: the {loss} observer errs by {x:.3f}, {y:.3f}, {z:.3f} m/s "
                "(root mean square; forward, lateral, vertical)."
            )
        for name, why in side.comparison.left_out.items():
            text += f"\n\n{side.name}: {name} was left out ({why})."
    return text


def _pictures(log: Log, sides: Sequence[Side], shown: dict[str, Trajectory]) -> list[Section]:
    truth = reference(log)
    errors = {name: error_series(truth, t, 20.0) for name, t in shown.items()}
    paths = (
        Picture(trajectories(log, errors), "The walk from above, aligned at the start."),
        Picture(height_figure(log, errors), "Height over time: nothing on board sees it."),
    )
    sections = [Section("Where each estimate went", pictures=paths)]
    for side in sides:
        seen, bounds = side.comparison.prediction, side.comparison.bounds
        robot = side.comparison.robot
        if seen is None or bounds is None or robot is None:
            continue
        epsilon = bounds.epsilon_at(robot.R_BI)
        picture = Picture(
            velocity_figure(log, seen, epsilon),
            "Body velocity: the observer's prediction, its bounds, and the reference.",
        )
        sections.append(Section(f"The observer, {side.name}", pictures=(picture,)))
    return sections
