"""Tables of an experiment: all rows, averages over the test sequences, and the paper's figures."""

# pyright: reportArgumentType=false, reportGeneralTypeIssues=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportReturnType=false, reportAttributeAccessIssue=false
# (pandas' stubs take a selection for any of several types)

from collections.abc import Mapping

import numpy as np
import pandas as pd

from surefoot.models.calibration.empirical_coverage import binomial_interval
from surefoot.scenarios.compare import LOST_FROM, MEANINGS
from surefoot.scenarios.experiments.catalog import SUITES_FOLDER
from surefoot.scenarios.experiments.file import LEARNT_BY, Experiment
from surefoot.scenarios.experiments.findings import suite_overview
from surefoot.scenarios.experiments.run import Outcome
from surefoot.scenarios.reporting.tables import METRICS, cell
from surefoot.sim.common.errors import check_known
from surefoot.sim.common.toml import read_toml

PUBLISHED = SUITES_FOLDER / "published.toml"
TABLE_METRICS = {**METRICS, "step [us]": "step_us"}
"""Columns of the tables, and the facts of an estimate that they show."""
ESTIMATED_BY = ("filter", "gamma", *LEARNT_BY)
"""Columns that tell an estimate of a walk from another."""
LOST = "lost walks"
SHARE = "APE [% of path]"
HELD = "coverage [%]"
SHOWN_COLUMNS = [name for name in MEANINGS if name in TABLE_METRICS or name == HELD]
SHOWN_COLUMNS.insert(1, SHARE)
"""Order of the columns for averages and sequences."""
TABLE_MEANINGS = {
    **MEANINGS,
    HELD: "share of velocity errors jointly inside the bounds, with a 95 % interval; not given "
    "for filters whose bounds are on something else",
    SHARE: "APE_trans over the length of the walk",
    LOST: "walks on which a filter says that it is not to be trusted",
    "±": "standard deviation over seeds; each seed is a robot, its walks and its observers",
}


def tidy(outcome: Outcome) -> pd.DataFrame:
    """One row per estimate, plain numbers; a walk that fell is one row without a filter."""
    rows = []
    for at, result in outcome.cells.items():
        walk = result.walk
        row = {
            "sequence": at.scenario.name,
            "role": at.scenario.role or "test",
            "robot": at.robot,
            "condition": at.condition.name,
            "seed": at.seed,
            "length [m]": walk["length"],
            "duration [s]": walk["duration"],
            "slip [%]": 100.0 * walk["slip_share"],
            "creep [mm/s]": 1e3 * walk["creep"],
            "fell at [s]": walk["fell_at"],
        }
        for one in result.estimates:
            facts = one.facts
            values = {name: facts.get(key, np.nan) for name, key in TABLE_METRICS.items()}
            values[LOST_FROM] = facts.get("lost_from", np.nan)
            values[SHARE] = 100.0 * facts.get("ape_trans", np.nan) / walk["length"]
            values[HELD] = 100.0 * facts.get("coverage", np.nan)
            values["coverage_n"] = facts.get("coverage_n", 0)
            for k, axis in enumerate("xyz"):
                values[f"fed_mean_{axis} [m/s]"] = facts.get("fed_mean", [np.nan] * 3)[k]
            which = {name: getattr(one, name) for name in ESTIMATED_BY}
            rows.append(row | which | values)
        if not result.estimates:
            rows.append(row | dict.fromkeys(ESTIMATED_BY))
    return pd.DataFrame(rows)


def report_tables(rows: pd.DataFrame, found: Experiment) -> dict[str, pd.DataFrame]:
    """All rows as "results", and the tables that the report shows."""
    main = shown_first(rows, found)
    tables = {"results": rows, "overview": suite_overview(main), "averages": averages(main)}
    tables["sweep"] = sweep(rows, found)
    tables["learning"] = by_learning(rows, found)
    for condition in found.conditions:
        part = main[main["condition"] == condition.name]
        tables[f"sequences_{slug(condition.name)}"] = per_sequence(part)
    return tables


def slug(name: str) -> str:
    """A condition's name as part of a file's."""
    return name.replace(" ", "_").replace("/", "_")


def shown_first(rows: pd.DataFrame, experiment: Experiment) -> pd.DataFrame:
    """Rows of the first gamma and learning, and those of filters without these."""
    return _of(rows[rows["filter"].notna()], experiment.first)


def _of(rows: pd.DataFrame, values: Mapping[str, object]) -> pd.DataFrame:
    """Rows whose columns have these values or are empty."""
    mine = [rows[name].isna() | (rows[name] == value) for name, value in values.items()]
    return pd.DataFrame(rows[np.logical_and.reduce(mine)])


def averages(rows: pd.DataFrame) -> pd.DataFrame:
    """Means over test sequences, and their spread over seeds, by condition, robot and filter."""
    keys = ["condition", "robot", "filter"]
    return _marked(_averaged(rows[rows["role"] == "test"], keys), [*keys, *SHOWN_COLUMNS])


