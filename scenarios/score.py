"""`surefoot score`: anyone's estimates of a log, their errors, consistency and coverage."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

from surefoot.estimator.metrics import Metrics, align_first, evaluate, matched, nees
from surefoot.scenarios.compare import (
    MEANINGS,
    error_summary,
    made_by,
    position_pictures,
    with_best_marked,
)
from surefoot.scenarios.estimate.error_series import ErrorSeries, error_series
from surefoot.scenarios.estimate.other_estimates import (
    OtherEstimate,
    beside_reference,
    of_imu,
    read_estimate,
)
from surefoot.scenarios.estimate.run import robot_of
from surefoot.scenarios.reporting.figures import errors_by_axis
from surefoot.scenarios.reporting.html import Picture, Section, write_report
from surefoot.scenarios.reporting.tables import metrics_row, to_csv, to_markdown
from surefoot.scenarios.settings import ScoreSettings
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import refuse_full, whole_folder, write_whole
from surefoot.sim.log import Log

LEVEL = 0.95
"""Level of the regions in which errors are counted."""
QUANTITIES = ("position", "velocity", "attitude")
INSIDE = {name: f"{name[:3]} in {100 * LEVEL:g} % [%]" for name in QUANTITIES}
SE3, VELOCITY, SHARED = "APE_SE(3) [m]", "RMSE_vel [m/s]", "shared [s]"
_MEANINGS = MEANINGS | {
    SE3: "position RMSE after a least-squares alignment of position and rotation",
    VELOCITY: "velocity RMSE in the IMU frame, without alignment",
    SHARED: "duration that estimate and reference share",
}
_MEANINGS |= {
    column: f"share of samples with the {name} error in the {100 * LEVEL:g} % ellipsoid of the "
    "claimed covariance"
    for name, column in INSIDE.items()
}


@dataclass(frozen=True)
class Scored:
    """One estimate against the reference.

    Attributes:
        name: of the estimate.
        metrics: NaN where it claims no covariance.
        inside: share of the errors of each of QUANTITIES within the region claimed at LEVEL.
        errors: over time.
    """

    name: str
    metrics: Metrics
    inside: dict[str, float]
    errors: ErrorSeries


def score(settings: ScoreSettings) -> pd.DataFrame:
    """Evaluate estimates against a log's reference and write the page; returns the table.

    Raises SurefootError, in one line, for bad input.
    """
    refuse_full(settings.out, settings.force)
    log = Log.read(settings.log)
    log.require("reference")
    found = [
        scored(_placed(read_estimate(path), log, settings), log, name)
        for path, name in zip(settings.estimates, _names(settings.estimates), strict=True)
    ]
    table = pd.DataFrame([_row(one) for one in found])
    with whole_folder(settings.out, settings.force) as folder:
        write_whole(folder / "table.md", to_markdown(table) + "\n")
        write_whole(folder / "table.csv", to_csv(table))
        sections = _sections(log, found, table, settings.figures)
        write_report(folder / "report.html", f"Estimates of {log.name}", sections)
    return table


def _names(paths: Sequence[Path]) -> list[str]:
    """Names of the files, without suffixes where these do not tell them apart."""
    stems = [path.stem for path in paths]
    names = [path.stem if stems.count(path.stem) == 1 else path.name for path in paths]
    for path, name in zip(paths, names, strict=True):
        if names.count(name) > 1:
            raise SurefootError(f"{path}: another estimate has the same name; rename one of them")
    return names


def scored(estimate: OtherEstimate, log: Log, name: str) -> Scored:
    """Evaluate one estimate against a log's reference, interpolated to the estimate's stamps.

    Raises SurefootError, beginning with the name, where they share no time.
    """
    truth, known = beside_reference(estimate.trajectory, log, name)
    metrics, errors = evaluate(truth, known), error_series(truth, known, 20.0)
    truth, known = matched(truth, known)
    squared = nees(truth, align_first(truth, known))
    inside = {}
    for quantity in QUANTITIES:
        if quantity in estimate.claimed:
            values = getattr(squared, quantity)
            values = values[np.isfinite(values)]
            inside[quantity] = float(np.mean(values <= chi2.ppf(LEVEL, 3)))
        else:
            inside[quantity] = np.nan
            metrics = replace(metrics, **{f"nees_{quantity}": np.nan})
            errors = replace(errors, **{f"{quantity}_sigma": None})
    return Scored(name, metrics, inside, errors)


def _placed(estimate: OtherEstimate, log: Log, settings: ScoreSettings) -> OtherEstimate:
    """The estimate on the log's clock, of the IMU frame."""
    moved = replace(estimate.trajectory, t=estimate.trajectory.t + settings.offset)
    if settings.frame == "base":
        robot = robot_of(log, settings.robot)
        if robot is None:
            raise SurefootError("--frame base: needs the robot, for the place of its IMU: --robot")
        moved = of_imu(moved, log, robot)
    return replace(estimate, trajectory=moved)


def _row(one: Scored) -> dict[str, Any]:
    values = {SE3: one.metrics.ape_trans_se3, VELOCITY: one.metrics.velocity}
    inside = {INSIDE[name]: 100.0 * share for name, share in one.inside.items()}
    shared = {SHARED: one.metrics.duration}
    return {"estimate": one.name} | metrics_row(one.metrics) | values | inside | shared


def _sections(log: Log, found: Sequence[Scored], table: pd.DataFrame, kind: str) -> list[Section]:
    summary = error_summary(log.name, {one.name: one.metrics for one in found})
    errors = {one.name: one.errors for one in found}
    pictures = position_pictures(log, errors, kind)
    words = "Errors of position, attitude and velocity, with three sigma."
    by_axis = Picture(errors_by_axis(errors), words, f"figures/{log.name}_errors.{kind}")
    glossary = [{"": name, "means": text} for name, text in _MEANINGS.items() if name in table]
    marked = with_best_marked(table.assign(log=log.name)).drop(columns="log")
    return [
        Section("Errors, consistency and coverage", summary, marked, (*pictures, by_axis)),
        Section("How to read the table", "The least errors are in bold.", glossary),
        made_by(),
    ]
