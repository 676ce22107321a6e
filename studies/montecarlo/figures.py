"""Figures of the Monte-Carlo study, with the paper's numbers for comparison."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from studies.montecarlo.qmc import Accuracy
from studies.montecarlo.study import PER_AXIS, READINGS, FilterScores
from surefoot.scenarios.reporting import (
    INK,
    TRUTH,
    estimator_color,
    estimator_look,
    legend_below,
    new_figure,
    set_title,
)

PAPER_ROWS = {
    None: ("0.61 ± 0.25", "2.33 ± 1.40", "3.11 ± 2.50", "99.9 ± 121"),
    0.70: ("0.91 ± 0.31", "2.95 ± 1.01", "2.52 ± 1.15", "1.86 ± 1.38"),
    0.75: ("0.85 ± 0.26", "2.84 ± 1.21", "3.59 ± 2.46", "3.09 ± 3.67"),
    0.80: ("0.94 ± 0.27", "2.60 ± 1.36", "4.86 ± 2.45", "1.98 ± 2.64"),
    0.85: ("0.86 ± 0.33", "3.05 ± 1.34", "4.43 ± 4.33", "3.74 ± 5.52"),
    0.90: ("0.95 ± 0.29", "2.67 ± 1.19", "4.70 ± 2.86", "4.02 ± 5.27"),
    0.95: ("1.05 ± 0.36", "3.36 ± 1.47", "3.85 ± 2.43", "3.77 ± 4.65"),
}
"""The paper's table of the two regimes, rounded: RMSE unbiased and biased, NEES likewise, by gamma
(None: the EKF). Durations, densities and mixture are not given, so that only trends are comparable.
"""


def runtime_figure(rows: Sequence[Accuracy]) -> Figure:
    """Covariance error against time, log-log."""
    figure, axes = new_figure(size=(6.5, 3.8))
    ax = axes[0, 0]
    sampled = [r for r in rows if r.samples is not None]
    for name, style in (("probability", "o-"), ("mean", "s-"), ("covariance", "^-")):
        times, errors = zip(*((r.milliseconds, getattr(r, name)) for r in sampled), strict=True)
        (line,) = ax.plot(times, errors, style, label=f"QMC, {name}")
        for r in (r for r in rows if r.samples is None):
            look = {"color": line.get_color(), "markersize": 9, "markeredgecolor": INK}
            error = max(getattr(r, name), 1e-16)
            ax.plot(r.milliseconds, error, style[0], label=f"Ours, {name}", **look)
    ax.set(xscale="log", yscale="log", xlabel="time [ms]", ylabel="error")
    legend_below(figure, ax, columns=3)
    return figure


def nees_figure(rows: Sequence[FilterScores]) -> Figure:
    """NEES against gamma for each reading, one panel per regime."""
    figure, axes = new_figure(1, 2, size=(9.0, 4.8))
    for k, regime in enumerate(("unbiased", "biased")):
        ax = axes[0, k]
        own = [row for row in rows if row.regime == regime]
        for reading, style in zip(READINGS, ("o-", "s--", "^-.", "v:"), strict=True):
            for name in ("coverage", "coverage_persistent"):
                points = [
                    (row.gamma, row.nees[0])
                    for row in own
                    if (row.filter, row.reading) == (name, reading)
                ]
                if points:
                    label = f"{name}, quantile at {reading}"
                    color = estimator_color(name)
                    ax.plot(*zip(*points, strict=True), style, color=color, label=label)
        for row in (row for row in own if row.gamma is None):
            ax.axhline(row.nees[0], **estimator_look(row.filter))
        gammas = [g for g in PAPER_ROWS if g is not None]
        paper = [float(PAPER_ROWS[g][2 + k].split()[0]) for g in gammas]
        ax.plot(gammas, paper, "x", color=TRUTH, label="Coverage (paper)")
        ax.axhline(3.0, color=INK, linewidth=0.8)
        ax.set(yscale="log", xlabel="gamma", ylabel="position NEES")
        _plain_ticks(ax)
        set_title(ax, regime)
    legend_below(figure, axes[0, 0], columns=2)
    return figure


def time_figure(rows: Sequence[FilterScores], duration: float) -> Figure:
    """Error and NEES over the `duration` [s] of a trial: each filter, bounds at gamma^(1/3)."""
    figure, axes = new_figure(2, 2, size=(9.0, 6.0), share_x=True)
    for k, regime in enumerate(("unbiased", "biased")):
        for row in rows:
            shown = row.regime == regime and row.reading in (None, PER_AXIS)
            if not (shown and row.nees_curve):
                continue
            t = (np.arange(len(row.nees_curve)) + 0.5) * duration / len(row.nees_curve)
            axes[0, k].plot(t, row.distance_curve, **estimator_look(row.filter))
            axes[1, k].plot(t, row.nees_curve, **estimator_look(row.filter))
        axes[1, k].axhline(3.0, color=INK, linewidth=0.8)
        axes[1, k].set(yscale="log", xlabel="time [s]", ylabel="position NEES")
        _plain_ticks(axes[1, k])
        axes[0, k].set_ylabel("position error [m]")
        set_title(axes[0, k], regime)
    legend_below(figure, axes[0, 0])
    return figure


def _plain_ticks(ax) -> None:
    """Plain numbers instead of powers on a logarithmic axis."""
    ax.yaxis.set_major_formatter(LogFormatter())
    ax.yaxis.set_minor_formatter(LogFormatter())
