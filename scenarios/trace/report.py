"""Output files of `surefoot trace`: trace.json, effects.toml, a report and a recording."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from surefoot.models.attribution.effect_sizes import Found
from surefoot.models.attribution.judgement import ChannelLevel
from surefoot.models.residuals.channels import channels
from surefoot.scenarios.reporting.html import Picture, Section, markdown_report, write_report
from surefoot.scenarios.reporting.palette import AFTER, BEFORE, INK, OUTSIDE
from surefoot.scenarios.reporting.plotting import label_decades, legend_below, single_axes
from surefoot.scenarios.reporting.tables import Table
from surefoot.scenarios.trace.filters import REPORTED
from surefoot.scenarios.trace.result import Trace
from surefoot.scenarios.trace.words import (
    DRIFT_PARTS,
    FIRST,
    beyond_bounds,
    filter_rows,
    headline,
    ranked_notes,
    state_of,
    target_in_words,
    unexplained_in_words,
)
from surefoot.scenarios.viewer.recording import RecordedWalk, write_recording
from surefoot.sim.common.files import write_whole
from surefoot.sim.effects.file import save_effects
from surefoot.sim.robot.machine import Machine

_EVERY_METRIC = "Every metric of the filters"


def write_outputs(found: Trace, robot: Machine, out: Path) -> None:
    """Write the trace's files into an empty folder."""
    effects = found.effects
    if robot.legged is not None and found.stretches and found.stretches[0].log.has("q"):
        first = found.stretches[0]
        estimates = {f"{first.filter} (declared model)": first.before}
        if effects:
            estimates[f"{first.filter} (effect added)"] = first.after
        write_recording(out / "trace.rrd", RecordedWalk(first.log, robot.legged, estimates))
    title = headline(found)
    write_report(out / "report.html", f"{title[0].upper()}{title[1:]}", sections(found))
    save_effects(out / "effects.toml", effects, limbs=robot.limbs)
    text = json.dumps(found.as_dict(), indent=2, allow_nan=False) + "\n"
    write_whole(out / "trace.json", text)


def summary(found: Trace) -> str:
    """The report for a terminal, without the second table of the filters."""
    shown = [one for one in sections(found) if one.heading != _EVERY_METRIC]
    return markdown_report(f"verdict: {found.verdict}: {headline(found)}", shown).rstrip()


def sections(found: Trace) -> list[Section]:
    """Sections of the report below its headline: the residual, what to do next, filters, what
    speaks for each effect, and notes; the rest is folded.
    """
    first, lacking, assumed = ranked_notes(found)
    where = "held-out logs" if found.held_out else "the parts of the logs used by no fit"
    steps = "Names in capitals are of logs that you record."
    named = (
        "An effect is named from the size that noise and errors of the model hardly reach, if it "
        "agrees between blocks of the logs by more than 2 standard deviations; see the guide for "
        "all criteria."
    )
    levels = (
        f"Root mean square of means over {1e3 * found.averaged_over:.0f} ms, on {where}; turn-on "
        "biases of the IMU are subtracted."
    )
    return [
        _verdict(found, where),
        *([Section("What to do next", steps, steps=found.steps)] if found.steps else []),
        *_of_filters(found),
        *_given("Effects found", [named], _sizes(found, found.found)),
        *_given("Residual of each channel", [levels], _levels(found.unseen_channels)),
        *_given("Notes", first),
        *(replace(one, folded=True) for one in _details(found, lacking, assumed)),
    ]


def _given(title: str, words: Sequence[str], table: Table | None = None) -> list[Section]:
    """A section, unless its table, or without one its words, are empty."""
    prose = "\n\n".join(f"{one[0].upper()}{one[1:].removesuffix('.')}." for one in words)
    there = words if table is None else table
    return [Section(title, prose, table)] if len(there) else []


def _verdict(found: Trace, where: str) -> Section:
    """The reasons, and the picture: each channel's residual over its noise floor."""
    words = [f"Because {why}." for why in found.reasons]
    words += [
        f"{one['name']} {one['target']} explains the logs as well (overlap {one['overlap']:.2f})."
        for one in found.rivals
    ]
    words += [f"To distinguish them: {found.motion}."] if found.rivals else []
    drawn = {n: c for n, c in found.unseen_channels.items() if c.noise_floor and c.after > 0.0}
    caption = (
        f"Residual of each channel over its noise floor, on {where}: 1 is a robot that matches its "
        "model exactly. Red: above its floor. Hollow: for evaluation only."
    )
    pictures = (Picture(over_floor(drawn), caption),) if drawn else ()
    return Section(f"Verdict: {found.verdict}", "\n\n".join(words), pictures=pictures)