def _averaged(rows: pd.DataFrame, keys: list[str]) -> list[dict[str, object]]:
    """Means over the walks of a seed and their spread over seeds, coverage, and the number of walks
    on which the filter was lost, if any, as text, by these columns.
    """
    found = []
    for values, part in rows.groupby(keys, sort=False, dropna=False):
        by_seed = part.groupby("seed")[[*TABLE_METRICS, SHARE]].mean()
        row = dict(zip(keys, values, strict=True))
        row |= {name: with_spread(by_seed[name]) for name in [*TABLE_METRICS, SHARE]}
        lost = int(part[LOST_FROM].notna().sum())
        row |= {HELD: _held(part), LOST: f"{lost} of {len(part)}" if lost else None}
        found.append(row)
    return found


def per_sequence(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean and spread over seeds, by sequence and filter; test sequences in bold."""
    means = rows.groupby("sequence")[["length [m]", "duration [s]"]].mean()
    found = _averaged(rows, ["sequence", "role", "filter"])
    for row in found:
        name, role = row["sequence"], row["role"]
        length, seconds = means.loc[name]
        row["path"] = f"{length:.0f} m, {seconds:.0f} s"
        row["sequence"] = f"**{name}**" if role == "test" else f"{name} ({role})"
    return _marked(found, ["sequence", "path", "filter", *SHOWN_COLUMNS])


def sweep(rows: pd.DataFrame, experiment: Experiment) -> pd.DataFrame:
    """Averages over test sequences by gamma, for the seeds that were run at every gamma."""
    seeds = experiment.seeds[:1] if experiment.sweep.gammas else experiment.seeds
    first = {key: value for key, value in experiment.first.items() if key != "gamma"}
    mine = rows[rows["gamma"].notna() & (rows["role"] == "test") & rows["seed"].isin(seeds)]
    mine = _of(mine, first)
    found = []
    for (condition, name), part in mine.groupby(["condition", "filter"], sort=False):
        for gamma, at in part.groupby("gamma"):
            row = {"condition": condition, "filter": name, "gamma": gamma}
            found.append(row | {c: _held(at) if c == HELD else at[c].mean() for c in SHOWN_COLUMNS})
    return pd.DataFrame(found)


def by_learning(rows: pd.DataFrame, experiment: Experiment) -> pd.DataFrame:
    """Averages over test sequences by how observers and bounds are learnt, at the first gamma.

    For the filters with observers; empty where the experiment has one learning only.
    """
    if len(experiment.learnings) == 1:
        return pd.DataFrame()
    learnt = rows[(rows["role"] == "test") & rows["inputs"].notna()]
    keys = ["condition", "filter", *LEARNT_BY]
    found = _averaged(_of(learnt, {"gamma": experiment.gammas[0]}), keys)
    return pd.DataFrame(found, columns=[*keys, *SHOWN_COLUMNS])


def published(name: str) -> tuple[pd.DataFrame, pd.DataFrame, str]:
    """A suite's figures as printed in the paper: rows, averages, and the note on both.

    The averages are the printed ones and those recomputed from the rows, by method.
    """
    table = read_toml(PUBLISHED, "published")
    columns = table.pop("columns")
    check_known("published table", name, table)
    part = table[name]
    rows = pd.DataFrame(part["rows"], columns=["sequence", "method", *columns])
    printed = pd.DataFrame(part["printed_averages"], columns=["method", *columns])
    again = rows.groupby("method", sort=False)[columns].mean().reset_index()
    both = pd.concat(
        [printed.assign(average="as printed"), again.assign(average="from its rows")]
    ).sort_values("method", kind="stable")
    text = f"{part['source']}. Real robots. {part['note']}".strip()
    return rows, both[["method", "average", *columns]], text


def with_spread(values: pd.Series) -> str | None:
    """Mean and, for more than one value, standard deviation, as text."""
    values = values.dropna()
    if values.empty:
        return None
    spread = f" ± {cell(float(values.std(ddof=1)))}" if len(values) > 1 else ""
    return cell(float(values.mean())) + spread


def _marked(found: list[dict[str, object]], order: list[str]) -> pd.DataFrame:
    """The rows with these columns, and that of lost walks if there are any."""
    lost = any(row[LOST] for row in found)
    return pd.DataFrame(found, columns=[*order, LOST] if lost else order)


def _held(part: pd.DataFrame) -> str | None:
    """Share of errors within their bounds over all these walks, with its 95 % interval."""
    n = part["coverage_n"].sum()
    if not n:
        return None
    share = float((part["coverage [%]"] * part["coverage_n"]).sum() / n)
    low, high = 100.0 * binomial_interval(share / 100.0, int(n))
    return f"{share:.1f} ({low:.0f}–{high:.0f})"
