"""The report of `surefoot calibrate --report`: bounds, mixing, methods, and coverage by walk."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.shift import FALSE_ALARM
from surefoot.models.observer.observer import Observer
from surefoot.scenarios.reporting.calibration_tables import (
    case_table,
    evaluate_walk,
    methods_table,
    sequence_table,
)
from surefoot.scenarios.reporting.html import Picture, Section, write_report
from surefoot.scenarios.reporting.observer_errors import error_section
from surefoot.scenarios.reporting.observer_figures import mixing_curve
from surefoot.scenarios.reporting.pages import origin_of, write_page
from surefoot.scenarios.reporting.tables import to_csv, to_markdown
from surefoot.sim.common.files import write_whole
from surefoot.sim.common.progress import bar as drawn_bar
from surefoot.sim.log import Log


def write_calibration_report(
    out: Path,
    observer: Observer,
    bounds: Bounds,
    logs: Sequence[Log],
    page: Path | None = None,
) -> list[Section]:
    """Write report.html, its tables (.md, .csv) and the mixing curve into an empty folder.

    Raises SurefootError if a log does not match the observer.

    Args:
        out: the folder.
        observer: that was calibrated.
        bounds: its bounds.
        logs: the log of the bounds first, then walks, as recorded, to evaluate the bounds on; one
            without a reference only has the alarm.
        page: page of results (Markdown) to write as well.
    """
    calibration = logs[0]
    with drawn_bar(logs, desc="walks", unit=" log") as bar:
        first, *others = [evaluate_walk(observer, bounds, log, log is calibration) for log in bar]
    tables = {
        "methods": methods_table(first, [w for w in others if w.role == "test"]),
        "coverage": sequence_table(first, others),
        "cases": case_table(others),
    }
    for name, table in tables.items():
        if len(table):
            write_whole(out / f"{name}.md", to_markdown(table) + "\n")
            write_whole(out / f"{name}.csv", to_csv(table))
    pictures = ()
    if bounds.mixing is not None:
        pictures = (Picture(mixing_curve(bounds.mixing), MIXING_CAPTION, "mixing.png"),)
    # In the frame of that log's IMU.
    epsilon = first.bounds.epsilon
    sections = [
        Section("The bounds", _bounds_prose(first.bounds)),
        Section("Spacing of the errors", _mixing_prose(bounds), None, pictures),
        Section("Methods", METHODS_PROSE, tables["methods"]),
    ]
    tests = [walk.errors for walk in others if walk.role == "test" and len(walk.errors)]
    if tests:
        errors = observer.errors, np.vstack(tests)
        sections.append(error_section(*errors, epsilon, bounds.gamma, "test walks"))
    if others:
        sections.append(Section("Where the bounds hold", _shift_prose(tables), tables["coverage"]))
    if len(tables["cases"]):
        sections.append(
            Section("By terrain, slip, motion and stride", CASES_PROSE, tables["cases"])
        )
    title = f"Bounds calibrated on {calibration.name}, and where they hold"
    write_report(out / "report.html", title, sections)
    if page:
        write_page(page, title, sections, origin_of(__name__, "make study-bounds"))
    return sections


METHODS_PROSE = (
    "All methods use the same errors and the same joint level. The shape of a joint score is "
    "determined on the first quarter of the log, its size on the rest. The filters' update uses a "
    "box; for an ellipsoid it is the enclosing box, which has at least its coverage and is wider "
    "than necessary. In the mean over the test walks, each walk counts once."
)
MIXING_CAPTION = (
    "Dependence of errors on earlier ones. Peaks that do not decay come from the stride: with a "
    "gait of fixed period, errors repeat in every stride."
)
CASES_PROSE = (
    "All test walks together. The intervals count one error for each block of K samples in which "
    "the case occurs. The worst walk is the one with the lowest coverage of the case, of those "
    "where it occurs in at least five blocks."
)


def _bounds_prose(bounds: Bounds) -> str:
    x, y, z = bounds.epsilon
    sure = "" if bounds.confidence is None else f", with confidence {bounds.confidence:g}"
    return (
        f"|error| <= {x:.4f}, {y:.4f}, {z:.4f} m/s (forward, lateral, vertical), jointly with "
        f"probability {bounds.gamma:g}{sure}. They are from {bounds.n} errors, {bounds.K} steps of "
        f"10 ms apart, by the method {bounds.method}. The statement is about walks like "
        f"{bounds.log}; the tables below show the coverage on other walks."
    )


def _mixing_prose(bounds: Bounds) -> str:
    if bounds.mixing is None:
        return f"K = {bounds.K} was given."
    text = (
        f"K = {bounds.K}: the first lag at which the beta-mixing coefficients of all axes, less "
        f"the floor of their estimate, are at most {bounds.mixing.threshold:g}."
    )
    if not bounds.mixing.mixed:
        text += (
            " There is no such lag: K is that of the lowest coefficient, and fewer of the errors "
            "are independent than are counted."
        )
    return text


def _shift_prose(tables: dict[str, pd.DataFrame]) -> str:
    found = tables["coverage"]
    lost = [] if "bounds" not in found else list(found.walk[found.bounds == "lost"])
    verdict = f"Coverage is lost on {', '.join(lost)}." if lost else "Coverage is lost on no walk."
    return (
        f"{verdict} Coverage is lost if the whole 95 % interval lies below the level. The interval "
        "counts one error for each K samples.\n\n"
        "The alarm needs no reference: it compares the size of the filter's innovations, second by "
        "second, with that in the calibration. On a walk like that one it is raised with a "
        f"probability of at most {FALSE_ALARM:g}. It tests whether walks are alike, not the "
        "coverage.\n\n"
        "Two remedies need no reference either. Widened: after the alarm, the bounds grow with the "
        "innovations (by: the mean factor). Weighted: calibration errors are weighted by the "
        "similarity of the inputs (volume: relative to these bounds); there are no bounds if the "
        "calibration has too few seconds like this walk. Neither notices a persistent error that "
        "does not affect the inputs."
    )
