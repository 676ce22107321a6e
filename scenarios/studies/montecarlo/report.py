"""The Monte-Carlo study as files: tables, figures and a report, the paper's numbers beside ours."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.models.calibration.bias_model import BOUNDED_MEAN
from surefoot.scenarios.estimate.compare import prepare_folder
from surefoot.scenarios.reporting.html import Picture, Section, save_picture
from surefoot.scenarios.reporting.progress import percent_bar
from surefoot.scenarios.studies.montecarlo.figures import (
    PAPER_ROWS,
    nees_figure,
    runtime_figure,
    time_figure,
)
from surefoot.scenarios.studies.montecarlo.qmc import PAPER, Accuracy, runtime_accuracy
from surefoot.scenarios.studies.montecarlo.settings import load_study
from surefoot.scenarios.studies.montecarlo.study import (
    READINGS,
    FilterScores,
    Results,
    run_montecarlo,
)
from surefoot.scenarios.studies.montecarlo.update import iteration_table, update_illustration
from surefoot.scenarios.studies.pages import origin_of, write_page, write_results
from surefoot.sim.common.errors import SurefootError

_TITLE = "The Monte-Carlo study of the coverage update"
FILTERS = ("velocity", "coverage", "velocity_persistent", "coverage_persistent")


def montecarlo(
    out: Path,
    trials: int | None = None,
    seed: int | None = None,
    force: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    page: Path | None = None,
) -> str:
    """Run the whole study and write it into `out`; returns the text of its tables.

    Args:
        out: folder for table.md, the tables as CSV, figures/ and report.html.
        trials: in each regime; those of montecarlo.toml where left out.
        seed: the file's where left out.
        force: overwrite what is in the folder.
        workers: processes that share the trials; one a core where left out.
        cluster: address of a Dask scheduler whose workers share them instead.
        page: page of results (Markdown) to write as well.

    Raises SurefootError on bad input.
    """
    study = load_study()
    if workers is not None and cluster is not None:
        raise SurefootError("--workers and --cluster: one of the two")
    if workers is not None and workers < 1:
        raise SurefootError(f"--workers {workers}: at least 1")
    if trials is not None:
        if trials < 2:
            raise SurefootError("--trials: needs 2 or more, the tables give standard deviations")
        fewer = replace(study.beyond, trials=min(trials, study.beyond.trials))
        study = replace(study, trials=trials, beyond=fewer)
    if seed is not None:
        if seed < 0:
            raise SurefootError("--seed: must be 0 or more")
        study = replace(study, seed=seed)
    prepare_folder(out, force)
    with percent_bar("box moments") as progress:
        rng = np.random.default_rng([study.seed, 1000])
        runtime = runtime_accuracy(rng, progress=progress)
    results = run_montecarlo(study, workers or os.cpu_count() or 1, cluster)
    return write_study(results, runtime, out, force, page)


def write_study(
    results: Results,
    runtime: Sequence[Accuracy],
    out: Path,
    force: bool = False,
    page: Path | None = None,
) -> str:
    """Write tables, figures and report, and the page; returns the tables' text.

    Args:
        results: of the trials.
        runtime: and accuracy of the moments.
        out: folder.
        force: whether files may be replaced.
        page: of the documentation, or None.
    """
    pictures = study_pictures(results, runtime)
    sections = study_sections(results, runtime, pictures)
    for name, picture in pictures.items():
        save_picture(picture, out / "figures" / f"{name}.png", force)
    if page:
        write_page(page, _TITLE, sections, origin_of(__name__, "surefoot montecarlo"))
    tables = {
        "runtime": runtime_table(runtime),
        "table": numbers_table(results.paper),
        "beyond": numbers_table(results.beyond),
        "iterations": iteration_table(results.iterated),
    }
    return write_results(out, _TITLE, sections, tables, force)


def study_pictures(results: Results, runtime: Sequence[Accuracy]) -> dict[str, Picture]:
    """The study's figures by name."""
    study = results.study
    return {
        "runtime": Picture(
            runtime_figure(runtime),
            "Error against time of one evaluation: sampling, and our quadrature.",
        ),
        "nees_by_gamma": Picture(
            nees_figure(results.paper),
            "Mean position NEES over trials against gamma. A consistent filter is at 3 (line); the "
            "paper's values are the grey crosses.",
        ),
        "over_time": Picture(
            time_figure(results.paper, study.beyond.gamma, study.score_rate),
            "Position error (root mean square over trials) and NEES (mean over trials) in time.",
        ),
        "update": Picture(
            update_illustration(),
            "One coverage update on one axis (above) and two (below), by the filter's own kernel: "
            "(a) the prior, whose mass in the set C is less than gamma; (b) the posterior of "
            "Theorem 1, the prior rescaled inside and outside the set; (c) the Gaussian of the "
            "same mean and covariance. Its mass pi+ lies between pi and gamma, as the paper "
            "remarks and `estimator/updates/coverage.py` proves.",
        ),
    }


