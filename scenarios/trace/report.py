"""Output files of `surefoot trace`: trace.json, effects.toml, a report and a recording."""

import json
from collections.abc import Collection, Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from surefoot.models.attribution.data import LACKING
from surefoot.models.attribution.effect_sizes import Found
from surefoot.models.attribution.levels import ChannelLevel
from surefoot.models.residuals.channels import channels
from surefoot.scenarios.reporting.html import Picture, Section, write_report
from surefoot.scenarios.reporting.palette import AFTER, BEFORE, INK, OUTSIDE
from surefoot.scenarios.reporting.plotting import legend_below, new_figure, set_title, single_axes
from surefoot.scenarios.trace.filters import DEAD_RECKONING, REPORTED
from surefoot.scenarios.trace.result import Filters, Trace
from surefoot.scenarios.trace.words import (
    VERDICTS,
    beyond_bounds,
    sizes_in_words,
    unexplained_in_words,
)
from surefoot.scenarios.viewer.recording import RecordedWalk, write_recording
from surefoot.sim.common.files import write_whole
from surefoot.sim.effects.file import save_effects
from surefoot.sim.robot.machine import Machine

_OF_POSITION = ("ape_trans", "rpe_trans", "drift", "velocity")
"""Metrics of dead reckoning, which takes its attitude from the reference and has no covariance."""


def write_outputs(found: Trace, robot: Machine, out: Path) -> None:
    """Write the trace's files into an empty folder."""
    effects = found.effects
    if robot.legged is not None and found.stretches and found.stretches[0].log.has("q"):
        first = found.stretches[0]
        estimates = {f"{first.filter} (declared model)": first.before}
        if effects:
            estimates[f"{first.filter} (effect added)"] = first.after
        write_recording(out / "trace.rrd", RecordedWalk(first.log, robot.legged, estimates))
    write_report(out / "report.html", "Trace: what does the model lack?", sections(found))
    save_effects(out / "effects.toml", effects, limbs=robot.limbs)
    text = json.dumps(found.as_dict(), indent=2, allow_nan=False) + "\n"
    write_whole(out / "trace.json", text)


def sections(found: Trace) -> list[Section]:
    """Sections of the report."""
    words = "\n\n".join([f"{found.verdict}: {VERDICTS[found.verdict]}.", *_sentences(found)])
    parts = [Section("Verdict", words, _sizes(found, found.found) or None)]
    if found.runs:
        rows = [
            {"run": number, **row}
            for number, run in enumerate(found.runs, 1)
            for row in _sizes(found, run.zeros)
        ]
        words = "Zeros and clocks differ from run to run, so they are not counted as effects."
        parts.append(Section("Zeros and clocks of each run", words, table=rows))
    if found.channels:
        picture = Picture(
            residuals(found.channels),
            "Root mean square residual of each channel on the parts of the logs that were used "
            "neither to fit nor to choose. The dashed line is the noise floor: the residual of a "
            "robot that matches its model exactly.",
        )
        masked = f"Masked as slipping: {100 * found.masked_share:.1f} % of stance time. "
        masked = masked if "leg_velocity" in found.channels else ""
        words = (
            f"Residuals are means over {1e3 * found.averaged_over:.0f} ms. Turn-on biases of the "
            "IMU belong to the declared sensors and are subtracted. "
            f"{masked}Noise floor: {found.floor}."
        )
        table = _levels(found.channels)
        parts.append(Section("Residual before and after", words, table, (picture,)))
    if found.rejected:
        words = "Effects that were considered last and are not among those found."
        table = [
            {
                "effect": one.name,
                "target": one.target,
                "value": f"{one.value:.3g}",
                "unit": found.unit_of(one.name, one.target),
                "because": why,
            }
            for one, why in found.rejected
        ]
        parts.append(Section("Considered and rejected", words, table))
    if found.least:
        words = "The least size of each change that would have been named in 95 of 100 such logs."
        table = [
            {
                "effect": name,
                "target": target,
                "least": f"{least:.3g}",
                "unit": found.unit_of(name, target),
            }
            for (name, target), least in found.least.items()
        ]
        parts.append(Section("Least change that is named", words, table))
    rounds = found.attribution.rounds if found.attribution else ()
    chosen = [f"{e.name} {e.target}" for e in found.effects]
    pictures = []
    for k, candidates in enumerate(one for one in rounds if one):
        figure = candidate_gains(
            {f"{c.key[0]} {c.key[1]}": c.share for c in candidates},
            chosen,
            title=f"Round {k + 1}: share of the residual that each candidate explains",
        )
        before = "beside the effects found in earlier rounds" if k else "alone"
        caption = (
            f"Candidates {before}, to first order; what the model's own error explains is left out."
        )
        pictures.append(Picture(figure, caption))
    if pictures:
        words = (
            "The evidence of each candidate and of each pair is that of the residual beside what "
            "walks of the model leave. In each round the best of those that earn a place is added, "
            "after its size is refined on the true residual."
        )
        parts.append(Section("Candidates", words, pictures=tuple(pictures)))
    parts += _filters(
        found.filters,
        "Filters before and after",
        "Each filter runs over the same end of the log, started from the reference: with the "
        "declared model, and with the effects added to it.",
    )
    if found.held_out:
        held_out = (
            "No fit has used these logs. Zeros, biases and clock offsets are fitted to each log, "
            "before and after."
        )
        against = "".join(f"\n\n{one}." for one in found.held_out.worsened)
        table = _levels(found.held_out.channels)
        parts.append(Section("Held-out logs", held_out + against, table))
        parts += _filters(
            found.unseen_filters, "Filters on held-out logs", "Over the whole of each log."
        )
    return parts


