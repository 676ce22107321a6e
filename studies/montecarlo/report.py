"""Output files of the Monte-Carlo study: tables, figures and a report, with the paper's numbers."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from studies.command import OutputFolder
from studies.montecarlo.figures import (
    PAPER_ROWS,
    nees_figure,
    runtime_figure,
    time_figure,
)
from studies.montecarlo.qmc import PAPER, Accuracy, runtime_accuracy
from studies.montecarlo.settings import load_study
from studies.montecarlo.study import (
    OUTER,
    READINGS,
    FilterScores,
    Results,
    run_montecarlo,
)
from studies.montecarlo.update import iteration_table, update_illustration
from surefoot.extend import BOUNDED_MEAN, SurefootError, check_limit
from surefoot.scenarios.reporting import (
    Picture,
    Section,
    origin_of,
    percent_bar,
    refuse_full,
    save_figure,
    whole_folder,
    write_page,
    write_results,
)

_TITLE = "The Monte-Carlo study of the coverage update"


@dataclass(frozen=True)
class MonteCarlo:
    """Reproduce the paper's runtime-accuracy and consistency tables, with further regimes."""

    out: OutputFolder
    """Folder for the tables and report.html."""
    trials: int | None = None
    """Trials in each regime, at least two; by default those of montecarlo.toml."""
    seed: int | None = None
    """Seed of the trials; by default that of montecarlo.toml."""
    workers: int | None = None
    """Number of parallel processes on this machine; by default one for each core."""
    cluster: str | None = None
    """Address of a Dask scheduler that runs the work, such as tcp://127.0.0.1:8786."""
    data: Path | None = None
    """Folder of finished regimes, which later runs reuse; by default `cases` in the output."""
    page: Path | None = None
    """Page of results to write as well, such as docs/results/montecarlo.md."""
    force: bool = False
    """Replace what an earlier run of this study wrote."""

    def run(self) -> None:
        print(montecarlo(self))
        print(f"report: {self.out / 'report.html'}")


