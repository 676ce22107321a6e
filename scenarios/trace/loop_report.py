"""Output files of `surefoot loop`: tables, a report, a page of results and a recording."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.models.calibration.empirical_coverage import bounded_errors, coverage
from surefoot.models.observer.predict import judged, predict
from surefoot.scenarios.compare import Comparison, velocity_pictures
from surefoot.scenarios.estimate.error_series import NAMED_AXES, error_series
from surefoot.scenarios.estimate.estimators import traits
from surefoot.scenarios.estimate.run import Learnt
from surefoot.scenarios.reporting.figures import height_figure, trajectories
from surefoot.scenarios.reporting.html import Picture, Section, markdown_report
from surefoot.scenarios.reporting.pages import origin_of, write_page, write_results
from surefoot.scenarios.reporting.tables import METRICS
from surefoot.scenarios.settings import LoopSettings
from surefoot.scenarios.trace.report import caution
from surefoot.scenarios.viewer.recording import RecordedWalk, write_recording
from surefoot.sim.common.files import write_whole
from surefoot.sim.effects import Effect
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.walking.imitation import moving

LOOP_TITLE = "The loop: what the model lacked, put into it"
_MODULE = "surefoot.scenarios.trace.loop"
LOOP_METRICS = {
    name: METRICS[name]
    for name in ("APE_trans [m]", "APE_rot [deg]", "RPE_trans [m]", "NEES_pos", "NEES_vel")
}
STEP_WORDS = {
    "before": "the robot as declared",
    "after": "with the effects that were found",
    "tuned": "with observers trained further on the walk's other end, and bounds from its middle",
}


@dataclass(frozen=True)
class LoopStep:
    """One step of the loop, and the estimates of both ends of the measured log with it.

    Attributes:
        name: "before", "after" or "tuned".
        effects: of the model.
        learnt: observers and bounds, for each end.
        ends: every filter on the first and on the last end.
    """

    name: str
    effects: tuple[Effect, ...]
    learnt: tuple[Learnt, ...]
    ends: tuple[Comparison, ...]


def write_loop(
    log: Log, robot: Robot, steps: Sequence[LoopStep], settings: LoopSettings, reason: str = ""
) -> str:
    """Write table.md, tables (.csv), loop.json, report.html, loop.rrd and any page; returns the
    findings as text.

    Args:
        log: the measured log.
        robot: as declared.
        steps: `before` first.
        settings: where to.
        reason: why an observer is missing; "" if none is.
    """
    out = settings.out
    table, observers = pd.DataFrame(_rows(steps)), pd.DataFrame(_observers(steps))
    found = json.loads((out / "trace" / "trace.json").read_text(encoding="utf-8"))
    values = {"trace": found, "missing": reason, "steps": {s.name: _values(s) for s in steps}}
    values["observers"] = observers.to_dict("records")
    write_whole(out / "loop.json", json.dumps(values, indent=2) + "\n", force=True)
    last = steps[-1].ends[-1]
    drawn = {
        f"{r.filter} {step.name}": r.trajectory
        for step in (steps[0], steps[-1])
        for r in step.ends[-1].results
        if (known := traits(r.filter)).drawn and not known.variant
    }
    # Of the log as it was measured, the rows that were estimated.
    shown = log.rows(np.flatnonzero(log.t >= last.log.t[0]))
    walk = RecordedWalk(shown, robot, drawn, last.prediction, last.bounds)
    write_recording(out / "loop.rrd", walk, force=True)
    missing = f"Observers are missing: {reason}." if reason else ""
    findings = loop_findings(found, table, [step.name for step in steps])
    words = " ".join(filter(None, (findings, _distrusted(steps), missing)))
    because = " ".join(f"Because {why}." for why in found["reasons"])
    sections = [
        Section("Findings", words, table.filter(regex="^(filter|APE_trans|NEES_pos)")),
        *_pictures(shown, steps, drawn),
        Section("Method", _method(steps)),
        Section("Errors of every filter", "", table, file="table"),
        *_of_observers(observers),
        Section("The trace", f"{because} The full report is trace/report.html.".strip()),
    ]
    write_results(out, LOOP_TITLE, sections, force=True)
    if settings.page:
        write_page(settings.page, LOOP_TITLE, sections, origin_of(_MODULE, "surefoot loop"))
    return markdown_report(LOOP_TITLE, sections[:1])


def _rows(steps: Sequence[LoopStep]) -> list[dict[str, Any]]:
    """Errors of each filter in each step, means of both ends."""
    filters = dict.fromkeys(r.filter for step in steps for r in step.ends[0].results)
    rows = []
    for name in filters:
        row: dict[str, Any] = {"filter": name}
        for heading, key in LOOP_METRICS.items():
            for step in steps:
                row[f"{heading} {step.name}"] = _mean(step, name, key)
        for step in steps:
            held = [100 * end.held[name].joint for end in step.ends if name in end.held]
            row[f"coverage [%] {step.name}"] = np.mean(held) if held else None
        rows.append(row)
    return rows


def _distrusted(steps: Sequence[LoopStep]) -> str:
    """A sentence: which filters say in which step, on either end, that they are not to be trusted;
    "" if none does.
    """
    lost = {
        step.name: dict.fromkeys(r.filter for e in step.ends for r in e.results if r.health.lost)
        for step in steps
    }
    said = [f"{', '.join(found)} ({name})" for name, found in lost.items() if found]
    return f"By their own record not to be trusted are: {'; '.join(said)}." if said else ""


def _mean(step: LoopStep, name: str, key: str) -> float | None:
    """Mean of a metric of a filter over both ends; None unless it ran on both."""
    found = [
        getattr(r.metrics, key)
        for end in step.ends
        for r in end.results
        if r.filter == name and r.metrics is not None
    ]
    return float(np.mean(found)) if len(found) == len(step.ends) else None


def _values(step: LoopStep) -> dict[str, Any]:
    names = dict.fromkeys(r.filter for r in step.ends[0].results)
    return {
        "effects": [e.as_dict() for e in step.effects],
        "filters": {
            name: {key: _mean(step, name, key) for key in LOOP_METRICS.values()} for name in names
        },
    }


def _observers(steps: Sequence[LoopStep]) -> list[dict[str, Any]]:
    """Errors of each step's observers over both ends while the robot moves, and the share of all
    errors within their bounds.
    """
    rows = []
    for step in steps:
        for k, observer in enumerate(step.learnt[0].observers):
            errors, inside = [], []
            for learnt, end in zip(step.learnt, step.ends, strict=True):
                assert end.robot is not None
                seen = predict(learnt.observers[k], end.log, end.robot)
                at, of_all, _ = judged(seen, end.log)
                errors.append(of_all[moving(end.log)[at]])
                bounds = learnt.bounds[k]
                _, bounded = bounded_errors(seen, bounds, end.log, end.robot.R_BI)
                inside.append(100 * coverage(bounded, bounds).joint)
            rmse = np.sqrt((np.concatenate(errors) ** 2).mean(axis=0))
            row: dict[str, Any] = {"step": step.name, "loss": observer.loss}
            names = [f"{axis} [m/s]" for _, axis in NAMED_AXES]
            row |= dict(zip(names, rmse.tolist(), strict=True))
            row["norm [m/s]"] = float(np.linalg.norm(rmse))
            rows.append(row | {"bounds hold [%]": float(np.mean(inside))})
    return rows


def _of_observers(observers: pd.DataFrame) -> list[Section]:
    words = (
        "Errors on the measured log while the robot moves (root mean square over both ends), and "
        "the share of all errors within the bounds, mean of both ends."
    )
    return [] if observers.empty else [Section("Observers", words, observers, file="observers")]


def loop_findings(found: dict[str, Any], table: pd.DataFrame, steps: Sequence[str]) -> str:
    """Sentences: which filters gain in each step, what was added, and the best filter.

    Args:
        found: contents of trace.json.
        table: errors of every filter in every step.
        steps: their names, `before` first.
    """
    ranked = table[[not traits(name).floor for name in table["filter"]]].set_index("filter")
    errors: dict[str, dict[str, float]] = {}
    for step in steps:
        known = ranked[f"APE_trans [m] {step}"].dropna()
        errors[step] = dict(zip(known.index, known, strict=True))
    main = "Whether the loop helps is not known: there is one step only."
    if len(steps) > 1:
        main = " ".join(_gain(*one, errors) for one in pairwise(steps))
    best = [
        f"`{min(e, key=e.__getitem__)}` {step} ({min(e.values()):.3f} m)"
        for step, e in errors.items()
        if e
    ]
    rest = [f"The lowest errors are those of {', '.join(best)}."] if best else []
    form = "{name} of {target}, {value:.4g} {unit}"
    zeros = [one for run in found["runs"] for one in run if one["compensated"]]
    added = [form.format(**effect) for effect in (*found["effects"], *zeros)]
    rest.append(f"Added were: {'; '.join(added)}." if added else "Nothing was added.")
    if warned := caution(found):
        rest.append(f"{warned[0].upper()}{warned[1:]}.")
    return f"{main}\n\n{' '.join(rest)}"


def _gain(former: str, step: str, errors: dict[str, dict[str, float]]) -> str:
    """Which filters have a lower position error in a step than in the one before it."""
    both = [name for name in errors[step] if name in errors[former]]
    if step == "tuned":  # changes nothing for filters without observers
        both = [name for name in both if errors[step][name] != errors[former][name]]
    better = [name for name in both if errors[step][name] < errors[former][name]]
    worse = [name for name in both if name not in better]
    return (
        f"{step.capitalize()}, {STEP_WORDS[step]}, {len(better)} of {len(both)} filters have a "
        f"lower position error on the measured walk than {former}"
        f"{': ' if better else ''}{', '.join(better)}. Not lower: {', '.join(worse) or 'none'}."
    )


def _method(steps: Sequence[LoopStep]) -> str:
    left_out = {
        f"{name} ({why})": None
        for step in steps
        for end in step.ends
        for name, why in end.left_out.items()
    }
    text = (
        "Observers are trained and calibrated on drawn walks of the simulated robot, each with "
        "sizes drawn from the intervals of those found. Errors are means over both ends of the "
        f"measured walk. {'; '.join(f'{one.name}: {STEP_WORDS[one.name]}' for one in steps)}."
    )
    return text + (f"\n\nLeft out: {'; '.join(left_out)}." if left_out else "")


def _pictures(log: Log, steps: Sequence[LoopStep], drawn: dict[str, Trajectory]) -> list[Section]:
    """Of the last end of the measured log."""
    truth = reference(log)
    errors = {name: error_series(truth, t, 20.0) for name, t in drawn.items()}
    paths = (
        Picture(trajectories(log, errors), "The last part of the walk, aligned at its start."),
        Picture(height_figure(log, errors), "Height over time; no sensor measures it."),
    )
    return [
        Section("Paths of the estimates", pictures=paths),
        *(
            Section(f"The observer, {step.name}", pictures=tuple(shown))
            for step in steps
            if (shown := velocity_pictures(step.ends[-1]))
        ),
    ]
