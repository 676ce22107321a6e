"""The Monte-Carlo study as files: tables, figures and a report, the paper's numbers beside ours."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.models.calibration.bias_model import WINDOW
from surefoot.scenarios.estimate.compare import prepare_folder
from surefoot.scenarios.reporting.html import Picture, Section, save_picture, write_report
from surefoot.scenarios.reporting.progress import percent_bar
from surefoot.scenarios.reporting.tables import to_csv, to_markdown
from surefoot.scenarios.studies.montecarlo.figures import (
    PAPER_ROWS,
    nees_figure,
    runtime_figure,
    time_figure,
)
from surefoot.scenarios.studies.montecarlo.qmc import PAPER, Accuracy, runtime_accuracy
from surefoot.scenarios.studies.montecarlo.settings import load_study
from surefoot.scenarios.studies.montecarlo.spread import on_cluster, on_workers
from surefoot.scenarios.studies.montecarlo.study import READINGS, Found, Row, Spread, run_study
from surefoot.scenarios.studies.montecarlo.update_report import (
    iteration_table,
    remark_table,
    update_pictures,
    update_sections,
)
from surefoot.scenarios.studies.montecarlo.update_study import (
    Iterated,
    Remark,
    study_iterations,
    study_remark,
)
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import whole_file


def montecarlo(
    out: Path, trials: int | None = None, seed: int | None = None, force=False,
    workers: int | None = None, cluster: str | None = None,
) -> Found:  # fmt: skip
    """Run the whole study and write it into `out`, its trials spread over `workers` processes or a
    Dask `cluster` where one is named. Raises SurefootError on bad input.
    """
    study = load_study()
    if workers is not None and cluster is not None:
        raise SurefootError("--workers and --cluster: one of the two")
    if workers is not None and workers < 1:
        raise SurefootError(f"--workers {workers}: at least 1")
    if trials is not None:
        if trials < 2:
            raise SurefootError("--trials: needs 2 or more, the table gives spreads")
        study = replace(study, trials=trials, beyond_trials=min(trials, study.beyond_trials))
    if seed is not None:
        if seed < 0:
            raise SurefootError("--seed: must be 0 or more")
        study = replace(study, seed=seed)
    prepare_folder(out, force)
    rng = np.random.default_rng([study.seed, 1000])
    with percent_bar("box moments") as tell:
        runtime = runtime_accuracy(rng, tell=tell)
    remarks = study_remark(rng, study.gammas, study.beyond_gamma, 1000)
    with percent_bar("trials") as tell:
        found = run_study(study, tell, _elsewhere(workers, cluster))
    with percent_bar("iterations") as tell:
        iterated = study_iterations(study, tell=tell)
    write_study(found, runtime, remarks, iterated, out, force)
    return found


def _elsewhere(workers: int | None, cluster: str | None) -> Spread | None:
    if cluster is not None:
        return lambda jobs: on_cluster(cluster, jobs)
    if workers is not None:
        return lambda jobs: on_workers(jobs, workers)
    return None


def write_study(
    found: Found,
    runtime: Sequence[Accuracy],
    remarks: Sequence[Remark],
    iterated: Sequence[Iterated],
    out: Path,
    force=False,
) -> None:
    """Write table.md, the tables as CSV, figures/ and report.html into `out`."""
    tables = {
        "runtime": runtime_table(runtime),
        "table": consistency_table(found.rows),
        "beyond": beyond_table(found.beyond),
        "remark": remark_table(remarks),
        "iterations": iteration_table(iterated),
    }
    numbers = {"table": numbers_table(found.rows), "beyond": numbers_table(found.beyond)}
    for name, table in tables.items():
        with whole_file(out / f"{name}.csv", force) as path:
            path.write_text(to_csv(numbers.get(name, table)), encoding="utf-8")
    pictures = {
        "runtime": Picture(
            runtime_figure(runtime),
            "Error against time of one evaluation: sampling, and our quadrature.",
        ),
        "nees_by_gamma": Picture(
            nees_figure(found.rows),
            "Mean position NEES over trials against gamma. A consistent filter is at 3 (line); the "
            "paper's values are the grey crosses.",
        ),
        "over_time": Picture(
            time_figure(found.rows, found.study.beyond_gamma, found.study.score_rate),
            "Position error (root mean square over trials) and NEES (mean over trials) in time.",
        ),
    } | update_pictures()
    for name, picture in pictures.items():
        save_picture(picture, out / "figures" / f"{name}.png", force)
    parts = sections(found, tables, pictures) + update_sections(remarks, iterated, pictures)
    text = [f"## {part.heading}\n\n{part.prose}\n\n{_markdown(part)}" for part in parts]
    with whole_file(out / "table.md", force) as path:
        path.write_text("\n".join(text), encoding="utf-8")
    write_report(out / "report.html", "The Monte-Carlo study of the coverage update", parts, force)


def sections(
    found: Found, tables: dict[str, pd.DataFrame], pictures: dict[str, Picture]
) -> list[Section]:
    """The report's parts."""
    s = found.study
    return [
        Section(
            "What was run",
            f"{s.trials} trials of {s.duration:g} s, the IMU at {s.imu_rate:g} Hz and the velocity "
            f"pseudo-measurement at {s.update_rate:g} Hz, seed {s.seed}; all else stands in "
            f"montecarlo.toml. The filters took {found.seconds:.0f} s in all.\n\n"
            "Position errors and NEES are against the truth in G, without alignment: each trial's "
            "start is drawn from the filter's own prior. Mean ± standard deviation over trials.\n\n"
            + summary(found),
        ),
        Section(
            "Runtime and accuracy of box moments",
            "Randomized quasi-Monte Carlo (Genz's separation of variables on a shifted lattice) "
            "and our deterministic rule, compiled and timed in one run on the same ten boxes; "
            "errors are root mean squares over boxes and shifts, in units of the prior's "
            "deviations. Columns named (paper) are the paper's own numbers, of other boxes and "
            "another machine.",
            tables["runtime"],
            (pictures["runtime"],),
        ),
        Section(
            "Unbiased and biased errors",
            "velocity is the EKF with a Gaussian velocity update. Bounds are each axis' quantile "
            "of |e|, read in two ways: at gamma, and at gamma^(1/3). The filters with a persistent "
            f"state know what lasts from {s.calibration_trials} separate calibration trials; the "
            "bounds of coverage_persistent are quantiles of the mixing part's mean over "
            f"{WINDOW:g} s. "
            "The paper does not give its duration, densities or mixture: its columns show trends.",
            tables["table"],
            (pictures["nees_by_gamma"], pictures["over_time"]),
        ),
        Section(
            "Beyond the paper",
            f"{s.beyond_trials} trials a regime, joint gamma {s.beyond_gamma:g}, bounds at "
            "gamma^(1/3). Each regime's errors are met by filters that were calibrated as its name "
            "says; each cell is RMSE [m] | NEES. The last column sets coverage_persistent beside "
            "velocity_persistent on the same trials: more or less accurate where the mean "
            "difference of RMSE is beyond two of its standard errors, more or less consistent "
            "likewise by how far, as a factor, each trial's NEES lies from 3.",
            tables["beyond"],
        ),
    ]


