"""Description of a comparison of filters in words, and the best values of its table."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from scipy.stats import chi2

from surefoot.estimator.metrics import Metrics
from surefoot.scenarios.reporting.tables import METRICS, cell

CONSISTENT = 3.0
"""NEES of three axes if a filter's covariance is that of its error."""
ONE_WALK = tuple(float(edge) for edge in chi2.ppf((0.025, 0.975), CONSISTENT))
"""95 % interval of the NEES of a consistent filter on one walk, whose persistent error is one
draw.
"""
_LEAST = [name for name in METRICS if name.startswith(("APE", "RPE"))]
_CONSISTENCY = [name for name in METRICS if name.startswith("NEES")]


def error_summary(log: str, metrics: Mapping[str, Metrics]) -> str:
    """Describe which filter has the least error on a log, and which are over- or underconfident."""
    if not metrics:
        return f"On {log}: no errors to compare, without a reference or a filter that held."
    errors = {name: one.ape_trans for name, one in metrics.items()}
    best = min(errors, key=lambda name: errors[name])
    what = "has an error of" if len(errors) == 1 else "has the least error,"
    text = f"On {log}: {best} {what} {cell(errors[best])} m (APE_trans)"
    nees = {name: one.nees_position for name, one in metrics.items()}
    low, high = ONE_WALK
    for what, names in (
        ("overconfident", [name for name, value in nees.items() if value > high]),
        ("underconfident", [name for name, value in nees.items() if value < low]),
    ):
        if names:
            shown = ", ".join(f"{name} ({cell(nees[name], 2)})" for name in names)
            text += f"; {what} (NEES_pos, 3 if consistent): {shown}"
    return f"{text}."


def left_out_lines(log: str, reasons: Mapping[str, str]) -> list[str]:
    """Lines on the filters that did not run on a log, grouped by reason."""
    together: dict[str, list[str]] = {}
    for name, why in reasons.items():
        together.setdefault(why.removeprefix(f"{log}: "), []).append(name)
    return [f"left out on {log}: {', '.join(names)} ({why})" for why, names in together.items()]


def with_best_marked(found: pd.DataFrame) -> pd.DataFrame:
    """The table without empty columns, with the best values on each log in bold.

    That is the least error and, among consistent filters, the NEES with the ratio nearest to 1 of
    3.
    """
    marked = found.dropna(axis=1, how="all").astype(object)
    for _, rows in found.groupby("log", sort=False):
        for column in _LEAST + _CONSISTENCY:
            if column not in marked or len(rows[column].dropna()) < 2:
                continue
            values = rows[column].astype(float)
            off = values
            if column in _CONSISTENCY:
                off = np.abs(np.log(np.maximum(values, 1e-12) / CONSISTENT))
                off = off[values.between(ONE_WALK[0], ONE_WALK[1])]
            if off.empty:
                continue
            best = cell(values[off.idxmin()])
            for at in values.index[[cell(value) == best for value in values]]:
                marked.at[at, column] = f"**{best}**"
    return marked


def command_line(arguments: Sequence[str]) -> str:
    """The command as in `sys.argv`, without the folders of absolute paths; empty if surefoot was
    not started as a command.
    """
    program, *rest = arguments or [""]
    if not program.endswith(("/surefoot", "/__main__.py")):
        return ""
    return " ".join(
        ["surefoot", *(one.rpartition("/")[2] if one[:1] == "/" else one for one in rest)]
    )
