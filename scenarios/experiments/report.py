"""Run an experiment from its file to a folder with tables, figures, report and recordings."""

# pyright: reportArgumentType=false, reportGeneralTypeIssues=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportReturnType=false, reportAttributeAccessIssue=false
# (pandas' stubs take a selection for any of several types)

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from shutil import copyfile

import pandas as pd

from surefoot.estimator.metrics import CONSISTENT
from surefoot.scenarios.datasets.simulate import seed_range
from surefoot.scenarios.estimate.estimators import estimator_named, traits
from surefoot.scenarios.experiments.catalog import SUITES
from surefoot.scenarios.experiments.figures import (
    FACTOR,
    by_sequence,
    errors_figure,
    gamma_sweep,
    paths,
)
from surefoot.scenarios.experiments.file import Experiment
from surefoot.scenarios.experiments.findings import suite_findings
from surefoot.scenarios.experiments.run import Outcome, run
from surefoot.scenarios.experiments.tables import (
    TABLE_MEANINGS,
    published,
    report_tables,
    shown_first,
    slug,
    tidy,
)
from surefoot.scenarios.reporting.html import Picture, Section
from surefoot.scenarios.reporting.pages import origin_of, write_page, write_results
from surefoot.scenarios.reporting.tables import in_terminal
from surefoot.scenarios.settings import GridSettings
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import (
    clear_debris,
    force_option,
    refuse_overwrite,
    whole_file,
    whole_folder,
)

SPREAD = (
    "Mean ± standard deviation over seeds. Each walk starts from an error drawn from the filters' "
    "declared prior."
)
LEARNT = (
    "Averages over the test sequences. walks: drawn ones that the observers were trained on, 0 for "
    "the one training sequence, as in the paper. inputs: those of the observers, q,dq,tau in the "
    "paper; feet is leg odometry computed with the model as drawn. method: how the bound of each "
    "axis is calibrated, conformal at level γ^(1/3), outer at the 99 % quantile."
)


def experiment(file: str | Path, settings: GridSettings) -> pd.DataFrame:
    """Run the grid of an experiment file, or of a bundled suite ("spot" or "vision60"), and print
    the averages; returns every row.

    An interrupted run continues from its cache, one on another machine from its finished rows.
    Raises SurefootError for bad input, and where `out` contains a finished run without `force`.
    """
    out, force = settings.out, settings.force
    found = Experiment.load(file)
    if settings.workers < 1:
        raise SurefootError(f"workers {settings.workers}: at least 1")
    if settings.seeds is not None:
        found = replace(found, seeds=tuple(seed_range(settings.seeds)))
    if (out / "report.html").exists() and not force:
        raise SurefootError(f"{out}: has a finished run; give {force_option()} to write it again")
    names = "results.csv", "results.parquet", "averages.csv", "table.md", "report.html"
    for path in (*(out / name for name in names), *out.glob("recordings/*.rrd")):
        refuse_overwrite(path, force=True)
    folder = settings.cache or out / "cache"
    clear_debris(folder.glob("*/.*.tmp"))
    outcome = run(found, folder, settings)
    rows = tidy(outcome)
    with whole_folder(out, force=True) as made:
        with whole_file(made / "results.parquet") as temporary:
            rows.to_parquet(temporary, index=False)
        for name, recording in outcome.recordings.items():
            with whole_file(made / "recordings" / f"{name}.rrd") as temporary:
                copyfile(recording.path, temporary)
        tables = report_tables(rows, found)
        pages = report_sections(tables, outcome, found)
        shown = [*pages, *_walks(outcome, found)]
        write_results(made, found.title, shown, {"results": rows})
    if settings.page:
        command = f"surefoot {'suite' if file in SUITES else 'experiment'} {file}"
        write_page(settings.page, found.title, pages, origin_of(__name__, command))
    print("\n" + in_terminal(tables["averages"]))
    for name, why in outcome.left_out.items():
        print(f"left out: {name} ({why})")
    for condition in found.conditions:
        if said := falls(outcome, condition.name):
            print(f"{condition.name}: {said}")
    print(f"\nreport: {out / 'report.html'}")
    return rows