def summary(found: Found) -> str:
    """What came out, in words, at the level of the study's four filters and gamma^(1/3)."""
    gamma = found.study.beyond_gamma
    at = {
        (r.regime, r.filter): r.scores
        for r in found.rows
        if r.gamma in (None, gamma) and r.reading in (None, READINGS[1])
    }
    said = []
    for regime in ("unbiased", "biased"):
        parts = []
        for name in ("velocity", "coverage", "velocity_persistent", "coverage_persistent"):
            if (regime, name) in at:
                scores = at[regime, name]
                parts.append(f"{name} {scores.rmse.mean():.2f} m, {scores.mean_nees.mean():.1f}")
        said.append(f"{regime}: " + "; ".join(parts))
    return f"RMSE and NEES at gamma {gamma:g}, " + ". ".join(said) + ". 3 is consistent."


def consistency_table(rows: Sequence[Row]) -> pd.DataFrame:
    """The paper's second table: a row for each filter, gamma and reading, both regimes in it."""
    out = []
    biased = {(r.filter, r.gamma, r.reading): r for r in rows if r.regime == "biased"}
    for row in (r for r in rows if r.regime == "unbiased"):
        other = biased[row.filter, row.gamma, row.reading]
        line: dict[str, object] = {
            "filter": row.filter,
            "gamma": "–" if row.gamma is None else f"{row.gamma:.2f}",
            "bounds at": row.reading,
        }
        for name, scores in (("unbiased", row.scores), ("biased", other.scores)):
            line[f"RMSE [m] {name}"] = _spread(scores.rmse, 3)
            line[f"NEES {name}"] = _spread(scores.mean_nees, 2)
            line[f"active [%] {name}"] = f"{100 * scores.active.mean():.0f}"
        paper = PAPER_ROWS.get(row.gamma) if row.filter in ("velocity", "coverage") else None
        for k, name in enumerate(("RMSE unb.", "RMSE bias.", "NEES unb.", "NEES bias.")):
            line[f"{name} (paper)"] = paper[k] if paper else None
        out.append(line)
    return pd.DataFrame(out)


