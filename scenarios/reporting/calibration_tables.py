"""Tables of a calibration: methods, walks and cases, each with its coverage."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from surefoot.estimator.evaluation.innovation import innovations
from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.calibrate import region_of, samples_for
from surefoot.models.calibration.conformal import BoundsError
from surefoot.models.calibration.empirical_coverage import (
    CaseCoverage,
    binomial_interval,
    coverage,
    coverage_by,
    worst_case,
)
from surefoot.models.calibration.regions import CONFIDENCE, Region, calibrator
from surefoot.models.calibration.shift import Alarm, block_sizes, inflation, shift_alarm
from surefoot.models.calibration.weighted import weighted_bounds
from surefoot.models.observer.decimate import RATE, observer_rows
from surefoot.models.observer.observer import Observer, log_digest
from surefoot.models.observer.predict import prediction_errors
from surefoot.models.observer.samples import observer_samples
from surefoot.models.registry import CALIBRATORS
from surefoot.scenarios.estimate.run import Learnt, declared_model, run_filter
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot


@dataclass(frozen=True)
class CalibratedWalk:
    """One log under one calibration.

    errors (M, 3) at `rows` of the log, empty without a reference; x (M', C) the observer's scaled
    inputs; t and squared (M",) those of the innovations.
    """

    log: Log
    role: str  # calibration, training or test
    bounds: Bounds  # in the frame of this log's IMU
    rows: np.ndarray
    errors: np.ndarray
    x: np.ndarray
    t: np.ndarray
    squared: np.ndarray


def evaluate_walk(
    observer: Observer, bounds: Bounds, log: Log, calibrated: bool = False
) -> CalibratedWalk:
    """Run observer and coverage filter over a log as recorded."""
    named = Robot.for_log(log)
    known, robot = declared_model(log, named)
    rows, errors = np.zeros(0, dtype=int), np.zeros((0, 3))
    if log.has("reference"):
        rows, errors = prediction_errors(observer, known, robot)
    trajectory = run_filter("coverage", log, named, Learnt((observer,), (bounds,))).trajectory
    found = innovations(known, trajectory)
    trained = log_digest(known) in {part.sha256 for part in observer.logs}
    role = "calibration" if calibrated else "training" if trained else "test"
    own = replace(bounds, epsilon=bounds.epsilon_at(robot.R_BI), R_BI=np.array(robot.R_BI))
    x = observer.scaled(observer_samples(known, observer.inputs).x).astype(float)
    return CalibratedWalk(known, role, own, rows, errors, x, found.t, found.squared)


def methods_table(calibration: CalibratedWalk, tests: Sequence[CalibratedWalk]) -> pd.DataFrame:
    """Every method with the same errors: half widths, volume, and coverage of the tests."""
    bounds = calibration.bounds
    judged = [walk.errors for walk in tests if len(walk.errors)]
    rows: list[dict[str, object]] = []
    for method in CALIBRATORS:
        how = calibrator(method, bounds.gamma, bounds.confidence or CONFIDENCE)
        shaping, chosen = samples_for(how, calibration.errors, bounds.K)
        row: dict[str, object] = {"method": method, "errors": len(chosen)}
        try:
            region = region_of(how, shaping, chosen)
        except BoundsError as error:
            rows.append(row | {"note": str(error)})
            continue
        rows.append(row | _region_row(region, judged, how.label))
        if region.shape is not None:
            box = _region_row(region.box, judged, "the box that filters use")
            rows.append({"method": f"{method}, its box", "errors": len(chosen)} | box)
    return pd.DataFrame(rows)


def _region_row(region: Region, judged: Sequence[np.ndarray], note: str) -> dict[str, object]:
    widths = zip("xyz", region.epsilon, strict=True)
    row: dict[str, object] = {f"{axis} [m/s]": width for axis, width in widths}
    row["volume [(cm/s)^3]"] = 1e6 * region.volume
    if judged:
        held = [float(region.contains(errors).mean()) for errors in judged]
        row["coverage, mean of walks [%]"] = percent(np.mean(held))
        row["worst walk [%]"] = percent(min(held))
    return row | {"note": note}


def sequence_table(calibration: CalibratedWalk, others: Sequence[CalibratedWalk]) -> pd.DataFrame:
    """One row per walk: coverage with interval, the worst case, the alarm and two ways to widen."""
    usual = block_sizes(calibration.squared)
    rows: list[dict[str, object]] = []
    for walk in (calibration, *others):
        row: dict[str, object] = {"walk": walk.log.name, "role": walk.role}
        row["length [s]"] = round(len(walk.x) / RATE)
        row |= _held(walk) | {"alarm": "–"}
        if walk.role != "calibration":
            alarm = shift_alarm(usual, block_sizes(walk.squared))
            row["alarm"] = "none" if alarm.at is None else f"after {alarm.at:.0f} s"
            if len(walk.errors):
                row |= _kept(walk, calibration, alarm, usual)
        rows.append(row)
    return pd.DataFrame(rows)


def _held(walk: CalibratedWalk) -> dict[str, object]:
    if len(walk.errors) < walk.bounds.K:
        return {"coverage [%]": None, "95 % interval": "no reference"}
    found = coverage(walk.errors, walk.bounds)
    low, high = found.joint_interval
    lost, gamma = high < walk.bounds.gamma, walk.bounds.gamma
    worst = worst_case(coverage_by(walk.log, walk.rows, walk.errors, walk.bounds))
    return {
        "coverage [%]": percent(found.joint),
        "95 % interval": f"{100 * low:.0f}–{100 * high:.0f}",
        "bounds": "lost" if lost else "hold" if found.joint >= gamma else "not significant",
        "worst case": "–" if worst is None else f"{worst.case} {100 * worst.joint:.0f} %",
    }


def _kept(
    walk: CalibratedWalk, calibration: CalibratedWalk, alarm: Alarm, usual: np.ndarray
) -> dict[str, object]:
    epsilon, sizes = walk.bounds.epsilon, np.abs(walk.errors)
    factor = inflation(usual, walk.squared, alarm)
    at = np.searchsorted(walk.t, walk.log.t[walk.rows] - 1e-9).clip(max=len(walk.t) - 1)
    wide = sizes <= epsilon * factor[at][:, None]
    row: dict[str, object] = {
        "widened after alarm [%]": percent(wide.all(axis=1).mean()),
        "by": f"{np.exp(np.log(factor).mean()):.2f}",
    }
    # Inputs at the rows with errors, where the reference was measured.
    inputs = calibration.x[np.searchsorted(observer_rows(calibration.log), calibration.rows)]
    weighted = weighted_bounds(calibration.errors, inputs, walk.x, walk.bounds.gamma)
    if weighted is None:
        return row | {"weighted [%]": "no bound", "volume": None}
    inside = float((sizes <= weighted).all(axis=1).mean())
    volume = float(np.prod(weighted / epsilon))
    return row | {"weighted [%]": percent(inside), "volume": f"{volume:.2f}"}


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
