"""Traces of machines on a fixed base, as the command `surefoot trace` makes them: tables and
figures.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from surefoot import Log, Trace, TraceOptions, trace
from surefoot.extend import Machine, Modelled
from surefoot.scenarios.reporting import (
    AFTER,
    BEFORE,
    INK,
    legend_below,
    new_figure,
    percent_bar,
)

Said = Mapping[str, Any]
"""Content of a trace.json."""


def traced(
    logs: Sequence[Log], machine: Machine, out: Path, options: TraceOptions | None = None
) -> Trace:
    """Trace logs of one machine into a folder, which is overwritten."""
    with percent_bar(f"trace {out.name}") as progress:
        return trace(logs, machine, out, options or TraceOptions(), progress, force=True)


def runs_held_out(logs: Mapping[str, Log], machine: Modelled, out: Path) -> dict[str, Said]:
    """Trace all runs but one, and judge the effects on that one; each run is held out once."""
    found = {}
    for run in logs:
        others = [log for name, log in logs.items() if name != run]
        options = TraceOptions(holdout=[logs[run]])
        found[run] = traced(others, machine, out / f"without_{run}", options).as_dict()
    return found


def held_out_table(found: Mapping[str, Said]) -> pd.DataFrame:
    """One row for each held-out run and channel: its residual without and with the effects that the
    others show.
    """
    return pd.DataFrame(
        {
            "run held out": run,
            "verdict of the others": said["verdict"].replace("_", " "),
            "channel": f"{channel} [{level['unit']}]",
            "declared model": f"{level['before']:.3f}",
            "with the others' effects": f"{level['after']:.3f}",
            "noise floor": f"{level['noise_floor']:.3f}",
        }
        for run, said in found.items()
        for channel, level in said["holdout"]["channels"].items()
    )


def levels_table(parts: Mapping[str, Mapping[str, Said]]) -> pd.DataFrame:
    """One row for each channel: its residual without and with the effects found, and its floor.

    parts: words -> the `channels` of a trace.json.
    """
    return pd.DataFrame(
        {
            "rows": words,
            "channel": f"{channel} [{level['unit']}]",
            "declared model": _or_dash(level["before"]),
            "with the effects found": _or_dash(level["after"]),
            "noise floor": _or_dash(level["noise_floor"]),
        }
        for words, channels in parts.items()
        for channel, level in channels.items()
    )


def _or_dash(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def sizes_table(found: Mapping[str, Said]) -> pd.DataFrame:
    """One row for each effect: its size, with a 95 % interval, by each trace that found it."""
    rows: dict[str, dict[str, str]] = {}
    for words, said in found.items():
        for one in said["effects"]:
            name = f"{one['name']} {one['target']} [{one['unit']}]".replace("_", " ")
            low, high = one["interval"]
            row = rows.setdefault(name, {"effect": name, **dict.fromkeys(found, "–")})
            row[words] = f"{one['value']:.4g} ({low:.4g} – {high:.4g})"
    return pd.DataFrame(rows.values())


def levels_figure(parts: Mapping[str, Mapping[str, Said]]) -> Figure:
    """Figure: residual of each channel in units of its noise floor, before and after.

    parts: words -> the `channels` of a trace.json.
    """
    bars = [
        (f"{words}\n{channel.replace('_', ' ')}", level)
        for words, channels in parts.items()
        for channel, level in channels.items()
        if level["noise_floor"]
    ]
    where = np.arange(len(bars))
    drawn, axes = new_figure(1, 1, (8.0, 1.2 + 0.55 * len(bars)))
    ax = axes[0, 0]
    for side, color, shift, words in (
        ("before", BEFORE, -0.2, "declared model"),
        ("after", AFTER, 0.2, "with the effects found"),
    ):
        ratio = [level[side] / level["noise_floor"] for _, level in bars]
        ax.barh(where + shift, ratio, 0.38, color=color, label=words)
    ax.axvline(1.0, color=INK, linestyle="--", linewidth=1.2)
    ax.set_yticks(where, [words for words, _ in bars])
    ax.invert_yaxis()
    ax.set_xlabel("residual / noise floor")
    legend_below(drawn, ax, 2)
    return drawn
