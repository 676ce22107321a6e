"""Figures of an experiment: errors and consistency by sequence, the gamma sweep, and the paths."""

# pyright: reportArgumentType=false, reportGeneralTypeIssues=false, reportCallIssue=false
# pyright: reportIndexIssue=false, reportReturnType=false, reportAttributeAccessIssue=false
# (pandas' stubs take a selection for any of several types)

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from surefoot.scenarios.reporting.figures import draw_error
from surefoot.scenarios.reporting.palette import (
    INK,
    TRUTH,
    estimator_color,
    estimator_look,
)
from surefoot.scenarios.reporting.plotting import (
    label_decades,
    legend_below,
    limit_to_errors,
    new_figure,
    set_title,
    show_to_scale,
)

FACTOR = 2.0
"""Factor from CONSISTENT within which a mean NEES counts as consistent."""


def by_sequence(
    rows: pd.DataFrame,
    column: str,
    title: str,
    band: tuple[float, float] | None = None,
    log: bool = True,
) -> Figure:
    """One dot plot: a row per sequence, a panel per condition, a colour per filter, a dot per seed.

    The wide mark is the mean over seeds.

    Args:
        rows: one per sequence, condition, filter and seed.
        column: the value that is plotted.
        title: of the value's axis.
        band: shaded range in which values should lie, or None.
        log: whether the axis is logarithmic.
    """
    rows = pd.DataFrame(rows[rows[column].notna()])
    conditions, names = list(rows["condition"].unique()), list(rows["sequence"].unique())
    filters = list(rows["filter"].unique())
    columns = len(conditions) if len(conditions) <= 3 else 2
    lines = -(-len(conditions) // columns)
    size = (5.2 * columns + 1.0, lines * (0.42 * len(names) + 1.0) + 0.9)
    figure, axes = new_figure(lines, columns, size=size, title=title)
    for ax in axes.flat[len(conditions) :]:
        ax.set_visible(False)
    half = 0.32 if len(filters) > 1 else 0.0
    offsets = dict(zip(filters, np.linspace(-half, half, len(filters)), strict=True))
    for ax, condition in zip(axes.flat, conditions, strict=False):
        part = rows[rows["condition"] == condition]
        if band:
            ax.axvspan(*band, color="#E6E6E6", zorder=0)
        for name in filters:
            color = estimator_color(name)
            mine = part[part["filter"] == name]
            y = [names.index(sequence) + offsets[name] for sequence in mine["sequence"]]
            ax.plot(mine[column], y, ".", color=color, markersize=3.0, alpha=0.7)
            means = mine.groupby("sequence")[column].mean()
            at = [names.index(sequence) + offsets[name] for sequence in means.index]
            ax.plot(means, at, "|", color=color, markersize=8, markeredgewidth=2.2, label=name)
        if log:
            ax.set_xscale("log")
            label_decades(ax.xaxis)
        ax.set_yticks(range(len(names)), labels=names)
        ax.set_ylim(len(names) - 0.5, -0.5)
        for k in range(len(names) - 1):
            ax.axhline(k + 0.5, color="#EEEEEE", linewidth=0.8)
        ax.grid(axis="y", visible=False)
        ax.set_xlabel(column)
        set_title(ax, f"{condition}", 9.5)
        label_roles(ax, rows, names)
    legend_below(figure, axes[0, 0], columns=3 * columns)
    return figure


def label_roles(ax, rows: pd.DataFrame, names: Sequence[str]) -> None:
    """Label test sequences in bold, as in the tables, and the others with their role."""
    roles = rows.drop_duplicates("sequence").set_index("sequence")["role"]
    words = [name if roles[name] == "test" else f"{name} ({roles[name]})" for name in names]
    for label, name in zip(ax.set_yticklabels(words), names, strict=True):
        if roles[name] == "test":
            label.set_fontweight("bold")


def gamma_sweep(table: pd.DataFrame, title: str) -> Figure:
    """Errors, consistency and active share over gamma, averaged over the test sequences."""
    columns = ("APE_trans [m]", "NEES_pos", "pi<gamma [%]")
    figure, axes = new_figure(1, len(columns), size=(10.0, 3.6), title=title)
    for ax, column in zip(axes[0], columns, strict=True):
        for (condition, name), part in table.groupby(["condition", "filter"], sort=False):
            conditions = list(table["condition"].unique())
            style = ("-", "--", ":", "-.")[conditions.index(condition) % 4]
            color, label = estimator_color(str(name)), f"{name}, {condition}"
            ax.plot(part["gamma"], part[column], f"o{style}", ms=4, color=color, label=label)
        ax.set(xlabel="γ", ylabel=column)
        if column == "NEES_pos":  # differs between filters by orders of magnitude
            ax.set_yscale("log")
            label_decades(ax.yaxis)
        else:
            ax.set_ylim(0.0, None)
    legend_below(figure, axes[0, 0], columns=3)
    return figure


def paths(series: Mapping[str, pd.DataFrame], title: str) -> Figure:
    """Top view and height of one walk: truth and every estimate, aligned at the start."""
    truth = next(iter(series.values()))
    figure, axes = new_figure(1, 2, size=(10.0, 4.4), title=title)
    above, height = axes[0]
    above.plot(truth["ref_x"], truth["ref_y"], color=TRUTH, linewidth=3.5, label="Truth")
    height.plot(truth["t"], truth["ref_z"], color=TRUTH, linewidth=3.0)
    for name, part in series.items():
        look = estimator_look(name)
        above.plot(part["p_x"], part["p_y"], **look, linewidth=1.3)
        height.plot(part["t"], part["p_z"], **look, linewidth=1.3)
    above.plot(truth["ref_x"][0], truth["ref_y"][0], "o", color=INK, markersize=6)
    above.set(xlabel="x [m]", ylabel="y [m]")
    # Estimates with very large errors must not compress the others.
    path = truth[["ref_x", "ref_y"]].to_numpy()
    margin = 0.35 * max(np.max(np.ptp(path, axis=0)), 2.0)
    show_to_scale(above, path.min(axis=0) - margin, path.max(axis=0) + margin)
    height.set_ylim(*_height_limits(series))
    height.set(xlabel="time [s]", ylabel="height z [m]")
    set_title(above, "From above")
    set_title(height, "Height of the IMU")
    legend_below(figure, above, columns=5)
    return figure


def _height_limits(series: Mapping[str, pd.DataFrame]) -> tuple[float, float]:
    """Lowest and highest z of truth and estimates, without those with ten times the error of the
    best.
    """
    off = {name: (part["p_z"] - part["ref_z"]).abs().max() for name, part in series.items()}
    near = [part for name, part in series.items() if off[name] <= 10.0 * min(off.values())]
    z = np.concatenate([part[["p_z", "ref_z"]].to_numpy().ravel() for part in near])
    margin = 0.05 * max(np.ptp(z), 0.02)
    return z.min() - margin, z.max() + margin


def errors_figure(series: Mapping[str, Mapping[str, pd.DataFrame]], title: str) -> Figure:
    """One panel per sequence: distance from the truth and, thin, the filter's three sigma."""
    columns = max(min(3, len(series)), 1)
    lines = -(-len(series) // columns)
    figure, axes = new_figure(lines, columns, size=(10.0, 2.2 * lines + 0.8), title=title)
    for ax in axes.flat[len(series) :]:
        ax.set_visible(False)
    for ax, (name, by_filter) in zip(axes.flat, series.items(), strict=False):
        top = 0.0
        for filter_name, part in by_filter.items():
            look, distance = estimator_look(filter_name), part["distance"]
            draw_error(ax, look, part["t"], distance, part.get("sigma"))
            top = max(top, float(distance.max()))
        limit_to_errors(ax, top)
        ax.set_xlabel("time [s]")
        set_title(ax, name, 9.0)
    for ax in axes[:, 0]:
        ax.set_ylabel("error [m]")
    legend_below(figure, axes[0, 0], columns=5)
    return figure