def study_sections(
    results: Results, runtime: Sequence[Accuracy], pictures: dict[str, Picture]
) -> list[Section]:
    """The report's parts."""
    s = results.study
    return [
        Section(
            "What was run",
            f"{s.trials} trials of {s.duration:g} s, the IMU at {s.imu_rate:g} Hz and the velocity "
            f"pseudo-measurement at {s.update_rate:g} Hz, seed {s.seed}; all else is in "
            f"montecarlo.toml. The filters took {results.seconds:.0f} s in all.\n\n"
            "Position errors and NEES are against the truth in G, without alignment: each trial's "
            "start is drawn from the filter's own prior. Mean ± standard deviation over trials.\n\n"
            + level_summary(results),
        ),
        Section(
            "Runtime and accuracy of box moments",
            "Randomized quasi-Monte Carlo (Genz's separation of variables on a shifted lattice) "
            "and our deterministic rule, compiled and timed in one run on the same ten boxes; "
            "errors are root mean squares over boxes and shifts, in units of the prior's "
            "deviations. Columns named (paper) are the paper's own numbers, of other boxes and "
            "another machine.",
            runtime_table(runtime),
            (pictures["runtime"],),
        ),
        Section(
            "Unbiased and biased errors",
            "velocity is the EKF with a Gaussian velocity update. Bounds are each axis' quantile "
            "of |e|, read in two ways: at gamma, and at gamma^(1/3). The filters with a persistent "
            f"state take its prior from {s.calibration_trials} separate calibration trials; the "
            "bounds of coverage_persistent are quantiles of the mixing part's mean over "
            f"{BOUNDED_MEAN:g} s. The paper does not give its duration, densities or mixture: its "
            "columns show trends.",
            consistency_table(results.paper),
            (pictures["nees_by_gamma"], pictures["over_time"]),
        ),
        Section(
            "Beyond the paper",
            f"{s.beyond.trials} trials a regime, joint gamma {s.beyond.gamma:g}, bounds at "
            "gamma^(1/3); the filters were calibrated as the regime's name says. Each cell is "
            "RMSE [m] | NEES. The last column sets coverage_persistent beside "
            "velocity_persistent on the same trials: more or less accurate where the mean "
            "difference of RMSE is beyond two of its standard errors, more or less consistent "
            "likewise by how far, as a factor, each trial's NEES lies from 3.",
            beyond_table(results.beyond),
        ),
        Section(
            "One update, and iterated projections",
            "The projection repeated within one update (`iterations`), bounds at gamma^(1/3), on "
            "the first trials of the tables above. Mean ± standard deviation over trials.",
            iteration_table(results.iterated),
            (pictures["update"],),
        ),
    ]


def level_summary(results: Results) -> str:
    """RMSE and NEES at the level of the study's four filters and gamma^(1/3)."""
    gamma = results.study.beyond.gamma
    scores = {
        (row.regime, row.setting.filter): row.scores
        for row in results.paper
        if row.setting.gamma in (None, gamma) and row.setting.reading in (None, READINGS[1])
    }
    regimes = []
    for regime in ("unbiased", "biased"):
        parts = [
            f"{name} {own.rmse.mean():.2f} m, {own.mean_nees.mean():.1f}"
            for name in FILTERS
            if (own := scores.get((regime, name)))
        ]
        regimes.append(f"{regime}: " + "; ".join(parts))
    return f"RMSE and NEES at gamma {gamma:g}, " + ". ".join(regimes) + ". 3 is consistent."


