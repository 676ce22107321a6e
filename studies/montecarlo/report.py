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
    tables = {
        "runtime": runtime_table(runtime),
        "table": numbers_table(results.paper),
        "beyond": numbers_table(results.beyond),
        "iterations": iteration_table(results.iterated),
    }
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
    """The report's sections."""
    s = results.study
    return [
        Section(
            "What was run",
            f"{s.trials} trials of {s.duration:g} s, the IMU at {s.imu_rate:g} Hz and the velocity "
            f"pseudo-measurement at {s.update_rate:g} Hz, seed {s.seed}; all else is in "
            "montecarlo.toml.\n\n"
            "Position errors and NEES are against the truth in G, without alignment: each trial's "
            "start is drawn from the filter's own prior. Mean ± standard deviation over trials.",
        ),
        Section(
            "Runtime and accuracy of box moments",
            "Randomized quasi-Monte Carlo (Genz's separation of variables on a shifted lattice) "
            "and our deterministic rule, compiled and timed in one run on the same ten boxes; "
            "errors are root mean squares over boxes and shifts, in units of the prior's "
            "standard deviations. Columns named (paper) are the paper's own numbers, of other "
            "boxes and another machine.",
            runtime_table(runtime),
            (pictures["runtime"],),
        ),
        Section(
            "Unbiased and biased errors",
            "velocity is the EKF with a Gaussian velocity update. Bounds are each axis' quantile "
            "of |e|, read in four ways: at gamma, at gamma^(1/3), and as the outer quantiles that "
            "the paper names for its biased regime. The filters with a persistent "
            f"state take its prior from {s.calibration_trials} separate calibration trials; the "
            "bounds of coverage_persistent are quantiles of the mixing part's mean over "
            f"{BOUNDED_MEAN:g} s. The paper does not give its duration, densities or mixture: its "
            "columns show trends.\n\n" + paper_findings(results.paper),
            consistency_table(results.paper),
            (pictures["nees_by_gamma"], pictures["over_time"]),
        ),
        Section(
            "Beyond the paper",
            f"{s.beyond.trials} trials a regime, joint gamma {s.beyond.gamma:g}, bounds at "
            "gamma^(1/3); the filters were calibrated as the regime's name says. Each cell is "
            "RMSE [m] | NEES; coverage once more with outer quantiles. The last column sets "
            "coverage_persistent beside "
            "velocity_persistent on the same trials: more or less accurate where the mean "
            "difference of RMSE is beyond two of its standard errors, more or less consistent "
            "likewise by how far, as a factor, each trial's NEES lies from 3.\n\n"
            + beyond_findings(results),
            beyond_table(results),
        ),
        Section(
            "One update, and iterated projections",
            "The projection repeated within one update (`iterations`), bounds at gamma^(1/3), on "
            "the first trials of the tables above. Mean ± standard deviation over trials.",
            iteration_table(results.iterated),
            (pictures["update"],),
        ),
    ]


def paper_findings(rows: Sequence[FilterScores]) -> str:
    """Description of each regime: NEES and RMSE relative to the EKF's by reading, with the paper's,
    and the reading whose NEES is nearest to the paper's.
    """
    parts = []
    for k, regime in enumerate(("unbiased", "biased")):
        own = [row for row in rows if row.regime == regime]
        (ekf,) = (row for row in own if row.filter == "velocity")
        paper = {g: (_number(row[k]), _number(row[2 + k])) for g, row in PAPER_ROWS.items()}
        base = paper.pop(None)
        lines, off = [], {}
        for reading in READINGS:
            of = [r for r in own if (r.filter, r.reading) == ("coverage", reading)]
            found = [(r.rmse[0], r.nees[0]) for r in of]
            lines.append(f"coverage, bounds at {reading}: {_span(found, ekf.rmse[0])}")
            known = [np.log(r.nees[0] / paper[r.gamma][1]) for r in of if r.gamma in paper]
            off[reading] = np.mean(np.abs(known))
        lines.append(f"the paper's coverage: {_span(list(paper.values()), base[0])}")
        parts.append(
            f"{regime.capitalize()}. NEES of the EKF {ekf.nees[0]:.1f} (the paper: {base[1]:.1f}); "
            + "; ".join(lines)
            + f". Nearest to the paper's NEES are bounds at {min(off, key=lambda name: off[name])}."
        )
    return "\n\n".join(parts)


def beyond_findings(results: Results) -> str:
    """Number of regimes beyond the paper in which coverage_persistent is better, equal or worse."""
    words = []
    for k, what in enumerate(("accurate", "consistent")):
        verdicts = [text.split(", ")[k].split()[0] for text in results.beside.values()]
        counts = ", ".join(f"{word} in {verdicts.count(word)}" for word in ("more", "as", "less"))
        words.append(f"{what}: {counts}")
    return f"Of {len(results.beside)} regimes, coverage_persistent is " + "; ".join(words) + "."


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


def _span(found: Sequence[tuple[float, float]], base: float) -> str:
    """Ranges of the RMSE relative to the EKF's, `base` [m], and of the NEES."""
    rmse, own_nees = zip(*found, strict=True)
    return (
        f"NEES {min(own_nees):.1f} to {max(own_nees):.1f}, RMSE {min(rmse) / base:.1f} to "
        f"{max(rmse) / base:.1f} times the EKF's"
    )
