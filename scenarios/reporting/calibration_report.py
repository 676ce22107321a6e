"""The report of `surefoot calibrate --report`: bounds, mixing, methods, and coverage by walk."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from operator import length_hint
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.calibrate import region_of, samples_for
from surefoot.models.calibration.empirical_coverage import (
    CaseCoverage,
    binomial_interval,
    bounded_errors,
    coverage,
    coverage_by,
)
from surefoot.models.calibration.regions import CONFIDENCE, BoundsError, Region, calibrator
from surefoot.models.observer.observer import Observer, log_digest
from surefoot.models.observer.predict import predict
from surefoot.models.observer.samples import RATE, observer_rows
from surefoot.models.registry import CALIBRATORS
from surefoot.scenarios.estimate.run import declared_model
from surefoot.scenarios.reporting.html import Picture, Section
from surefoot.scenarios.reporting.observer_errors import error_section, mixing_curve
from surefoot.scenarios.reporting.pages import origin_of, write_page, write_results
from surefoot.sim.common.progress import bar as drawn_bar
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot


def write_calibration_report(
    out: Path,
    observer: Observer,
    bounds: Bounds,
    calibration: Iterable[Log],
    logs: Sequence[Log],
    page: Path | None = None,
) -> list[Section]:
    """Write report.html, table.md, the tables (.csv) and the mixing curve into an empty folder.

    Raises SurefootError if a log does not match the observer.

    Args:
        out: the folder.
        observer: that was calibrated.
        bounds: its bounds.
        calibration: logs of the bounds, as recorded; as many as their `len` says, read one by one.
        logs: walks, as recorded, to evaluate the bounds on; one without a reference only has the
            distance from the training walks.
        page: page of results (Markdown) to write as well.
    """
    count = length_hint(calibration)
    every, total = chain(calibration, logs), count + len(logs)
    with drawn_bar(every, total=total, desc="walks", unit=" log") as bar:
        walks = [evaluate_walk(observer, bounds, log, k < count) for k, log in enumerate(bar)]
    known, others = walks[:count], walks[count:]
    methods = methods_table(bounds, known, [w for w in others if w.role == "test"])
    coverage, cases = sequence_table(known, others), case_table(others)
    pictures = ()
    if bounds.mixing is not None:
        pictures = (Picture(mixing_curve(bounds.mixing), MIXING_CAPTION, "mixing.png"),)
    sections = [
        Section("Findings", bounds_findings(bounds, coverage), coverage.filter(FIRST)),
        Section("Spacing of the errors", _mixing_prose(bounds), None, pictures),
    ]
    tests = [walk.errors for walk in others if walk.role == "test" and len(walk.errors)]
    if tests and not bounds.scaled:  # of the training, errors are stored in m/s alone
        errors = observer.errors, np.vstack(tests), bounds.epsilon
        sections.append(replace(error_section(*errors, bounds.gamma, "test walks"), file="errors"))
    sections.append(Section("Methods", METHODS_PROSE, methods, file="methods"))
    if others:
        sections.append(Section("Where the bounds hold", SHIFT_PROSE, coverage, file="coverage"))
    if len(cases):
        heading = "By terrain, slip, motion and stride"
        sections.append(Section(heading, CASES_PROSE, cases, file="cases"))
    title = f"Bounds calibrated on {calibrated_on(bounds)}, and where they hold"
    write_results(out, title, sections)
    if page:
        write_page(page, title, sections, origin_of(__name__, "make study-bounds"))
    return sections


FIRST = ["walk", "role", "coverage [%]", "95 % interval", "bounds", "distance"]
"""Columns of coverage that a reader needs first."""
MOST_NAMED = 3
"""Largest number of logs that are named."""
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


SHIFT_PROSE = (
    "Coverage is lost if the whole 95 % interval, which counts one error for each K samples, lies "
    "below the level. Distance is that from the walks that the observer was trained on, 1 being "
    "the farthest of these; it needs no reference, and is not known of an observer of few walks."
)


def calibrated_on(bounds: Bounds) -> str:
    """The logs of bounds, in words; of many, their number."""
    names = bounds.log.split(", ")
    return bounds.log if len(names) <= MOST_NAMED else f"{len(names)} walks"


def bounds_findings(bounds: Bounds, walks: pd.DataFrame) -> str:
    """Sentences: on which walks the bounds hold, their size, and which are unlike the training."""
    sure = "" if bounds.confidence is None else f", with confidence {bounds.confidence:g}"
    size = (
        f"The bounds are {bounds.words}, "
        f"jointly with probability {bounds.gamma:g}{sure}, from {bounds.n} errors that are "
        f"{bounds.K} steps of 10 ms apart, by the method {bounds.method}."
    )
    if "bounds" not in walks or "test" not in set(walks["role"]):
        return size
    tests = walks[(walks["role"] == "test") & walks["bounds"].notna()]
    lost = tests[tests["bounds"] == "lost"]
    far, far_lost = (int(np.sum(one["distance"].to_numpy(float) > 1.0)) for one in (tests, lost))
    named = f": {', '.join(lost['walk'])}" if len(lost) else ""
    main = (
        f"Bounds calibrated on {calibrated_on(bounds)} are lost on {len(lost)} of {len(tests)} "
        f"test walks{named}."
    )
    return (
        f"{main}\n\n{size} Farther from the training walks than any of these are {far_lost} of the "
        f"{len(lost)} walks on which they are lost and {far - far_lost} of the "
        f"{len(tests) - len(lost)} others. Bounds are a statement on walks like those of the "
        "calibration."
    )


@dataclass(frozen=True)
class CalibratedWalk:
    """One log under one calibration.

    errors (M, 3) at `rows` of the log, as from `bounded_errors`, empty without a reference;
    distance from the training walks, NaN where it is not known.
    """

    log: Log
    role: str  # calibration, training or test
    bounds: Bounds
    rows: np.ndarray
    errors: np.ndarray
    distance: float


def evaluate_walk(
    observer: Observer, bounds: Bounds, log: Log, calibrated: bool = False
) -> CalibratedWalk:
    """Run the observer over a log as recorded."""
    named = Robot.for_log(log)
    known, robot = declared_model(log, named)
    rows, errors = np.zeros(0, dtype=int), np.zeros((0, 3))
    prediction = predict(observer, known, robot)
    if log.has("reference"):
        rows, errors = bounded_errors(prediction, bounds, known, robot.R_BI)
    trained = log_digest(known) in {part.sha256 for part in observer.logs}
    role = "calibration" if calibrated else "training" if trained else "test"
    return CalibratedWalk(known, role, bounds, rows, errors, float(prediction.unlike[-1]))


def methods_table(
    bounds: Bounds, calibration: Sequence[CalibratedWalk], tests: Sequence[CalibratedWalk]
) -> pd.DataFrame:
    """Every method with the same errors: half widths, volume, and coverage of the tests."""
    judged = [walk.errors for walk in tests if len(walk.errors)]
    rows: list[dict[str, object]] = []
    for method in CALIBRATORS:
        how = calibrator(method, bounds.gamma, bounds.confidence or CONFIDENCE)
        shaping, chosen = samples_for(how, [walk.errors for walk in calibration], bounds.K)
        row: dict[str, object] = {"method": method, "errors": len(chosen)}
        try:
            region = region_of(how, shaping, chosen)
        except BoundsError as error:
            rows.append(row | {"note": str(error)})
            continue
        rows.append(row | _region_row(region, bounds, judged, how.label))
    return pd.DataFrame(rows)


def _region_row(
    region: Region, bounds: Bounds, judged: Sequence[np.ndarray], note: str
) -> dict[str, object]:
    widths = zip("xyz", region.epsilon, strict=True)
    row: dict[str, object] = {f"{axis} [{bounds.unit}]": width for axis, width in widths}
    factor, unit = (1.0, "std^3") if bounds.scaled else (1e6, "(cm/s)^3")
    row[f"volume [{unit}]"] = factor * region.volume
    if judged:
        held = [float(region.contains(errors).mean()) for errors in judged]
        row["coverage, mean of walks [%]"] = percent(np.mean(held))
        row["worst walk [%]"] = percent(min(held))
    return row | {"note": note}


def sequence_table(
    calibration: Sequence[CalibratedWalk], others: Sequence[CalibratedWalk]
) -> pd.DataFrame:
    """One row per walk: coverage with interval, and the distance."""
    rows: list[dict[str, object]] = []
    for walk in (*calibration, *others):
        row: dict[str, object] = {"walk": walk.log.name, "role": walk.role}
        row["length [s]"] = round(len(observer_rows(walk.log)) / RATE)
        rows.append(row | _held(walk) | {"distance": round(walk.distance, 2)})
    return pd.DataFrame(rows)


def _held(walk: CalibratedWalk) -> dict[str, object]:
    if len(walk.errors) < walk.bounds.K:
        return {"coverage [%]": None, "95 % interval": "no reference"}
    found = coverage(walk.errors, walk.bounds)
    low, high = found.joint_interval
    lost, gamma = high < walk.bounds.gamma, walk.bounds.gamma
    return {
        "coverage [%]": percent(found.joint),
        "95 % interval": f"{100 * low:.0f}–{100 * high:.0f}",
        "bounds": "lost" if lost else "hold" if found.joint >= gamma else "not significant",
    }


def percent(share) -> str:
    """A share in percent, to one decimal."""
    return f"{100 * share:.1f}"


def case_table(walks: Sequence[CalibratedWalk]) -> pd.DataFrame:
    """Coverage by case, over all test walks, and the walk on which each case is covered least."""
    found: dict[tuple[str, str], list[tuple[CalibratedWalk, CaseCoverage]]] = {}
    tests = [walk for walk in walks if walk.role == "test" and len(walk.errors)]
    for walk in tests:
        for case in coverage_by(walk.log, walk.rows, walk.errors, walk.bounds):
            found.setdefault((case.split, case.case), []).append((walk, case))
    total = sum(len(walk.errors) for walk in tests)
    rows: list[dict[str, object]] = []
    for (split, name), entries in found.items():
        counts = np.array([round(case.time * len(walk.errors)) for walk, case in entries])
        joint = float(counts @ np.array([case.joint for _, case in entries]) / counts.sum())
        low, high = binomial_interval(joint, sum(case.n for _, case in entries))
        counted = [(walk, case) for walk, case in entries if case.n >= 5] or entries
        walk, worst = min(counted, key=lambda entry: entry[1].joint)
        rows.append(
            {
                "split": split,
                "case": name,
                "time [%]": percent(counts.sum() / total),
                "coverage [%]": percent(joint),
                "95 % interval": f"{100 * low:.0f}–{100 * high:.0f}",
                "worst walk": f"{walk.log.name} {100 * worst.joint:.0f} %",
            }
        )
    return pd.DataFrame(rows)
