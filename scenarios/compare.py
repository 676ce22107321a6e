"""Run every filter on every log: table, figures, report and recordings."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import surefoot
from surefoot.estimator.evaluation.trajectory import reference
from surefoot.estimator.metrics import ONE_WALK, Metrics, path_length
from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.empirical_coverage import (
    EmpiricalCoverage,
    bounded_errors,
    coverage,
)
from surefoot.models.observer.predict import Prediction, predict
from surefoot.scenarios.datasets.index import walk_facts
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.error_series import ErrorSeries, error_series
from surefoot.scenarios.estimate.estimators import (
    estimator_named,
    shown_at_first,
    traits,
)
from surefoot.scenarios.estimate.inputs import (
    learnt_from,
    not_plausible,
    notes_on,
    read_logs,
    with_effects,
)
from surefoot.scenarios.estimate.run import Result, declared_model, robot_of, run_all
from surefoot.scenarios.estimate.settings import FilterSettings, read_settings
from surefoot.scenarios.reporting.figures import (
    errors_by_axis,
    height_figure,
    position_error,
    trajectories,
    velocity_figure,
)
from surefoot.scenarios.reporting.html import Picture, Section, write_report
from surefoot.scenarios.reporting.tables import (
    LOST_FROM,
    METRICS,
    cell,
    metrics_row,
    to_csv,
    to_markdown,
)
from surefoot.scenarios.settings import CompareSettings
from surefoot.scenarios.viewer.recording import RecordedWalk, write_recording
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import refuse_full, whole_folder, write_whole
from surefoot.sim.log import Log
from surefoot.sim.physics.foot_truth import SLIPPING
from surefoot.sim.robot import Robot

MEANINGS = {
    "APE_trans [m]": "position RMSE after aligning position and yaw at the first sample",
    "APE_rot [deg]": "attitude RMSE after the same alignment",
    "RPE_trans [m]": "position RMSE over all 1 m segments of the reference path",
    "RPE_rot [deg/m]": "attitude RMSE over the same segments",
    "pi<gamma [%]": "share of updates on which the coverage update was active",
    "coverage [%]": "share of velocity errors jointly inside the bounds, with a 95 % interval",
    "NEES_pos": "mean normalised squared position error; 3 is consistent, more is overconfident",
    "NEES_vel": "the same of velocity",
    "NEES_att": "the same of attitude",
    LOST_FROM: "when innovations, biases or rejected measurements showed that the filter was lost",
    "step [us]": "computing time per IMU sample, observer and legs included (varies by machine)",
}
_LEAST = [name for name in METRICS if name.startswith(("APE", "RPE"))]


@dataclass(frozen=True)
class Comparison:
    """All filters on one log."""

    log: Log
    robot: Robot | None
    results: tuple[Result, ...]
    left_out: dict[str, str]  # filter -> why
    prediction: "Prediction | None"
    bounds: "Bounds | None"
    held: dict[str, "EmpiricalCoverage"]  # filter -> empirical coverage of its bounds
    warnings: tuple[str, ...] = ()  # what in the log is not plausible
    notes: tuple[str, ...] = ()  # what else to know when comparing

    @property
    def doubts(self) -> list[str]:
        """A sentence for each filter that is not to be trusted."""
        return [r.health.sentence(r.filter) for r in self.results if r.health.lost]

    def recorded(self) -> RecordedWalk | None:
        """What a recording shows: the robot along its reference, with the estimates that are drawn;
        None where there is no robot, no joints or no reference.
        """
        if self.robot is None or not (self.log.has("reference") and self.log.has("q")):
            return None
        drawn = {r.filter: r.trajectory for r in self.results if traits(r.filter).drawn}
        return RecordedWalk(self.log, self.robot, drawn, self.prediction, self.bounds)


def compare_log(
    log: Log,
    robot: Robot | None,
    learnt: Learnt,
    names: Sequence[str] | None = None,
    settings: FilterSettings | None = None,
    progress: bool = True,
) -> Comparison:
    """Run every filter that can run on `log`.

    Args:
        log: to estimate.
        robot: of the log; without one, only filters that need none are run.
        learnt: observers and bounds.
        names: of the filters; by default all.
        settings: noise, priors and start; by default those tuned for the robot.
        progress: whether to show a bar.
    """
    results, left_out = run_all(log, robot, learnt, names, settings, progress)
    known, model = declared_model(log, robot)  # as the filters see it
    notes = tuple(
        f"identical: {' and '.join(names)} give the same estimates" for names in _identical(results)
    )
    if results:
        notes = (*notes_on(known, model, learnt, settings or FilterSettings()), *notes)
    prediction, bounds = None, None
    held: dict[str, EmpiricalCoverage] = {}
    missed: dict[str, list[str]] = {}
    for name in reversed([result.filter for result in results]):  # the first one's are drawn
        bounded_by: Any = getattr(estimator_named(name), "bounded_by", None)
        if bounded_by is None:
            continue
        observer, bounds = bounded_by(learnt)
        prediction = predict(observer, known, model)
        if log.has("reference"):
            assert model is not None  # whose joints the observer read
            _, errors = bounded_errors(prediction, bounds, known, model.R_BI)
            held[name] = coverage(errors, bounds)
            if words := _not_held(held[name], bounds.gamma):
                missed.setdefault(words, []).append(name)
    notes = (*notes, *(f"bounds: {words} ({', '.join(names)})" for words, names in missed.items()))
    return Comparison(log, robot, tuple(results), left_out, prediction, bounds, held, notes=notes)


def _not_held(found: EmpiricalCoverage, gamma: float) -> str:
    """A line where the interval of an empirical coverage excludes the level gamma of its bounds."""
    low, high = np.round(100 * found.joint_interval)  # as it is shown
    if low <= 100 * gamma <= high:
        return ""
    share = f"{100 * found.joint:.0f} ({low:.0f}–{high:.0f}) % of the errors are inside"
    return f"{share}, not {100 * gamma:.0f} % as on the calibration's walks"


def _identical(results: Sequence[Result]) -> list[list[str]]:
    """Groups of filters with the same estimates and covariances."""
    same: dict[bytes, list[str]] = {}
    for one in results:
        each = one.trajectory.p_GI, one.trajectory.R_GI, one.trajectory.covariance
        same.setdefault(b"".join(x.tobytes() for x in each if x is not None), []).append(one.filter)
    return [names for names in same.values() if len(names) > 1]


def compare_files(settings: CompareSettings) -> tuple[pd.DataFrame, list[Comparison]]:
    """Run the filters on the logs of some files and write the outputs of `write_comparison`.

    What is implausible in a log is printed to stderr. Raises SurefootError saying what is missing
    or wrong, also where two logs have the same name.
    """
    refuse_full(settings.out, settings.force)
    learnt = learnt_from(settings.observer, settings.bounds)
    logs = [
        with_effects(log, robot_of(log, settings.robot), settings.effects)
        for log in read_logs(settings.logs)
    ]
    names = [log.name for log in logs]
    for path, name in zip(settings.logs, names, strict=True):
        if names.count(name) > 1:
            raise SurefootError(f"{path}: another log has the same name; rename one of them")
    chosen = read_settings(settings.settings, settings.entries)
    warnings = not_plausible(logs, settings.robot, settings.strict)
    found = []
    for log, doubts in zip(logs, warnings, strict=True):
        one = compare_log(
            log, robot_of(log, settings.robot), learnt, settings.filters or None, chosen
        )
        found.append(replace(one, warnings=doubts))
    if not any(one.results for one in found):
        raise SurefootError(f"no filter ran: {'; '.join(left_out_lines(found))}")
    with whole_folder(settings.out, settings.force) as folder:
        return write_comparison(found, folder, "Filters compared", kind=settings.figures), found


def table(comparisons: Sequence[Comparison]) -> pd.DataFrame:
    """One row per log and filter; MEANINGS describes the columns."""
    rows = []
    for comparison in comparisons:
        for result in comparison.results:
            values: dict[str, object] = {"step [us]": 1e6 * result.step_time}
            if result.metrics is not None:
                values |= metrics_row(result.metrics) | {"coverage [%]": None}
                if held := comparison.held.get(result.filter):
                    low, high = 100 * held.joint_interval
                    values["coverage [%]"] = f"{100 * held.joint:.1f} ({low:.0f}–{high:.0f})"
            if result.health.lost:
                values[LOST_FROM] = result.health.since
            row: dict[str, object] = {"log": result.log, "filter": result.filter}
            rows.append(row | {name: values[name] for name in MEANINGS if name in values})
    # The first row may lack columns that later ones have.
    known = {name for row in rows for name in row}
    columns = ["log", "filter", *(name for name in MEANINGS if name in known)]
    return pd.DataFrame(rows, columns=columns)


def write_comparison(
    comparisons: Sequence[Comparison],
    out: Path,
    title: str,
    extra: Sequence[Section] = (),
    kind: str = "png",
) -> pd.DataFrame:
    """Write table.md, table.csv, figures/, report.html and one recording per log into `out`.

    Args:
        comparisons: one per log.
        out: folder.
        title: of the report.
        extra: sections added to the report.
        kind: of the files of the figures: png, pdf or svg.
    """
    found = table(comparisons)
    write_whole(out / "table.md", to_markdown(found) + "\n")
    write_whole(out / "table.csv", to_csv(found))
    sections = _summary_sections(comparisons, found)
    for comparison in comparisons:
        pictures = _pictures(comparison, kind)
        heading = f"The log '{comparison.log.name}'"
        sections.append(Section(heading, _walk_prose(comparison), pictures=tuple(pictures)))
        if walk := comparison.recorded():
            write_recording(out / f"{comparison.log.name}.rrd", walk)
    sections += [*extra, made_by()]
    write_report(out / "report.html", title, sections)
    return found


def _summary_sections(comparisons: Sequence[Comparison], found: pd.DataFrame) -> list[Section]:
    """The table, and an explanation of it."""
    first = [
        error_summary(c.log.name, {r.filter: r.metrics for r in c.results if r.metrics is not None})
        for c in comparisons
    ]
    first += [f"On {c.log.name}, {words}." for c in comparisons for words in c.doubts]
    first += [
        f"Not plausible in {c.log.name}: {words}." for c in comparisons for words in c.warnings
    ]
    first += [f"On {c.log.name}: {words}." for c in comparisons for words in c.notes]
    left_out = [f"{line[0].upper()}{line[1:]}." for line in left_out_lines(comparisons)]
    ran = dict.fromkeys(result.filter for c in comparisons for result in c.results)
    glossary = [{"": name, "means": estimator_named(name).description} for name in ran]
    marked = with_best_marked(found)
    glossary += [{"": n, "means": text} for n, text in MEANINGS.items() if n in marked.columns]
    bold = "\n\n".join(["The least errors are in bold.", *left_out])
    return [
        Section("Filters compared", "\n\n".join(first), marked),
        Section("How to read the table", bold, glossary),
    ]


def _walk_prose(comparison: Comparison) -> str:
    log = comparison.log
    name = comparison.robot.name if comparison.robot else "A robot that is not named"
    text = f"{name}, {log.t[-1] - log.t[0]:.1f} s"
    if log.has("reference"):
        text += f", {path_length(log.t, log.ref_p):.1f} m"
    if log.has("truth") and log.has("reference"):
        facts = walk_facts([log])
        text += (
            f". Loaded feet slip, faster than {SLIPPING} m/s, in {100 * facts['slip_share']:.1f} % "
            "of their samples; on dry ground they creep at "
            f"{1e3 * facts['creep']:.2f} mm/s (median)"
        )
    if log.meta.effects:
        named = ", ".join(f"{one['name']} {one['target']}" for one in log.meta.effects)
        text += f". Effects in the filters' model: {named}"
    if comparison.bounds is not None:
        text += f". Bounds on the observer's velocity: {comparison.bounds.words}"
    if comparison.recorded():
        text += f". Recording: surefoot view {log.name}.rrd"
    elif log.has("reference"):
        text += ". No recording, which needs joint angles and a known robot"
    if log.meta.seed is not None:
        text += f". Simulated from {log.meta.scenario}, seed {log.meta.seed}"
    return text + "."


def _pictures(comparison: Comparison, kind: str = "png") -> list[Picture]:
    if not (comparison.log.has("reference") and comparison.results):
        return []
    truth = reference(comparison.log)
    shown = [r for r in comparison.results if traits(r.filter).drawn] or comparison.results
    errors = {r.filter: error_series(truth, r.trajectory, 20.0) for r in shown}
    large = ", ".join(r.filter for r in comparison.results if r.filter not in errors)
    left_out = f" Left out: {large}, whose errors would hide the others'." if large else ""
    pictures = position_pictures(comparison.log, errors, kind, left_out)
    few = {name: errors[name] for name in shown_at_first(tuple(errors))}
    which = "" if len(few) == len(errors) else f" Of {', '.join(few)}; --filters chooses others."
    words = f"Errors of position, attitude and velocity, with three sigma.{which}"
    files = f"figures/{comparison.log.name}"
    pictures.append(Picture(errors_by_axis(few), words, f"{files}_errors.{kind}"))
    return [*pictures, *velocity_pictures(comparison, f"{files}_velocity.{kind}")]


def position_pictures(
    log: Log, errors: Mapping[str, ErrorSeries], kind: str = "png", left_out: str = ""
) -> list[Picture]:
    """Paths, heights and position errors of estimates of a log.

    Args:
        log: with a reference.
        errors: of the estimates, by name.
        kind: of the files.
        left_out: sentence on estimates that are not drawn.
    """
    files = f"figures/{log.name}"
    return [
        Picture(
            trajectories(log, errors),
            f"The walk from above: reference and estimates, aligned at the start.{left_out}",
            f"{files}_trajectories.{kind}",
        ),
        Picture(
            height_figure(log, errors),
            f"Height over time: without a sensor that measures it, it drifts.{left_out}",
            f"{files}_height.{kind}",
        ),
        Picture(
            position_error(errors),
            f"Position error, and the three sigma that each claims for itself.{left_out}",
            f"{files}_position_error.{kind}",
        ),
    ]


def velocity_pictures(comparison: Comparison, file: str = "") -> list[Picture]:
    """The observer's prediction with its bounds; none without an observer, bounds or a robot."""
    prediction, bounds, robot = comparison.prediction, comparison.bounds, comparison.robot
    if prediction is None or bounds is None or robot is None:
        return []
    drawn = velocity_figure(
        comparison.log, prediction, bounds.epsilon_at(robot.R_BI, prediction.covariance)
    )
    words = "Body velocity: the observer's prediction, its calibrated bounds, and the truth."
    return [Picture(drawn, words, file)]