def _of_filters(found: Trace) -> list[Section]:
    """Each filter before and after, and how much each effect adds to the drift."""
    where = (
        "Over the whole of each held-out log, which no fit has used"
        if found.held_out
        else "Over the end of each log, which is partly fitted; --holdout LOG checks on other logs"
    )
    words = [f"{where}. Before: the declared model. After: with the effects found."]
    for one in found.stretches:
        sides = zip(("before", "after"), one.lost, strict=True)
        words += [f"{one.log.name} {side}: {why}" for side, why in sides if why]
    rows = filter_rows(found.judged_filters, FIRST)
    parts = _given("Filters before and after", words, rows)
    if found.causes:
        drifts = {
            "as declared": found.causes.declared,
            **{f"{e.name} {target_in_words(e)} adds": x for e, x in found.causes.added},
            "with all effects": found.causes.left,
        }
        factors = np.array(list(DRIFT_PARTS.values()))
        table = [
            {"": name} | dict(zip(DRIFT_PARTS, map("{:+.2f}".format, factors * x), strict=True))
            for name, x in drifts.items()
        ]
        words = (
            "Drift of the leg filter over whole logs: relative error over 1 m, and the last errors "
            "of height, yaw and distance over the length of the path. An effect adds what the "
            "filter drifts more where it alone is not compensated."
        )
        parts.append(Section("Causes of the drift", words, table))
    return parts


def _details(found: Trace, lacking: Sequence[str], assumed: Sequence[str]) -> list[Section]:
    """Sections for those who want to know more."""
    zeros = [
        {"run": number, **row}
        for number, run in enumerate(found.runs, 1)
        for row in _sizes(found, run.zeros)
    ]
    rejected = [
        _sized(found, (one.name, one.target), one.value) | {"because": why}
        for one, why in found.rejected
    ]
    least = [_sized(found, key, size) for key, size in found.least.items()]
    left = [*beyond_bounds(found), *unexplained_in_words(found)]
    every = filter_rows(found.judged_filters, REPORTED)
    return [
        *_given("What the remaining residual correlates with", left),
        *_given("What these logs cannot show", lacking),
        *_given("What is assumed", assumed),
        *_given(_EVERY_METRIC, [], every),
        *_given("Zeros and clocks of each run", [], zeros),
        *_given("Considered and rejected", [], rejected),
        *_given("Least changes that would have been named in 95 of 100 such logs", [], least),
    ]


def _levels(channels: Mapping[str, ChannelLevel]) -> list[dict[str, Any]]:
    """One row per channel: residual before and after, its noise floor, and what that means."""
    return [channel_row(name, vars(c)) | {"": state_of(c)} for name, c in channels.items()]


def channel_row(name: str, level: Mapping[str, Any]) -> dict[str, Any]:
    """Residual of a channel before and after, and its noise floor, from a ChannelLevel's fields."""
    keys = ("before", "after", "noise_floor", "unit")
    return {"channel": name} | {key.replace("_", " "): level[key] for key in keys}


def _sizes(found: Trace, ones: Sequence[Found]) -> list[dict[str, Any]]:
    """One row per effect, with as many digits as distinguish the ends of its interval."""
    least = {one.key: f"{one.least:.3g}" for candidates in found.rounds for one in candidates}
    rows = []
    for f in ones:
        key = f.effect.name, f.effect.target
        row = _sized(found, key, f.effect.value)
        row |= {"low": f"{f.interval[0]:.4g}", "high": f"{f.interval[1]:.4g}"}
        if np.isfinite(f.excess):
            deviations = {"standard deviations": f.excess, "between blocks": f.agreement}
            row |= {"named from": least.get(key)}
            row |= {name: f"{x:.1f}" for name, x in deviations.items()}
        rows.append(row)
    return rows


def _sized(found: Trace, key: tuple[str, str], size: float) -> dict[str, Any]:
    unit = found.unit_of(*key)
    return {"effect": key[0], "target": key[1], "size": f"{size:.4g}", "unit": unit}


def over_floor(levels: Mapping[str, ChannelLevel]) -> Figure:
    """Residual of each channel over its noise floor, before and after; both as numbers, too."""
    figure, ax = single_axes(4.8, 0.36 * len(levels) + 1.2)
    places = np.arange(len(levels))[::-1]
    for place, level in zip(places, levels.values(), strict=True):
        floor = level.noise_floor or np.nan
        sides = [max(x / floor, 1e-3) for x in (level.before, level.after)]
        ax.plot(sides, [place, place], color=BEFORE, linewidth=1.2, zorder=1)
        for x, color in zip(sides, (BEFORE, AFTER), strict=True):
            fill = "white" if level.evaluation_only else color
            ax.scatter(x, place, 44, facecolor=fill, edgecolor=color, linewidth=1.6, zorder=2)
        text = f"{level.before:.2g} → {level.after:.2g} {level.unit}".replace("^2", "²")
        words = ax.annotate(text, (1.02, place), xycoords=("axes fraction", "data"))
        words.set(va="center", fontsize=9, color=INK if level.at_floor else OUTSIDE)
    ax.axvline(1.0, color=OUTSIDE, linewidth=1.4, linestyle=(0, (4, 2)), label="noise floor")
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    ax.set_xlim(min(low, 0.7), max(high, 1.5))
    label_decades(ax.xaxis)
    ax.set_yticks(places, [channels()[n].label or n.replace("_", " ") for n in levels], fontsize=9)
    ax.set_xlabel("residual over noise floor")
    ax.grid(False, axis="y")
    for color, label in ((BEFORE, "before"), (AFTER, "after")):
        ax.scatter([], [], 44, color=color, label=label)
    legend_below(figure, ax)
    return figure
