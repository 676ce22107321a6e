"""Pictures of the blind study: what each effect is taken for, and how well it is sized."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from surefoot.scenarios.reporting.palette import AFTER, INK, OUTSIDE
from surefoot.scenarios.reporting.plotting import new_figure, set_title
from surefoot.scenarios.studies.blind.score import Record, named, points, sized, truth
from surefoot.sim.effects import CATALOGUE

OTHER = ("nothing", "another target", "confounded")


def confusion(records: Sequence[Record]) -> Figure:
    """Which effect was put in against which was named first, as counts."""
    names = list(CATALOGUE)
    columns = [*names, *OTHER]
    counts = np.zeros((len(names), len(columns)))
    for r in records:
        if r["kind"] != "single" or "fell" in r:
            continue
        name = truth(r)[0][0]
        first = named(r)[0][0] if named(r) else "nothing"
        if first == name and points(r) < 1.0:
            first = "confounded" if r["verdict"] == "confounded" else "another target"
        counts[names.index(name), columns.index(first)] += 1
    figure, axes = new_figure(size=(9.5, 8.5))
    ax = axes[0, 0]
    ax.imshow(counts, cmap="Blues", vmin=0, vmax=max(1.0, counts.max()), aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        dark = counts[i, j] > 0.6 * counts.max()
        ax.text(
            j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=7,
            color="white" if dark else INK,
        )  # fmt: skip
    ax.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=90)
    ax.set_yticks(range(len(names)), [n.replace("_", " ") for n in names])
    ax.tick_params(labelsize=7)
    ax.grid(False)
    ax.axvline(len(names) - 0.5, color=INK, linewidth=0.8)
    ax.set_xlabel("named first")
    ax.set_ylabel("put in")
    set_title(ax, "What trace takes each undeclared effect for")
    return figure


def sizes(records: Sequence[Record]) -> Figure:
    """The size found over the size put in, against how far the effect stands above its floor."""
    figure, axes = new_figure(size=(7.5, 4.2))
    ax = axes[0, 0]
    least, most = 0.5, 1.5
    for r in records:
        if r["kind"] != "single" or "fell" in r or sized(r) is None:
            continue
        found, true = r["effects_found"][0], r["effects"][0]["value"]
        over = r["over_floor"][0]
        if over is None:
            continue
        ratio = np.clip(np.array([found["value"], *found["interval"]]) / true, least, most)
        color = AFTER if sized(r) else OUTSIDE
        ax.plot([over, over], sorted(ratio[1:]), color=color, linewidth=1.0, alpha=0.6)
        ax.plot(over, ratio[0], "o", color=color, markersize=3.5)
    ax.axhspan(0.9, 1.1, color=INK, alpha=0.07, linewidth=0)
    ax.axvline(1.0, color=INK, linewidth=0.8, linestyle=":")
    ax.set_xscale("log")
    ax.set_ylim(least, most)
    ax.set_xlabel("size put in, over the least that the log could show")
    ax.set_ylabel("size found / size put in")
    set_title(ax, "Sizes of the effects that were named right, with their 95 % intervals")
    return figure