def beyond_table(rows: Sequence[Row]) -> pd.DataFrame:
    """A row for each regime, a column for each filter: RMSE and NEES; and where coverage pays."""
    table: dict[str, dict[str, object]] = {}
    for row in rows:
        line = table.setdefault(row.regime, {"regime": row.regime})
        nees = _spread(row.scores.mean_nees, 1)
        line[row.filter] = f"{row.scores.rmse.mean():.3f} | {nees}"
    by = {(r.regime, r.filter): r.scores for r in rows}
    for name, line in table.items():
        ours, rival = by[name, "coverage_persistent"], by[name, "velocity_persistent"]
        off = [np.abs(np.log(s.mean_nees / 3.0)) for s in (ours, rival)]
        line["coverage beside velocity"] = (
            f"{_verdict(ours.rmse - rival.rmse)} accurate, {_verdict(off[0] - off[1])} consistent"
        )
    return pd.DataFrame(list(table.values()))


def _verdict(excess: np.ndarray) -> str:
    """Whether paired differences (T,), less being better, are beyond two standard errors of 0."""
    error = excess.std(ddof=1) / np.sqrt(len(excess))
    if abs(excess.mean()) <= 2.0 * error:
        return "as"
    return "less" if excess.mean() > 0 else "more"


def numbers_table(rows: Sequence[Row]) -> pd.DataFrame:
    """Every row with all its numbers, for a program to read."""
    out = []
    for row in rows:
        line = {"regime": row.regime, "filter": row.filter, "gamma": row.gamma}
        line["reading"] = row.reading
        epsilon = np.full(3, np.nan) if row.epsilon is None else row.epsilon
        line |= {f"epsilon_{axis}": float(e) for axis, e in zip("xyz", epsilon, strict=True)}
        for name, values in (("rmse", row.scores.rmse), ("nees", row.scores.mean_nees)):
            line[f"{name}_mean"] = float(values.mean())
            line[f"{name}_std"] = float(values.std(ddof=1))
            line[f"{name}_median"] = float(np.median(values))
        out.append(line | {"active": float(row.scores.active.mean())})
    return pd.DataFrame(out)


def runtime_table(rows: Sequence[Accuracy]) -> pd.DataFrame:
    """The paper's first table, its own numbers in the columns that say so."""
    out = []
    for row in rows:
        paper = PAPER.get(row.samples or 0, (None,) * 4)
        line = {"samples": "ours" if row.samples is None else str(row.samples)}
        ours = (row.milliseconds, row.probability, row.mean, row.covariance)
        names = ("time [ms]", "prob. error", "mean error", "cov. error")
        line |= {
            n: f"{v:.4f}" if "time" in n else f"{v:.2e}" for n, v in zip(names, ours, strict=True)
        }
        line |= {
            f"{n} (paper)": "–" if v is None else f"{v:g}"
            for n, v in zip(names, paper, strict=True)
        }
        out.append(line)
    return pd.DataFrame(out)


def _spread(values: np.ndarray, digits: int) -> str:
    return f"{values.mean():.{digits}f} ± {values.std(ddof=1):.{digits}f}"


def _markdown(part: Section) -> str:
    return "" if part.table is None else to_markdown(part.table) + "\n"