def consistency_table(rows: Sequence[FilterScores]) -> pd.DataFrame:
    """The paper's second table: a row for each filter, gamma and reading, both regimes in it."""
    table = []
    regimes = [[r for r in rows if r.regime == name] for name in ("unbiased", "biased")]
    for unbiased, biased in zip(*regimes, strict=True):
        s = unbiased.setting
        line: dict[str, object] = {
            "filter": s.filter,
            "gamma": "–" if s.gamma is None else f"{s.gamma:.2f}",
            "bounds at": s.reading,
        }
        for row in (unbiased, biased):
            line[f"RMSE [m] {row.regime}"] = _mean_std(row.scores.rmse, 3)
            line[f"NEES {row.regime}"] = _mean_std(row.scores.mean_nees, 2)
            line[f"active [%] {row.regime}"] = f"{100 * row.scores.active.mean():.0f}"
        paper = PAPER_ROWS.get(s.gamma) if s.filter in ("velocity", "coverage") else None
        names = ("RMSE unb.", "RMSE bias.", "NEES unb.", "NEES bias.")
        table.append(line | {f"{name} (paper)": paper and paper[k] for k, name in enumerate(names)})
    return pd.DataFrame(table)


def beyond_table(rows: Sequence[FilterScores]) -> pd.DataFrame:
    """A row for each regime, a column for each filter: RMSE and NEES; and where coverage pays."""
    scores: dict[str, dict[str, FilterScores]] = {}
    for row in rows:
        scores.setdefault(row.regime, {})[row.setting.filter] = row
    table = []
    for regime, own in scores.items():
        line = {"regime": regime}
        for name, row in own.items():
            line[name] = f"{row.scores.rmse.mean():.3f} | {_mean_std(row.scores.mean_nees, 1)}"
        pair = [own[name].scores for name in ("coverage_persistent", "velocity_persistent")]
        off = [np.abs(np.log(s.mean_nees / 3.0)) for s in pair]
        line["coverage beside velocity"] = (
            f"{_verdict(pair[0].rmse - pair[1].rmse)} accurate, "
            f"{_verdict(off[0] - off[1])} consistent"
        )
        table.append(line)
    return pd.DataFrame(table)


def numbers_table(rows: Sequence[FilterScores]) -> pd.DataFrame:
    """Every row with all its numbers, for a program to read."""
    table = []
    for row in rows:
        s = row.setting
        line: dict[str, object] = {
            "regime": row.regime,
            "filter": s.filter,
            "gamma": s.gamma,
            "reading": s.reading,
        }
        epsilon = np.full(3, np.nan) if s.epsilon is None else s.epsilon
        line |= {f"epsilon_{axis}": float(e) for axis, e in zip("xyz", epsilon, strict=True)}
        for name, values in (("rmse", row.scores.rmse), ("nees", row.scores.mean_nees)):
            line[f"{name}_mean"] = float(values.mean())
            line[f"{name}_std"] = float(values.std(ddof=1))
            line[f"{name}_median"] = float(np.median(values))
        table.append(line | {"active": float(row.scores.active.mean())})
    return pd.DataFrame(table)


def runtime_table(rows: Sequence[Accuracy]) -> pd.DataFrame:
    """The paper's first table, its own numbers in the columns that say so."""
    names = ("time [ms]", "prob. error", "mean error", "cov. error")
    table = []
    for row in rows:
        ours = (row.milliseconds, row.probability, row.mean, row.covariance)
        paper = PAPER.get(row.samples or 0, (None,) * 4)
        line = {"samples": "ours" if row.samples is None else str(row.samples)}
        for name, value in zip(names, ours, strict=True):
            line[name] = f"{value:.4f}" if name == "time [ms]" else f"{value:.2e}"
        for name, value in zip(names, paper, strict=True):
            line[f"{name} (paper)"] = "–" if value is None else f"{value:g}"
        table.append(line)
    return pd.DataFrame(table)


def _verdict(excess: np.ndarray) -> str:
    """Whether paired differences (T,), less being better, are beyond two standard errors of 0."""
    error = excess.std(ddof=1) / np.sqrt(len(excess))
    if abs(excess.mean()) <= 2.0 * error:
        return "as"
    return "less" if excess.mean() > 0 else "more"


def _mean_std(values: np.ndarray, digits: int) -> str:
    return f"{values.mean():.{digits}f} ± {values.std(ddof=1):.{digits}f}"
