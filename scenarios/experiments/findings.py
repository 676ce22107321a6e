"""Findings of an experiment: sentences, and a table of errors and consistency by filter."""

# pyright: reportArgumentType=false, reportGeneralTypeIssues=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportReturnType=false, reportAttributeAccessIssue=false
# pyright: reportOperatorIssue=false
# (pandas' stubs take a selection for any of several types)

import pandas as pd

from surefoot.estimator.metrics import CONSISTENT
from surefoot.scenarios.compare import LOST_FROM
from surefoot.scenarios.estimate.estimators import traits
from surefoot.scenarios.experiments.figures import FACTOR
from surefoot.scenarios.experiments.file import Experiment
from surefoot.scenarios.reporting.tables import cell

ERROR = "APE_trans [m]"
SHOWN = "APE [m] (NEES)"
"""Contents of the table of the findings."""


def suite_overview(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean position error and NEES over the test sequences, by filter (and robot, if there are
    several) and condition, from the rows of one gamma.
    """
    keys = ["robot", "filter"] if rows["robot"].nunique() > 1 else ["filter"]
    test = rows[rows["role"] == "test"]
    columns = {}
    for condition, part in test.groupby("condition", sort=False):
        means = part.groupby(keys, sort=False)[[ERROR, "NEES_pos"]].mean()
        columns[f"{SHOWN}, {condition}"] = means.apply(
            lambda row: f"{cell(row[ERROR])} ({cell(row['NEES_pos'])})", axis=1
        )
    return pd.DataFrame(columns).reset_index()


def suite_findings(rows: pd.DataFrame, experiment: Experiment) -> str:
    """Sentences on the test sequences, from the rows of one gamma: which filter has the lowest
    error, how the proposed one compares, which are consistent, and whether bounds hold.
    """
    own = {name: traits(name) for name in rows["filter"].unique()}
    ranked = [name for name, one in own.items() if not (one.perceptive or one.floor)]
    test = rows[(rows["role"] == "test") & rows["filter"].isin(ranked)]
    parts = {
        str(name): part
        for name, part in test.groupby("condition", sort=False)
        if name in {one.name for one in experiment.conditions}
    }
    if not parts:
        return "No filter ran on a test sequence."
    means = {name: part.groupby("filter", sort=False)[ERROR].mean() for name, part in parts.items()}
    least = [f"`{m.idxmin()}` ({m.min():.3f} m, {name})" for name, m in means.items()]
    main = (
        "Of the proprioceptive filters, these have the lowest mean position error over the test "
        f"sequences: {', '.join(least)}."
    )
    ours = max(ranked, key=lambda name: own[name].proposed)
    rest = [_proposed(parts, means, ours)] if own[ours].proposed else []
    rest += [_consistency(parts), *_learnt(parts, ours, experiment.gammas[0])]
    return f"{main}\n\n{' '.join(rest)}"


def _proposed(parts: dict[str, pd.DataFrame], means: dict[str, pd.Series], ours: str) -> str:
    found, refused = [], []
    for condition, part in parts.items():
        by = part.groupby(["sequence", "filter"], sort=False)[ERROR].mean().unstack()
        first = (by.idxmin(axis=1) == ours).sum()
        error = means[condition].get(ours, float("nan"))
        found.append(f"{error:.3f} m ({condition}; lowest on {first} of {len(by)} sequences)")
        mine = part[part["filter"] == ours]
        refused.append(f"{mine[LOST_FROM].notna().sum()} of {len(mine)} ({condition})")
    return (
        f"`{ours}`, the proposed filter, has {', '.join(found)}. By its own record it is not to be "
        f"trusted on {', '.join(refused)} walks."
    )


def _consistency(parts: dict[str, pd.DataFrame]) -> str:
    found = []
    for condition, part in parts.items():
        nees = part.groupby("filter", sort=False)["NEES_pos"].mean()
        inside = nees[(nees > CONSISTENT / FACTOR) & (nees < CONSISTENT * FACTOR)]
        found.append(f"{', '.join(f'`{name}`' for name in inside.index) or 'none'} ({condition})")
    return (
        f"Filters whose mean NEES of position is within a factor of {FACTOR:g} of {CONSISTENT:g}, "
        f"which is consistent: {'; '.join(found)}."
    )


def _learnt(parts: dict[str, pd.DataFrame], ours: str, gamma: float) -> list[str]:
    """Coverage of the bounds, and the observer's mean error over a walk; none without observers."""
    held: dict[str, list[str]] = {}
    bias = []
    for condition, part in parts.items():
        for name, one in part[part["coverage_n"] > 0].groupby("filter", sort=False):
            share = (one["coverage [%]"] * one["coverage_n"]).sum() / one["coverage_n"].sum()
            held.setdefault(str(name), []).append(f"{share:.0f} % ({condition})")
        mine = part[(part["filter"] == ours) & part["fed_mean_x [m/s]"].notna()]
        if len(mine):
            size = (mine[[f"fed_mean_{a} [m/s]" for a in "xyz"]] ** 2).sum(axis=1) ** 0.5
            bias.append(f"{1e3 * size.mean():.1f} mm/s ({condition})")
    sentences = []
    if held:
        found = "; ".join(f"with `{name}` {', '.join(shares)}" for name, shares in held.items())
        sentences.append(
            f"Bounds calibrated for {100 * gamma:.0f} % of an observer's velocity errors contain "
            f"{found}."
        )
    if bias:
        sentences.append(
            f"These errors do not average out: their mean over a walk is {', '.join(bias)}."
        )
    return sentences