def report_sections(
    tables: Mapping[str, pd.DataFrame], outcome: Outcome, found: Experiment
) -> list[Section]:
    """Sections of report and page: findings, figures, setting, and the tables behind them."""
    rows, learnt, swept = (tables[name] for name in ("results", "learning", "sweep"))
    main = shown_first(rows, found)
    pictures = _pictures(main, found.gammas[0])
    if len(found.gammas) + len(found.sweep.gammas) > 1 and len(swept):
        picture = Picture(
            gamma_sweep(swept, "Influence of γ, on average over the test sequences"),
            "Bounds are calibrated for each γ; filters without bounds do not depend on it.",
            "figures/gamma.png",
        )
        pictures.append(picture)
    pages = [
        Section("Findings", suite_findings(main, found), tables["overview"]),
        Section("Errors and consistency by sequence", pictures=tuple(pictures)),
        Section("Setting", _setting(found, rows, outcome)),
        Section("Averages over the test sequences", SPREAD, tables["averages"], file="averages"),
    ]
    if len(learnt):
        heading = "How observers and bounds are learnt"
        pages.append(Section(heading, LEARNT, learnt, file="learning"))
    if len(swept):
        pages.append(Section("The level γ", "", swept, file="sweep"))
    for condition in found.conditions:
        name = f"sequences_{slug(condition.name)}"
        text = f"Test sequences in bold. {SPREAD}"
        pages.append(Section(f"Every sequence: {condition.name}", text, tables[name], file=name))
    if found.published:
        pages += _published(found.published)
    if sizes := _sizes(found):
        pages.append(Section("Sources of the sizes", "", sizes, file="sources"))
    return [*pages, Section("How to read the tables", "", _glossary(main, outcome), file="columns")]


def falls(outcome: Outcome, condition: str) -> str:
    """Describe the walks under a condition on which the robot fell; empty if there were none."""
    seeds: dict[str, list[str]] = {}
    for cell, result in outcome.cells.items():
        if cell.condition.name == condition and result.walk["falls"]:
            role = f", to {cell.scenario.role} with" if cell.learnt_from else ""
            seeds.setdefault(cell.scenario.name + role, []).append(str(cell.seed))
    walks = "; ".join(f"{name} (seed {', '.join(own)})" for name, own in seeds.items())
    return f"The robot fell on {walks}, which leaves nothing to learn from." if walks else ""


def _setting(found: Experiment, rows: pd.DataFrame, outcome: Outcome) -> str:
    roles = rows.drop_duplicates("sequence").groupby("role", sort=False)["sequence"].agg(list)
    learnt = "; ".join(f"{role}: {', '.join(names)}" for role, names in roles.items())
    seeds = ", ".join(map(str, found.seeds))
    one = found.learning
    drawn = [
        f"{count} walks to {role} {'on' if role == 'train' else 'with'}"
        for role, count in (("train", one.walks), ("calibrate", one.calibration_walks))
        if count
    ]
    drawn = f" Drawn at random: {', '.join(drawn)}." if drawn else ""
    text = f"{learnt}.{drawn} Joint level γ = {found.gammas[0]:g}; seeds {seeds}."
    words = [(one, f"{one.name}: {one.words}." if one.words else "") for one in found.conditions]
    said = [" ".join(filter(None, (text, falls(outcome, one.name)))) for one, text in words]
    return "\n\n".join([text, *filter(None, said)])


def _sizes(found: Experiment) -> list[dict[str, str]]:
    """The effects of the conditions, each with the source of its size."""
    walked = [c.walked for c in found.conditions if c.walked]
    sized = [(one.effect, one.source) for c in found.conditions for one in c.imperfections]
    sized += [("gait and sensors", one.source) for one in walked]
    sized += [(size.effect, size.source) for one in walked for size in one.size]
    return [{"effect": effect, "source": source} for effect, source in dict.fromkeys(sized)]


