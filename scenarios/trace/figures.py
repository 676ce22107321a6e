"""Figures of a trace: residuals before and after, and the gain of each candidate."""

from collections.abc import Collection, Mapping
from math import ceil

import numpy as np
from matplotlib.figure import Figure

from surefoot.models.attribution.levels import ChannelLevel
from surefoot.models.residuals.registry import channels
from surefoot.scenarios.reporting.palette import AFTER, BEFORE, INK, OUTSIDE
from surefoot.scenarios.reporting.plotting import legend_below, new_figure, set_title, single_axes

_COLUMNS = 4
_BARS = 15
"""Number of candidates shown; the axis states that of all."""


def residuals(levels: Mapping[str, ChannelLevel]) -> Figure:
    """RMS residual of each channel before and after, with its noise floor, each in its own unit."""
    rows = max(1, ceil(len(levels) / _COLUMNS))
    columns = min(_COLUMNS, max(1, len(levels)))
    size = (max(2.3 * columns, 5.0), 2.9 * rows + 0.8)
    title = "What the model leaves unexplained, on data that no fit has seen"
    figure, axes = new_figure(rows, columns, size=size, title=title)
    for ax, (name, level) in zip(axes.flat, levels.items(), strict=False):
        sides = ("before", level.before, BEFORE), ("after", level.after, AFTER)
        for k, (side, value, color) in enumerate(sides):
            ax.bar(k, value, 0.65, color=color, label=f"RMS {side}")
            text = ax.annotate(f"{value:.3g}", (k, value), (0, 2), textcoords="offset points")
            text.set(ha="center", va="bottom", fontsize=8)
            # A noise floor just above a bar would otherwise strike the number out.
            text.set_bbox({"color": ax.get_facecolor(), "pad": 0.5})
        if level.noise_floor is not None:
            line = ax.axhline(level.noise_floor, color=OUTSIDE, linewidth=1.4, label="noise floor")
            line.set_linestyle((0, (4, 2)))
        set_title(ax, channels()[name].label or name.replace("_", " "), 9.5)
        ax.set_ylabel(f"RMS [{level.unit}]".replace("^2", "²"))
        ax.set_xticks([0, 1], ["before", "after"])
        ax.set_xlim(-0.6, 1.6)
        ax.set_ylim(0, 1.15 * ax.get_ylim()[1])
        ax.grid(False, axis="x")
    for ax in axes.flat[len(levels) :]:
        ax.set_visible(False)
    legend_below(figure, axes[0, 0])
    return figure


def candidate_gains(
    gains: Mapping[str, tuple[float, float, float]],
    chosen: Collection[str] = (),
    title: str = "What each candidate effect, alone, would explain of the residual",
) -> Figure:
    """Bars of the held-out gain of each candidate, the best first, with the chosen ones in colour.

    Args:
        gains: effect -> gain (1 explains all, below 0 makes it worse), and the ends of its
            interval.
        chosen: the effects that were added to the model.
        title: above the figure.
    """
    order = sorted(gains, key=lambda name: -gains[name][0])
    shown = order[:_BARS]
    figure, ax = single_axes(7.5, 0.32 * len(shown) + 1.6)
    places = np.arange(len(shown))[::-1]
    for place, name in zip(places, shown, strict=True):
        gain, low, high = (100 * share for share in gains[name])
        ax.barh(place, gain, 0.65, color=AFTER if name in chosen else BEFORE)
        ax.plot([low, high], [place, place], color=INK, linewidth=1.2, marker="|")
        end = (max(gain, high, 0.0), place)
        text = ax.annotate(f"{gain:.1f} %", end, (5, 0), textcoords="offset points")
        text.set(va="center", fontsize=8)
    ax.set_yticks(places, [name.replace("_", " ") for name in shown])
    ax.axvline(0, color=INK, linewidth=0.8)
    more = f" (best {_BARS} of {len(order)} candidates)" if len(order) > _BARS else ""
    ax.set_xlabel(f"share of the residual explained on held-out data [%]{more}")
    ax.margins(x=0.12)
    ax.grid(False, axis="y")
    set_title(ax, title)
    ax.bar([0], [0], color=AFTER, label="added to the model")
    ax.bar([0], [0], color=BEFORE, label="not added")
    legend_below(figure, ax)
    return figure