def _filters(filters: Filters, title: str, words: str) -> list[Section]:
    """A table with one row per filter: errors before and after."""
    rows: list[dict[str, Any]] = []
    for name, metrics in filters.items():
        known = _OF_POSITION if name == DEAD_RECKONING else REPORTED
        rows.append({"filter": name})
        for key, label in REPORTED.items():
            for side in ("before", "after"):
                rows[-1][f"{label} {side}"] = metrics[side][key] if key in known else None
    return [Section(title, words, table=rows)] if rows else []


def _levels(channels: Mapping[str, ChannelLevel]) -> list[dict[str, Any]]:
    """One row per channel: residual before and after, and its noise floor."""
    return [
        channel_row(name, vars(c))
        | {"at its floor": c.within_floor, "fitted": not c.evaluation_only}
        for name, c in channels.items()
    ]


def channel_row(name: str, level: Mapping[str, Any]) -> dict[str, Any]:
    """Residual of a channel before and after, and its noise floor, from a ChannelLevel's fields."""
    keys = ("before", "after", "noise_floor", "unit")
    return {"channel": name} | {key.replace("_", " "): level[key] for key in keys}


def _sentences(found: Trace) -> list[str]:
    lines = [f"Reason: {why}." for why in found.reasons]
    lines += [f"The model lacks {one}." for one in sizes_in_words(found, found.found)]
    lines += [
        f"Or it lacks {r['name']} {r['target']}: their regressors overlap by {r['overlap']:.2f}."
        for r in found.rivals
    ]
    lines += [f"To distinguish them: {found.motion}."] if found.rivals else []
    left = (*beyond_bounds(found), *unexplained_in_words(found))
    lines += [line.strip() + "." for line in left]
    return lines + _note_lines(found.notes)


def _note_lines(notes: Sequence[str]) -> list[str]:
    """One sentence per note; channels that lack columns are combined in one."""
    unused = [note.split(LACKING) for note in notes if LACKING in note]
    lines = [f"Note: {note}." for note in notes if LACKING not in note]
    if unused:
        each = "; ".join(f"{channel} ({lacking})" for channel, lacking in unused)
        lines.append(f"Channels not used, and what the log lacks for them: {each}.")
    return lines


def _sizes(found: Trace, ones: Sequence[Found]) -> list[dict[str, Any]]:
    """One row per effect, with as many digits as distinguish the ends of its interval."""
    return [
        {
            "effect": f.effect.name,
            "target": f.effect.target,
            "value": f"{f.effect.value:.4g}",
            "low": f"{f.interval[0]:.4g}",
            "high": f"{f.interval[1]:.4g}",
            "unit": found.unit_of(f.effect.name, f.effect.target),
        }
        | (
            {"standard deviations": f"{f.excess:.1f}", "between blocks": f"{f.agreement:.1f}"}
            if np.isfinite(f.excess)
            else {}
        )
        for f in ones
    ]


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
    gains: Mapping[str, float],
    chosen: Collection[str] = (),
    title: str = "What each candidate effect, alone, would explain of the residual",
) -> Figure:
    """Bars of the gain of each candidate, the best first, with the chosen ones in colour.

    Args:
        gains: effect -> gain (1 explains all).
        chosen: the effects that were added to the model.
        title: above the figure.
    """
    order = sorted(gains, key=lambda name: -gains[name])
    shown = order[:_BARS]
    figure, ax = single_axes(7.5, 0.32 * len(shown) + 1.6)
    places = np.arange(len(shown))[::-1]
    for place, name in zip(places, shown, strict=True):
        gain = 100 * gains[name]
        ax.barh(place, gain, 0.65, color=AFTER if name in chosen else BEFORE)
        end = (max(gain, 0.0), place)
        text = ax.annotate(f"{gain:.1f} %", end, (5, 0), textcoords="offset points")
        text.set(va="center", fontsize=8)
    ax.set_yticks(places, [name.replace("_", " ") for name in shown])
    ax.axvline(0, color=INK, linewidth=0.8)
    more = f" (best {_BARS} of {len(order)} candidates)" if len(order) > _BARS else ""
    ax.set_xlabel(f"share of the residual explained [%]{more}")
    ax.margins(x=0.12)
    ax.grid(False, axis="y")
    set_title(ax, title)
    ax.bar([0], [0], color=AFTER, label="added to the model")
    ax.bar([0], [0], color=BEFORE, label="not added")
    legend_below(figure, ax)
    return figure
