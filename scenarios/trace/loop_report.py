"""Output files of `surefoot loop`: tables, a report, a page of results and a recording."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd

from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.models.calibration.empirical_coverage import bounded_errors, coverage
from surefoot.models.calibration.regions import BoundsError
from surefoot.models.observer.predict import predict
from surefoot.scenarios.compare import Comparison, velocity_pictures
from surefoot.scenarios.estimate.error_series import error_series
from surefoot.scenarios.estimate.estimators import traits
from surefoot.scenarios.estimate.run import Learnt
from surefoot.scenarios.reporting.figures import height_figure, trajectories
from surefoot.scenarios.reporting.html import Picture, Section, markdown_report
from surefoot.scenarios.reporting.pages import origin_of, write_page, write_results
from surefoot.scenarios.reporting.tables import METRICS
from surefoot.scenarios.settings import LoopSettings
from surefoot.scenarios.trace.observer_errors import (
    ERROR_PARTS,
    ErrorParts,
    TunedErrors,
    excess,
    parts_table,
    recalibrated,
)
from surefoot.scenarios.trace.realism import GaitChoice
from surefoot.scenarios.trace.report import caution, channel_row
from surefoot.scenarios.viewer.recording import RecordedWalk, write_recording
from surefoot.sim.common.files import write_whole
from surefoot.sim.effects import Effect
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

LOOP_TITLE = "The loop: what the model lacked, put into it"
_MODULE = "surefoot.scenarios.trace.loop"
LOOP_METRICS = {
    name: METRICS[name]
    for name in ("APE_trans [m]", "APE_rot [deg]", "RPE_trans [m]", "NEES_pos", "NEES_vel")
}

WORLD_WORDS = {
    "before": "the robot as declared, in the plain gait",
    "effects": "with the effects that were found",
    "after": "with the effects that were found, in the gait that is more like the log's",
}


@dataclass(frozen=True)
class LoopWorld:
    """One simulated world of the loop, and the estimates of the measured log with its observers.

    Attributes:
        name: "before", "effects" or "after".
        effects: of the simulated robot.
        learnt: observers and bounds from its walks.
        comparison: every filter on the measured log.
        simulated: parts of the observer's errors on a simulated walk not used for training; None
            where no observer is trained.
        measured: the same on the measured walk.
    """

    name: str
    effects: tuple[Effect, ...]
    learnt: Learnt
    comparison: Comparison
    simulated: ErrorParts | None
    measured: ErrorParts | None


def write_loop(
    log: Log,
    robot: Robot,
    worlds: Sequence[LoopWorld],
    settings: LoopSettings,
    gait: GaitChoice,
    tuned: TunedErrors | str,
) -> str:
    """Write table.md, tables (.csv), loop.json, report.html, loop.rrd and any page; returns the
    findings as text.

    Args:
        log: the measured log.
        robot: as declared.
        worlds: `before` first.
        settings: where to.
        gait: of the last world's walks, and the reason for it.
        tuned: errors of the last world's observer, tuned on the measured walk, or why there are
            none.
    """
    out = settings.out
    table = pd.DataFrame(_rows(worlds))
    found = json.loads((out / "trace" / "trace.json").read_text(encoding="utf-8"))
    summary = {
        "trace": found,
        "gait": gait.words,
        "tuned_on_measured": tuned if isinstance(tuned, str) else asdict(tuned),
        "worlds": {world.name: _summary(world) for world in worlds},
    }
    write_whole(out / "loop.json", json.dumps(summary, indent=2) + "\n", force=True)
    drawn = _trajectories(worlds)
    last = worlds[-1].comparison
    walk = RecordedWalk(log, robot, drawn, last.prediction, last.bounds)
    write_recording(out / "loop.rrd", walk, force=True)
    findings = loop_findings(found, table, [world.name for world in worlds])
    shown = table.filter(regex="^(filter|APE_trans|NEES_pos)")
    sections = [
        Section("Findings", f"{findings} {observer_gain(worlds, tuned)}".strip(), shown),
        *_pictures(log, worlds, drawn),
        Section("Method", _method(worlds)),
        Section("Errors of every filter", "", table, file="table"),
        *_of_observers(worlds, tuned),
        Section("Gait", gait.words, gait.rows or None, file="gait" if gait.rows else ""),
        *_of_trace(found),
    ]
    write_results(out, LOOP_TITLE, sections, force=True)
    if settings.page:
        write_page(settings.page, LOOP_TITLE, sections, origin_of(_MODULE, "surefoot loop"))
    return markdown_report(LOOP_TITLE, sections[:1])


def _of_observers(worlds: Sequence[LoopWorld], tuned: TunedErrors | str) -> list[Section]:
    """Sections on the observers' errors, in simulation and on the measured walk, and on the
    coverage of their bounds.
    """
    words = (
        "Errors of the mse observer while the robot moves (root mean square, forward, lateral, "
        "vertical), half widths of its bounds, and the share of errors within them. Recalibrated: "
        "bounds from the first half of the measured walk, and the share of the second half's "
        "errors within them."
    )
    rows: list[dict[str, Any]] = []
    last: tuple[str, ErrorParts, ErrorParts] | None = None
    for world in worlds:
        if world.simulated is not None and world.measured is not None:
            last = world.name, world.simulated, world.measured
            row: dict[str, Any] = {"walks": world.name}
            row["simulated [m/s]"] = _three(world.simulated["moving"])
            row["measured [m/s]"] = _three(world.measured["moving"])
            rows.append(row | _bounds_row(world))
    if isinstance(tuned, str):
        words += f"\n\nNo observer was tuned on the measured walk: {tuned}."
    else:
        row = {"walks": f"{worlds[-1].name}, tuned", "measured [m/s]": _three(tuned.rmse)}
        if tuned.epsilon is not None and tuned.held is not None:
            row |= _recalibrated(tuned.epsilon, tuned.held)
        rows.append(row)
        words += (
            "\n\nTuned: the last observer, trained further on half of the measured walk and judged "
            "on the other, with bounds from the first half of that; both halves in turn."
        )
    observers = Section("Observers", words, pd.DataFrame(rows), file="observers")
    if last is None:
        return [observers] if rows else []
    name, *both = last
    shares = excess(*both)
    parts = (
        f"Of the mse observer in the world `{name}`, root mean square [m/s]. Share of each "
        "part in the excess of the measured squared errors over the simulated ones: "
        f"{', '.join(f'{part} {100 * x:.0f} %' for part, x in shares.items())}.\n\n"
        "The errors while the robot moves are the sum of these parts: "
        f"{'; '.join(f'{part}, {what}' for part, what in ERROR_PARTS.items())}."
    )
    return [observers, Section("Parts of the errors", parts, parts_table(*both), file="parts")]


def _bounds_row(world: LoopWorld) -> dict[str, Any]:
    """Bounds and their coverage of the measured walk, as calibrated and after recalibration."""
    observer, bounds = world.learnt.observers[0], world.learnt.bounds[0]
    log, robot = world.comparison.log, world.comparison.robot
    assert robot is not None
    _, errors = bounded_errors(predict(observer, log, robot), bounds, log, robot.R_BI)
    held = coverage(errors, bounds).joint
    row: dict[str, Any] = {"bounds [m/s]": _three(bounds.epsilon), "hold [%]": round(100 * held, 1)}
    try:
        epsilon, held = recalibrated(observer, bounds, log, robot)
    except BoundsError:
        return row
    return row | _recalibrated(epsilon, held)


def _recalibrated(epsilon: Sequence[float] | np.ndarray, held: float) -> dict[str, Any]:
    return {"recalibrated [m/s]": _three(epsilon), "then hold [%]": round(100 * held, 1)}


def _three(values: Sequence[float] | np.ndarray) -> str:
    return ", ".join(f"{x:.3f}" for x in values)


def _of_trace(found: dict[str, Any]) -> list[Section]:
    """Sections on the channels of a trace.json, of the held-out logs where there are any."""
    words = " ".join(f"Because {why}." for why in found["reasons"])
    whole = Section("The trace", f"{words} The full report is trace/report.html.".strip())
    held_out = found.get("holdout", {})
    unseen = "Logs" if held_out else "Blocks of the log"
    rows = [channel_row(*one) for one in held_out.get("channels", found["channels"]).items()]
    residuals = Section("Residuals", f"{unseen} that no fit uses.", rows, file="residuals")
    return [whole, *([residuals] if rows else [])]


def _rows(worlds: Sequence[LoopWorld]) -> list[dict[str, Any]]:
    filters = dict.fromkeys(r.filter for world in worlds for r in world.comparison.results)
    rows = []
    for name in filters:
        row: dict[str, Any] = {"filter": name}
        for heading, key in LOOP_METRICS.items():
            for world in worlds:
                found = (r.metrics for r in world.comparison.results if r.filter == name)
                row[f"{heading} {world.name}"] = getattr(next(found, None), key, None)
        for world in worlds:
            held = world.comparison.held.get(name)
            row[f"coverage [%] {world.name}"] = 100 * held.joint if held else None
        rows.append(row)
    return rows


def _summary(world: LoopWorld) -> dict[str, Any]:
    filters = {
        r.filter: {key: float(getattr(r.metrics, key)) for key in LOOP_METRICS.values()}
        for r in world.comparison.results
        if r.metrics is not None
    }
    return {
        "effects": [e.as_dict() for e in world.effects],
        "observer_errors": {"simulated": world.simulated, "measured": world.measured},
        "coverage": {name: held.joint for name, held in world.comparison.held.items()},
        "filters": filters,
    }


def _trajectories(worlds: Sequence[LoopWorld]) -> dict[str, Trajectory]:
    """Estimates of the first and the last world, for the figures."""
    return {
        f"{r.filter} {world.name}": r.trajectory
        for world in (worlds[0], worlds[-1])
        for r in world.comparison.results
        if (known := traits(r.filter)).drawn and not known.variant
    }


def loop_findings(found: dict[str, Any], table: pd.DataFrame, worlds: Sequence[str]) -> str:
    """Sentences: how many filters gain, what was added, the best filter, and whether bounds hold.

    Args:
        found: contents of trace.json.
        table: errors of every filter in every world.
        worlds: their names, `before` first.
    """
    ranked = table[[not traits(name).floor for name in table["filter"]]].set_index("filter")
    errors = {name: ranked[f"APE_trans [m] {name}"].dropna() for name in worlds}
    before, after = (ranked[f"APE_trans [m] {name}"] for name in (worlds[0], worlds[-1]))
    better = list(ranked.index[np.less(after, before)])
    worse = list(ranked.index[np.greater_equal(after, before)])
    main = "Whether the loop helps is not known: there is one simulated world only."
    if len(worlds) > 1:
        main = (
            f"With what `trace` found put into the simulation, {len(better)} of {before.count()} "
            "filters have a lower position error on the measured walk"
            f"{': ' if better else ''}{', '.join(better)}. Not lower: {', '.join(worse) or 'none'}."
        )
    rest = []
    best = [f"`{e.idxmin()}` {name} ({e.min():.3f} m)" for name, e in errors.items()]
    rest.append(f"The lowest errors are those of {', '.join(best)}.")
    form = "{name} of {target}, {value:.4g} {unit}"
    zeros = [one for run in found["runs"] for one in run if one["compensated"]]
    added = [form.format(**effect) for effect in (*found["effects"], *zeros)]
    rest.append(f"Added were: {'; '.join(added)}." if added else "Nothing was added.")
    if warned := caution(found):
        rest.append(f"{warned[0].upper()}{warned[1:]}.")
    held = ranked[[f"coverage [%] {name}" for name in worlds]].dropna()
    for name, shares in zip(held.index, held.to_numpy(), strict=True):
        of = [f"{share:.1f} % {world}" for share, world in zip(shares, worlds, strict=True)]
        rest.append(f"The bounds of `{name}` contain {', '.join(of)} of the measured errors.")
    return f"{main}\n\n{' '.join(rest)}"


def observer_gain(worlds: Sequence[LoopWorld], tuned: TunedErrors | str) -> str:
    """One sentence: the mse observer's error on the measured walk after each step; empty without
    observers.
    """
    errors = {one.name: one.measured["moving"] for one in worlds if one.measured is not None}
    if not isinstance(tuned, str):
        errors["tuned on the walk's other half"] = tuned.rmse
    if not errors:
        return ""
    steps = [f"{np.linalg.norm(axes):.3f} m/s {name}" for name, axes in errors.items()]
    return f"The observer's velocity error on the measured walk is {', '.join(steps)}."


def _method(worlds: Sequence[LoopWorld]) -> str:
    left_out = {
        f"{name} ({why})": None
        for world in worlds
        for name, why in world.comparison.left_out.items()
    }
    text = (
        "Observers are trained and calibrated in simulation only, on walks with the speeds, stride "
        "and posture of the measured one, each with sizes drawn from the intervals of those found. "
        f"{'; '.join(f'{one.name}: {WORLD_WORDS[one.name]}' for one in worlds)}."
    )
    return text + (f"\n\nLeft out: {'; '.join(left_out)}." if left_out else "")


def _pictures(log: Log, worlds: Sequence[LoopWorld], drawn: dict[str, Trajectory]) -> list[Section]:
    truth = reference(log)
    errors = {name: error_series(truth, t, 20.0) for name, t in drawn.items()}
    paths = (
        Picture(trajectories(log, errors), "The walk from above, aligned at the start."),
        Picture(height_figure(log, errors), "Height over time; no sensor measures it."),
    )
    return [
        Section("Paths of the estimates", pictures=paths),
        *(
            Section(f"The observer, {world.name}", pictures=tuple(shown))
            for world in worlds
            if (shown := velocity_pictures(world.comparison))
        ),
    ]