def error_summary(log: str, metrics: Mapping[str, Metrics]) -> str:
    """Describe which filter has the least error on a log, and which are over- or underconfident."""
    if not metrics:
        return f"On {log}: no errors to compare, without a reference or a filter that held."
    errors = {name: one.ape_trans for name, one in metrics.items()}
    best = min(errors, key=lambda name: errors[name])
    what = "has an error of" if len(errors) == 1 else "has the least error,"
    text = f"On {log}: {best} {what} {cell(errors[best])} m (APE_trans)"
    nees = {name: one.nees_position for name, one in metrics.items()}
    low, high = ONE_WALK
    for what, names in (
        ("overconfident", [name for name, value in nees.items() if value > high]),
        ("underconfident", [name for name, value in nees.items() if value < low]),
    ):
        if names:
            shown = ", ".join(f"{name} ({cell(nees[name], 2)})" for name in names)
            text += f"; {what} (NEES_pos, 3 if consistent): {shown}"
    return f"{text}."


def left_out_lines(comparisons: Sequence[Comparison]) -> list[str]:
    """Lines on the filters that did not run, grouped by reason and logs."""
    logs: dict[tuple[str, str], list[str]] = {}
    for one in comparisons:
        for left_out in one.left_out.items():
            logs.setdefault(left_out, []).append(one.log.name)
    lines: dict[tuple[str, str], list[str]] = {}
    for (name, reason), names in logs.items():
        where = "every log" if 1 < len(names) == len(comparisons) else ", ".join(names)
        lines.setdefault((where, reason), []).append(name)
    return [f"left out on {on}: {', '.join(names)} ({why})" for (on, why), names in lines.items()]


def with_best_marked(found: pd.DataFrame) -> pd.DataFrame:
    """The table without empty columns, with the least errors on each log in bold."""
    marked = found.dropna(axis=1, how="all").astype(object)
    for _, rows in found.groupby("log", sort=False):
        for column in _LEAST:
            if column in marked and len(rows[column].dropna()) > 1:
                values = rows[column].astype(float)
                best = cell(values.min())
                for at in values.index[[cell(value) == best for value in values]]:
                    marked.at[at, column] = f"**{best}**"
    return marked


def made_by() -> Section:
    """The version and, if surefoot was started as a command, the command."""
    return Section("Made by", f"surefoot {surefoot.__version__}. {command_line(sys.argv)}".strip())


def command_line(arguments: Sequence[str]) -> str:
    """The command as in `sys.argv`, without the folders of absolute paths; empty if surefoot was
    not started as a command.
    """
    program, *rest = arguments or [""]
    if not program.endswith(("/surefoot", "/__main__.py")):
        return ""
    named = (one.rpartition("/")[2] if one[:1] == "/" else one for one in rest)
    return " ".join(["surefoot", *named])