def _published(name: str) -> list[Section]:
    rows, both, note = published(name)
    text = (
        f"{note.rstrip('.')}. The averages are given as printed and as computed from the rows, "
        "since the two do not always agree. Do not rank simulated and real figures against each "
        "other."
    )
    return [
        Section("The paper's averages", text, both, file="paper_averages"),
        Section("The paper's rows", "", rows, file="paper_rows"),
    ]


def _pictures(main: pd.DataFrame, gamma: float) -> list[Picture]:
    shown = pd.DataFrame(main[[traits(name).drawn for name in main["filter"]]])
    band = (CONSISTENT / FACTOR, CONSISTENT * FACTOR)
    pictures = [
        Picture(
            by_sequence(shown, "APE_trans [m]", "Position error by sequence"),
            "One dot per seed; the bar is their mean. Test sequences are in bold.",
            "figures/ape.png",
        ),
        Picture(
            by_sequence(shown, "APE_rot [deg]", "Attitude error by sequence"),
            "The same for the attitude.",
            "figures/ape_rot.png",
        ),
        Picture(
            by_sequence(shown, "NEES_pos", "Consistency: NEES of position", band),
            "The grey band is within a factor of two of 3. A filter to the right of it is "
            "overconfident, one to the left underconfident.",
            "figures/nees.png",
        ),
    ]
    if shown["coverage [%]"].notna().any():
        title = "Share of velocity errors within the bounds"
        figure = by_sequence(shown, "coverage [%]", title, (100.0 * gamma, 100.0), log=False)
        words = "Bounds are calibrated to a coverage of γ or more: the grey band."
        pictures.append(Picture(figure, words, "figures/coverage.png"))
    return pictures


def _walks(outcome: Outcome, found: Experiment) -> list[Section]:
    """Paths of every sequence and errors over time, for the first seed, by condition."""
    pages = []
    for condition in found.conditions:
        series = _series(outcome, condition.name, found)
        if not series:
            continue
        what = "distance between estimate and truth, and each filter's own 3σ (thin)"
        errors = Picture(
            errors_figure(series, f"{condition.name}: {what}"),
            f"Each sequence of seed {found.seeds[0]}. A filter whose error exceeds its 3σ is "
            "overconfident.",
            f"figures/errors_{slug(condition.name)}.png",
        )
        pictures = [
            Picture(
                paths(by_filter, f"{name}, {condition.name}"),
                f"{name}, seed {found.seeds[0]}: truth and estimates, aligned at the start. "
                "Estimates ten times as far off as the best leave the panels.",
                f"figures/{name}_{slug(condition.name)}.png",
            )
            for name, by_filter in series.items()
        ]
        pages.append(Section(f"Paths: {condition.name}", "", None, (errors, *pictures)))
    return pages


def _series(
    outcome: Outcome, condition: str, found: Experiment
) -> Mapping[str, Mapping[str, pd.DataFrame]]:
    series: dict[str, dict[str, pd.DataFrame]] = {}
    for cell, result in outcome.cells.items():
        if cell.condition.name != condition or cell.seed != found.seeds[0]:
            continue
        robots = found.robots_of(cell.scenario)
        name = cell.scenario.name + (f", {cell.robot}" if len(robots) > 1 else "")
        for one in result.estimates:
            path = outcome.errors / one.errors
            first = all(getattr(one, key) in (None, value) for key, value in found.first.items())
            if first and traits(one.filter).drawn and path.exists():
                series.setdefault(name, {})[one.filter] = pd.read_parquet(path)
    return series


def _glossary(main: pd.DataFrame, outcome: Outcome) -> list[dict[str, str]]:
    means = {name: estimator_named(name).description for name in main["filter"].unique()}
    means |= TABLE_MEANINGS | {f"{name}, left out": why for name, why in outcome.left_out.items()}
    return [{"": name, "means": text} for name, text in means.items()]
