"""Common style of all figures, and their conversion to PNG."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from surefoot.scenarios.reporting.palette import INK
from surefoot.sim.common.files import whole_file

_DPI = 150
_STYLE: Any = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "axes.grid": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
}


EPOCH = 1e5
"""Stamp from which a clock counts from an epoch, more than a day [s]."""
WHITE_BOX = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0}
"""Box behind a text that stands on curves (matplotlib's `bbox`)."""


def new_figure(
    rows: int = 1,
    columns: int = 1,
    size: tuple[float, float] = (7.5, 4.0),
    share_x: bool = False,
    ratios: Sequence[float] | None = None,
    title: str = "",
) -> tuple[Figure, np.ndarray]:
    """Create a figure and its axes (rows, columns), without a window or global state.

    Args:
        rows: of axes.
        columns: of axes.
        size: width and height [inches].
        share_x: whether axes share x.
        ratios: relative heights of the rows, or None for equal ones.
        title: above all axes, at the left; "" for none.
    """
    with rc_context(_STYLE):
        figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False, sharex=share_x, height_ratios=ratios)
    for ax in axes.flat:
        ax.tick_params(colors=INK, labelsize=8.0)
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure, axes


def single_axes(width: float, height: float) -> tuple[Figure, Axes]:
    """Create a figure of this size [inches] with one pair of axes."""
    figure, axes = new_figure(size=(width, height))
    return figure, axes[0, 0]


def set_title(ax: Axes, text: str, size: float = 10.5) -> None:
    """Set a title aligned with the left end of the axes."""
    ax.set_title(text, loc="left", fontsize=size, color=INK)


def label_decades(axis: Axis) -> None:
    """Label a logarithmic axis, after plotting, with as many plain numbers as there is room for.

    Six in each decade if the axis covers at most one, 1, 2 and 5 up to a decade and a half, 1 and 3
    up to three, else 1 only; matplotlib's own labels within a decade overlap.
    """
    low, high = axis.get_view_interval()
    decades = float(np.log10(high / low))
    fine = {1.0: (1.0, 1.5, 2.0, 3.0, 5.0, 7.0), 1.5: (1.0, 2.0, 5.0), 3.0: (1.0, 3.0)}
    steps = next((labels for most, labels in fine.items() if decades <= most), (1.0,))
    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def show_to_scale(ax: Axes, low: Sequence[float], high: Sequence[float]) -> None:
    """Show at least the rectangle from `low` to `high`, (x, y), at one scale in x and y.

    The axes keep their place: where they would shrink to the rectangle instead, a constrained
    layout cuts off titles.
    """
    ax.set_xlim(low[0], high[0], auto=True)  # fixed limits would be warned of when widened
    ax.set_ylim(low[1], high[1], auto=True)
    ax.dataLim.set_points(np.array([low, high]))  # limits are narrowed to those of the data
    ax.set_aspect("equal", adjustable="datalim")


def show_time(ax: Axes, first: float, last: float) -> None:
    """Show times from first to last [s], counted from a whole second where they are large."""
    ax.set_xlim(first, last)
    start = np.floor(first) if abs(first) >= EPOCH else 0.0
    ax.set_xlabel(f"time [s] after {start:.0f}" if start else "time [s]")
    if start:
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value - start:g}"))


def limit_to_errors(ax: Axes, largest: float) -> None:
    """Let y begin at 0 and end at six times the largest error, or where the highest curve does.

    A wide 3σ would otherwise flatten the errors; where it leaves the axes, a note in the corner
    states its maximum.
    """
    highest = ax.dataLim.y1
    room = 6.0 * largest
    if 0.0 < room < highest:
        ax.set_ylim(0.0, room)
        text = ax.text(0.01, 0.98, f"3σ up to {highest:.3g} m", transform=ax.transAxes)
        text.set(fontsize=7.5, ha="left", va="top", bbox=WHITE_BOX)
    elif highest > 0.0:
        ax.set_ylim(0.0, 1.05 * highest)


def legend_below(figure: Figure, ax: Axes, columns: int = 4) -> None:
    """Add one legend below the whole figure, where it hides no data."""
    handles, labels = ax.get_legend_handles_labels()
    if labels:
        n, place = min(columns, len(labels)), "outside lower center"
        figure.legend(handles, labels, ncols=n, loc=place, fontsize=8.5, frameon=False)


def png(figure: Figure | bytes) -> bytes:
    """The figure as PNG bytes, equal for equal figures; those of a PNG are returned as they are."""
    if isinstance(figure, bytes):
        return figure
    stream = BytesIO()
    with rc_context(_STYLE):
        # `savefig` would draw the figure twice, first for its layout alone.
        FigureCanvasAgg(figure).print_png(stream, metadata={"Software": None})
    return stream.getvalue()


def save_figure(figure: Figure | bytes, path: str | Path, force: bool = False) -> None:
    """Write the figure by the suffix of its path: .png, .pdf or .svg, equal for equal figures.

    Raises SurefootError where the file exists (no `force`).
    """
    kind = Path(path).suffix
    with whole_file(path, force) as temporary:
        if kind == ".png" or isinstance(figure, bytes):
            temporary.write_bytes(png(figure))
            return
        undated = {"CreationDate": None} if kind == ".pdf" else {"Date": None}
        with rc_context({**_STYLE, "svg.hashsalt": "surefoot", "pdf.fonttype": 42}):
            figure.savefig(temporary, format=kind[1:], metadata=undated)