def montecarlo(options: MonteCarlo) -> str:
    """Run the whole study and write it; returns the text of its tables.

    Raises SurefootError on bad input.
    """
    study = load_study()
    trials, seed, workers, out = options.trials, options.seed, options.workers, options.out
    if workers is not None and options.cluster is not None:
        raise SurefootError("--workers and --cluster: one of the two")
    if workers is not None and workers < 1:
        raise SurefootError(f"--workers {workers}: at least 1")
    if trials is not None:
        if trials < 2:
            raise SurefootError("--trials: needs 2 or more, the tables give standard deviations")
        check_limit("items", trials, "--trials")
        fewer = replace(study.beyond, trials=min(trials, study.beyond.trials))
        study = replace(study, trials=trials, beyond=fewer)
    if seed is not None:
        if seed < 0:
            raise SurefootError("--seed: must be 0 or more")
        study = replace(study, seed=seed)
    killed = out.is_dir() and [path.name for path in out.iterdir()] == ["cases"]
    if not killed:
        refuse_full(out, options.force)
    with percent_bar("box moments") as progress:
        rng = np.random.default_rng([study.seed, 1000])
        runtime = runtime_accuracy(rng, progress=progress)
    data = options.data or out / "cases"
    results = run_montecarlo(study, workers or os.cpu_count() or 1, options.cluster, data)
    return write_study(results, runtime, out, options.force, options.page)


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
        runtime: run time and accuracy of the moments.
        out: folder.
        force: whether files may be replaced.
        page: of the documentation, or None.
    """
    pictures = study_pictures(results, runtime)
    sections = study_sections(results, runtime, pictures)
    if page:
        whole = results.study.trials == load_study().trials
        fewer = f"python -m studies.montecarlo --trials {results.study.trials}"
        command = "make study-montecarlo" if whole else fewer
        write_page(page, _TITLE, sections, origin_of(__name__, command))
    tables = {"table": numbers_table(results.paper), "beyond": numbers_table(results.beyond)}
    with whole_folder(out, force) as folder:
        for name, picture in pictures.items():
            save_figure(picture.figure, folder / "figures" / f"{name}.png")
        return write_results(folder, _TITLE, sections, tables)


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
            time_figure(results.paper, study.duration),
            "Position error (root mean square over trials) and NEES (mean over trials) in time, "
            f"gamma {study.beyond.gamma:g}, bounds at gamma^(1/3).",
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
    """The report's sections: findings at one gamma, figures, setting, and the whole tables."""
    s = results.study
    paper = consistency_table(results.paper)
    rest = f"{paper_findings(results.paper, s.beyond.gamma)} {runtime_findings(runtime)}"
    return [
        Section(
            "Findings", f"{beyond_findings(results)}\n\n{rest}", at_gamma(paper, s.beyond.gamma)
        ),
        Section("Figures", pictures=tuple(pictures.values())),
        Section(
            "Setting",
            f"{s.trials} trials of {s.duration:g} s, the IMU at {s.imu_rate:g} Hz and the velocity "
            f"pseudo-measurement at {s.update_rate:g} Hz, seed {s.seed}; all else is in "
            "montecarlo.toml. Position errors and NEES are against the truth in G, without "
            "alignment: each trial's start is drawn from the filter's own prior. Mean ± standard "
            "deviation over trials.\n\n"
            "velocity is the EKF with a Gaussian velocity update. Bounds are each axis' quantile "
            "of |e|, at gamma, at gamma^(1/3), or the outer quantiles that the paper names for its "
            "biased regime. The filters with a persistent state take its prior from "
            f"{s.calibration_trials} separate calibration trials; the bounds of "
            "coverage_persistent are quantiles of the mixing part's mean over "
            f"{BOUNDED_MEAN:g} s. The paper does not give its duration, densities or mixture: its "
            "columns show trends.",
        ),
        Section(
            "Runtime and accuracy of box moments",
            "Randomized quasi-Monte Carlo (Genz's separation of variables on a shifted lattice) "
            "and our deterministic rule, timed in one run on the same ten boxes; errors are root "
            "mean squares in units of the prior's standard deviations. The paper's own numbers are "
            "of other boxes and another machine.",
            runtime_table(runtime),
            file="runtime",
        ),
        Section("Unbiased and biased errors", "At every gamma.", paper, file="paper"),
        Section(
            "Beyond the paper",
            f"{s.beyond.trials} trials a regime, joint gamma {s.beyond.gamma:g}, bounds at "
            "gamma^(1/3); calibrated as the regime's name says. Cells: RMSE [m] | NEES. The last "
            "column compares coverage_persistent with velocity_persistent on the same trials: more "
            "or less accurate where the mean difference of RMSE is beyond two standard errors, "
            "more or less consistent likewise by how far each NEES is from 3, as a factor.",
            beyond_table(results),
            file="regimes",
        ),
        Section(
            "Iterated projections",
            "The projection repeated within one update, bounds at gamma^(1/3), on the first trials "
            "of the tables above.",
            iteration_table(results.iterated),
            file="iterations",
        ),
    ]


def at_gamma(table: pd.DataFrame, gamma: float) -> pd.DataFrame:
    """The rows of a consistency table at one gamma or none, with RMSE and NEES alone."""
    shown = [name for name in table if not name.endswith("(paper)") and "active" not in name]
    return table.loc[table["gamma"].isin(["–", f"{gamma:.2f}"]), shown].drop(columns="gamma")


def paper_findings(rows: Sequence[FilterScores], gamma: float) -> str:
    """Sentences on each regime: NEES of the EKF and, with the reading of the bounds that is nearest
    to the paper over all gammas, NEES and RMSE of coverage at one gamma; with the paper's.
    """
    sentences = []
    for k, regime in enumerate(("unbiased", "biased")):
        own = [row for row in rows if row.regime == regime]
        (ekf,) = (row for row in own if row.filter == "velocity")
        paper = {g: _number(row[2 + k]) for g, row in PAPER_ROWS.items()}
        base = paper.pop(None)
        off, at = {}, {}
        for reading in READINGS:
            of = [r for r in own if (r.filter, r.reading) == ("coverage", reading)]
            known = [np.log(r.nees[0] / paper[r.gamma]) for r in of if r.gamma in paper]
            off[reading] = np.mean(np.abs(known))
            at[reading] = min(of, key=lambda r: abs((r.gamma or 0.0) - gamma))
        near = min(off, key=lambda name: off[name])
        row = at[near]
        sentences.append(
            f"With {regime} errors the EKF has a NEES of {ekf.nees[0]:.1f} (the paper: "
            f"{base:.1f}). Nearest to the paper's NEES of coverage are bounds at {near}: at γ = "
            f"{row.gamma:g} a NEES of {row.nees[0]:.1f} (the paper: {paper[row.gamma]:.1f}) with "
            f"{row.rmse[0] / ekf.rmse[0]:.1f} times the EKF's RMSE."
        )
    return " ".join(sentences)


