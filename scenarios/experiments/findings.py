"""Findings of an experiment in words: which filter has the least error, where another is better,
and why.
"""

# pyright: reportArgumentType=false, reportGeneralTypeIssues=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportReturnType=false, reportAttributeAccessIssue=false
# (pandas' stubs take a selection for any of several types)

import pandas as pd

from surefoot.scenarios.estimate.estimators import traits
from surefoot.scenarios.experiments.figures import FACTOR, NOMINAL
from surefoot.scenarios.experiments.file import Condition, Experiment
from surefoot.scenarios.experiments.tables import SHARE

DIVERGED = 5.0  # % of the path, from which a filter counts as lost on a sequence
RANKED_BY = "APE_trans [m]"


def findings(rows: pd.DataFrame, experiment: Experiment) -> list[tuple[str, str]]:
    """Heading and paragraphs for each condition, from the rows of one gamma."""
    parts = [(one, rows[rows["condition"] == one.name]) for one in experiment.conditions]
    return [(one.name, "\n\n".join(_condition(part, one))) for one, part in parts if len(part)]


def _condition(rows: pd.DataFrame, condition: Condition) -> list[str]:
    heading = f"{condition.name[:1].upper()}{condition.name[1:]}"
    paragraphs = [f"{heading}: {condition.words}."] if condition.words else []
    own = {name: traits(name) for name in dict.fromkeys(rows["filter"])}
    unranked = [name for name in own if own[name].perceptive or own[name].floor]
    ranked = rows[~rows["filter"].isin(unranked)]
    test = ranked[ranked["role"] == "test"]
    if test.empty:
        return paragraphs
    means = test.groupby("filter")[RANKED_BY].mean().sort_values()
    order = ", ".join(f"{n} {v:.3f} m" for n, v in means.items())
    paragraphs.append(f"Position error averaged over the test sequences, lowest first: {order}.")
    paragraphs += [_divergence(ranked), _consistency(test)]
    ours = max(ranked["filter"].unique(), key=lambda name: own[name].proposed)
    if own[ours].proposed:
        paragraphs += _losses(ranked, ours, condition)
    return [line for line in paragraphs if line]


def _divergence(rows: pd.DataFrame) -> str:
    kept, lost = [], []
    for name, mine in rows.groupby("filter", sort=False):
        worst = mine.groupby("sequence", sort=False)[SHARE].max()
        if worst.max() < DIVERGED:
            kept.append(f"{name} ({worst.max():.1f} %)")
        else:
            on = ", ".join(f"{s} {v:.0f} %" for s, v in worst.items() if not v < DIVERGED)
            lost.append(f"{name} (on {on})")
    good = ", ".join(kept) or "none"
    text = f"Position error below {DIVERGED:g} % of the path on every sequence: {good}."
    return text + (f" Above it: {'; '.join(lost)}." if lost else "")


def _consistency(test: pd.DataFrame) -> str:
    parts = []
    for name, mine in test.groupby("filter", sort=False):
        nees = mine["NEES_pos"].dropna()
        if len(nees):
            inside = ((nees > NOMINAL / FACTOR) & (nees < NOMINAL * FACTOR)).mean()
            parts.append(f"{name} {nees.mean():.2f} ({100 * inside:.0f} %)")
    return (
        f"Mean NEES of position, {NOMINAL:g} for a consistent filter, and the share of "
        f"test walks within a factor of {FACTOR:g} of it: {', '.join(parts)}."
    )


def _losses(rows: pd.DataFrame, ours: str, condition: Condition) -> list[str]:
    """Sequences on which another proprioceptive filter is better, by how much, and why."""
    means = rows.groupby(["sequence", "filter"], sort=False)[RANKED_BY].mean().unstack()
    ahead = {}
    for sequence, values in means.iterrows():
        best = values.idxmin()
        if best != ours:
            ahead.setdefault(str(best), []).append((sequence, values[ours], values[best]))
    if not ahead:
        return [f"{ours} has the lowest position error of all on every sequence."]
    paragraphs = []
    for best, found in ahead.items():
        where = ", ".join(f"{s} ({b:.2f} against {a:.2f} m)" for s, a, b in found)
        paragraphs.append(
            f"{best} has a lower position error than {ours} on {len(found)} of {len(means)} "
            f"sequences: {where}."
        )
    if any(traits(name).of_legs for name in ahead):
        paragraphs.append(_why_legs(rows, condition))
    paragraphs.append(_why_learnt(rows, ours))
    return paragraphs


def _why_legs(rows: pd.DataFrame, condition: Condition) -> str:
    walks = rows.drop_duplicates(["sequence", "seed"])
    if condition.effects or condition.imperfections or condition.walked:
        model = "The leg filter's model of the legs is wrong only by the robot's imperfections"
        so = "leg kinematics remain more accurate than an observer trained on so little walking"
    else:
        model = "The leg filter has a perfect model of the legs, the radius of the feet included"
        so = "velocities from leg kinematics are nearly exact"
    return (
        f"{model}; a standing foot creeps by {walks['creep [mm/s]'].median():.1f} mm/s on dry "
        f"ground (median) and slides on {walks['slip [%]'].mean():.1f} % of its samples: {so}."
    )


def _why_learnt(rows: pd.DataFrame, ours: str) -> str:
    mine = rows[(rows["filter"] == ours) & rows["fed_mean_x [m/s]"].notna()]
    if mine.empty:
        return ""
    bias = (mine[[f"fed_mean_{a} [m/s]" for a in "xyz"]] ** 2).sum(axis=1) ** 0.5
    drift = bias * mine["duration [s]"]
    return (
        f"The observer's velocity errors do not average out over a walk: their mean is "
        f"{1e3 * bias.mean():.1f} mm/s on average, {1e3 * bias.max():.1f} mm/s at worst; "
        f"integrated over a walk, it would move an estimate by {drift.mean():.2f} m on average."
    )