def beyond_findings(results: Results) -> str:
    """Number of regimes beyond the paper in which coverage_persistent is better, equal or worse."""
    words = []
    for k, what in enumerate(("accurate", "consistent")):
        verdicts = [text.split(", ")[k].split()[0] for text in results.beside.values()]
        more, same, less = (verdicts.count(word) for word in ("more", "as", "less"))
        words.append(f"more {what} in {more}, as {what} in {same} and less in {less}")
    return (
        f"Compared with `velocity_persistent` in {len(results.beside)} regimes beyond the paper's "
        f"two, `coverage_persistent` is {', and '.join(words)}."
    )


def runtime_findings(rows: Sequence[Accuracy]) -> str:
    """Sentence: time and error of our box moments, and of the paper's sampling with N = 1000."""
    (ours,), (theirs,) = ([r for r in rows if r.samples == n] for n in (None, 1000))
    return (
        f"Moments of a box take {1e3 * ours.milliseconds:.1f} us with an error of the covariance "
        f"of {ours.covariance:.0e}; quasi-Monte Carlo with {theirs.samples} samples takes "
        f"{1e3 * theirs.milliseconds:.1f} us with an error of {theirs.covariance:.0e}."
    )


def consistency_table(rows: Sequence[FilterScores]) -> pd.DataFrame:
    """The paper's second table: one row for each filter, gamma and reading, with both regimes."""
    table = []
    regimes = [[r for r in rows if r.regime == name] for name in ("unbiased", "biased")]
    for unbiased, biased in zip(*regimes, strict=True):
        line: dict[str, object] = {
            "filter": unbiased.filter,
            "gamma": "–" if unbiased.gamma is None else f"{unbiased.gamma:.2f}",
            "bounds at": unbiased.reading,
        }
        for row in (unbiased, biased):
            line[f"RMSE [m] {row.regime}"] = f"{row.rmse[0]:.3f} ± {row.rmse[1]:.3f}"
            line[f"NEES {row.regime}"] = f"{row.nees[0]:.2f} ± {row.nees[1]:.2f}"
            line[f"active [%] {row.regime}"] = f"{100 * row.active:.0f}"
        known = unbiased.filter in ("velocity", "coverage")
        paper = PAPER_ROWS.get(unbiased.gamma) if known else None
        names = ("RMSE unb.", "RMSE bias.", "NEES unb.", "NEES bias.")
        table.append(line | {f"{name} (paper)": paper and paper[k] for k, name in enumerate(names)})
    return pd.DataFrame(table)


def beyond_table(results: Results) -> pd.DataFrame:
    """RMSE and NEES by regime and filter, and coverage compared with the Gaussian filter."""
    table: dict[str, dict[str, str]] = {}
    for row in results.beyond:
        name = f"{row.filter} (outer)" if row.reading == OUTER else row.filter
        cell = f"{row.rmse[0]:.3f} | {row.nees[0]:.1f} ± {row.nees[1]:.1f}"
        table.setdefault(row.regime, {"regime": row.regime})[name] = cell
    for regime, verdict in results.beside.items():
        table[regime]["coverage beside velocity"] = verdict
    return pd.DataFrame(list(table.values()))


def numbers_table(rows: Sequence[FilterScores]) -> pd.DataFrame:
    """Every row with all its numbers, for a program to read."""
    table = []
    for row in rows:
        line: dict[str, object] = {
            name: getattr(row, name) for name in ("regime", "filter", "gamma", "reading")
        }
        for k, axis in enumerate("xyz"):
            line[f"epsilon_{axis}"] = row.epsilon[k] if row.epsilon else np.nan
        for name, values in (("rmse", row.rmse), ("nees", row.nees)):
            line |= dict(
                zip((f"{name}_mean", f"{name}_std", f"{name}_median"), values, strict=True)
            )
        table.append(line | {"active": row.active})
    return pd.DataFrame(table)


def runtime_table(rows: Sequence[Accuracy]) -> pd.DataFrame:
    """The paper's first table, with our and the paper's numbers in separate columns."""
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


def _number(text: str) -> float:
    """The mean of "0.61 ± 0.25"."""
    return float(text.split()[0])
