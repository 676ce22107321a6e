"""Result of a trace: its report, in sentences, tables and a picture, and its other files."""

import json
from collections.abc import Collection, Mapping, Sequence
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
from surefoot.scenarios.reporting.tables import Table, cell
from surefoot.scenarios.trace import filters
from surefoot.scenarios.trace.result import Filters, Trace
from surefoot.scenarios.viewer.recording import RecordedWalk, write_recording
from surefoot.sim.common.files import write_whole
from surefoot.sim.effects import Effect, known_effects
from surefoot.sim.effects.file import save_effects
from surefoot.sim.robot.machine import Machine

VERDICTS = {
    "attributed": "the model lacks {}; what remains of the residual is noise",
    "confounded": "the model lacks {}, but these data do not tell this from other effects",
    "none_of_these": "a residual remains that no effect of the catalogue explains",
    "not_identifiable": "the data cannot identify an effect",
    "no_residual": "the model explains the log down to its noise floor",
    "unchanged": "nothing has changed since the runs that the declared effects were found in",
}
"""The result in one sentence; `{}` stands for the effects found."""
_MUCH = 0.1
"""Share of the squared residual that an effect outside its bounds must explain to be mentioned."""
_SCALE = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "s": (1e3, "ms"), "ratio": (1e2, "%")}
DRIFT_PARTS = {
    "RPE [mm]": 1e3,
    "height [mm/m]": 1e3,
    "yaw [deg/m]": np.degrees(1.0),
    "distance [%]": 1e2,
}
"""Parts of a drift (`filters.drift_parts`) as they are shown, and their factors."""
FIRST = ("drift", "ape_trans", "rpe_trans", "nees_position")
"""Metrics of a filter that are shown first."""


def write_outputs(found: Trace, robot: Machine, out: Path) -> None:
    """Write the trace's files into an empty folder."""
    effects = found.effects
    if robot.legged is not None and found.stretches and found.stretches[0].log.has("q"):
        first = found.stretches[0]
        estimates = {f"{first.filter} before": first.before.estimate}
        if effects:
            estimates[f"{first.filter} after"] = first.after.estimate
        write_recording(out / "trace.rrd", RecordedWalk(first.log, robot.legged, estimates))
    title = headline(found)
    write_report(out / "report.html", f"{title[0].upper()}{title[1:]}", sections(found))
    save_effects(out / "effects.toml", effects, limbs=robot.limbs)
    text = json.dumps(found.as_dict(), indent=2, allow_nan=False) + "\n"
    write_whole(out / "trace.json", text)


def summary(found: Trace) -> str:
    """The report for a terminal, without what is folded."""
    shown = [one for one in sections(found) if not one.folded]
    return markdown_report(f"verdict: {found.verdict}: {headline(found)}", shown).rstrip()


def sections(found: Trace) -> list[Section]:
    """Sections of the report below its headline: the residual, what to do next, filters, what
    speaks for each effect, and notes; the rest is folded.
    """
    first, further = ranked_notes(found)
    where = "held-out logs" if found.held_out else "the parts of the logs used by no fit"
    steps = "Names in capitals are of logs that you record."
    named = (
        "An effect is named from the size that noise and errors of the model hardly reach, if it "
        "exceeds 2 standard deviations between blocks of the logs and between channels; the guide "
        "has all criteria."
    )
    imitated = sorted(found.attribution.imitated) if found.attribution else []
    unsure = [
        f"{name} {target} may be what the other effects leave once they are compensated, which its "
        "interval includes; it is kept since a channel is worse without it"
        for name, target in imitated
    ]
    levels = (
        f"Root mean square of means over {1e3 * found.averaged_over:.0f} ms, on {where}; turn-on "
        "biases of the IMU are subtracted."
    )
    shown = ("before", "after", "noise_floor", "unit")
    residuals = [
        {"channel": n, **{k.replace("_", " "): getattr(one, k) for k in shown}, "": state_of(one)}
        for n, one in found.unseen_channels.items()
    ]
    left = [*beyond_bounds(found), *unexplained_in_words(found)]
    possible = {k: size for k, size in found.least.items() if size <= _largest(found, k)}
    hidden = sorted({name for name, _ in found.least.keys() - possible.keys()})
    sizes = [_sized(found, key, size) for key, size in possible.items()]
    title = "Least changes that would have been named in 95 of 100 such logs"
    unseen = (
        [f"On parts that are not listed, no size shows of {', '.join(hidden)}"] if hidden else []
    )
    least = _given(title, unseen, sizes)
    return [
        _verdict(found, where),
        *([Section("What to do next", steps, steps=found.steps)] if found.steps else []),
        *_of_filters(found),
        *_given("Effects found", [named, *unsure], _sizes(found, found.found)),
        *_given("Residual of each channel", [levels], residuals),
        *_given("What the remaining residual correlates with", left),
        *_given("Notes", first),
        *(least if found.verdict == "unchanged" else [replace(one, folded=True) for one in least]),
        *(replace(one, folded=True) for one in _details(found, further)),
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
        sides = {"before": one.before.lost, "after": one.after.lost}
        words += [f"{side}, on {one.log.name}: {why}" for side, why in sides.items() if why]
    rows = filter_rows(found.judged_filters, FIRST)
    parts = _given("Filters before and after", words, rows)
    if found.causes:
        drifts = {
            "as declared": found.causes.declared,
            **{f"{e.name} {e.target} adds": x for e, x in found.causes.added},
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


def _details(found: Trace, further: Sequence[str]) -> list[Section]:
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
    every = filter_rows(found.judged_filters, filters.REPORTED)
    return [
        *_given("What is assumed, and what these logs cannot show", further),
        *_given("Every metric of the filters", [], every),
        *_given("Zeros and clocks of each run", [], zeros),
        *_given("Considered and rejected", [], rejected),
    ]


def _sizes(found: Trace, ones: Sequence[Found]) -> list[dict[str, Any]]:
    """One row per effect, with as many digits as distinguish the ends of its interval."""
    rows = []
    for f in ones:
        key = f.effect.name, f.effect.target
        row = _sized(found, key, f.effect.value)
        row |= {"low": f"{f.interval[0]:.4g}", "high": f"{f.interval[1]:.4g}"}
        if np.isfinite(f.excess):
            deviations = {"standard deviations": f.excess, "agreement": f.agreement}
            row |= {"named from": f"{f.least:.3g}"}
            row |= {name: f"{x:.1f}" for name, x in deviations.items()}
        rows.append(row)
    return rows


def _largest(found: Trace, key: tuple[str, str]) -> float:
    """The largest size that an effect may have on the machine, in its unit."""
    name, target = key
    return max(map(abs, known_effects()[name].bounds_on(found.limbs, target)))


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


def headline(found: Trace) -> str:
    """The result in one sentence."""
    effects = [_in_words(found, one) for one in found.effects]
    several = f"{', '.join(effects[:-1])} and {effects[-1]}" if effects[1:] else "".join(effects)
    if found.verdict == "none_of_these" and effects:
        what = "1 effect explains" if len(effects) == 1 else f"{len(effects)} effects explain"
        return f"{what} a part of the residual, and no effect of the catalogue the rest"
    return VERDICTS[found.verdict].format(several)


def _in_words(found: Trace, one: Effect) -> str:
    factor, unit = _scale(found, one.name, one.target)
    return f"{one.name} {one.target} {factor * one.value:+.3g} {unit}"


def _scale(found: Trace, name: str, target: str) -> tuple[float, str]:
    """Factor to a suitable multiple of an effect's unit, and this multiple."""
    unit = found.unit_of(name, target)
    return _SCALE.get(unit, (1.0, unit))


def unexplained_in_words(found: Trace) -> list[str]:
    """The three strongest correlations of the unexplained residual, one line each."""
    return [
        f"{100 * r.share:.0f} % of the remaining residual in {r.channel} {r.column} is explained "
        f"by {', '.join(r.regressors)}"
        if r.regressors
        else f"no regressor explains the remaining residual in {r.channel} {r.column}"
        for r in found.unexplained[:3]
    ]


def beyond_bounds(found: Trace) -> list[str]:
    """The two effects that would explain most of the remaining residual, but only with impossible
    sizes, one line each; none if the trace explains the log.
    """
    if found.verdict != "none_of_these" or not found.rounds:
        return []
    out = [c for c in found.rounds[0] if c.at_bound and c.share > _MUCH]
    lines = []
    for one in sorted(out, key=lambda c: -c.share)[:2]:
        kind = known_effects()[one.key[0]]
        factor, unit = _scale(found, *one.key)
        low, high = (factor * x for x in kind.bounds_on(found.limbs, one.key[1]))
        lines.append(
            f"{one.key[0]} {one.key[1]} of {factor * one.size:+.3g} {unit} would explain "
            f"{100 * one.share:.0f} % of the residual, but its bounds are {low:.3g} and "
            f"{high:.3g}"
        )
    return lines


def state_of(level: ChannelLevel) -> str:
    """What a channel's residual says of the model."""
    if level.worse:
        return "worse"
    if level.evaluation_only:
        return "for evaluation only"
    return "at its floor" if level.at_floor else "above its floor"


def ranked_notes(found: Trace) -> tuple[list[str], list[str]]:
    """Notes on faults of the logs and the result; on assumptions and what the logs cannot show."""
    urgent = {*found.channels, "excluded from the verdict", *found.warnings, *found.worse}
    first, further = [], []
    if "leg_velocity" in found.channels:
        further.append(f"masked as slipping: {100 * found.masked_share:.1f} % of stance time")
    if found.channels:
        further.append(f"noise floor: {found.floor}")
    for note in dict.fromkeys(one for one in found.notes if one not in found.reasons):
        (first if {note, note.partition(":")[0]} & urgent else further).append(note)
    return first, further


def filter_rows(errors: Filters, metrics: Collection[str]) -> list[dict[str, str]]:
    """One row per filter: metrics before and after, and whether errors of the position grew."""
    rows: list[dict[str, str]] = []
    for name, sides in errors.items():
        before, after = sides["before"], sides["after"]
        row = {
            filters.REPORTED[key]: f"{cell(before[key], 4)} → {cell(after[key], 4)}"
            for key in metrics
            if key in filters.OF_POSITION or name != filters.DEAD_RECKONING
        }
        rows.append({"filter": name, **row, "": filters.change_of_errors(sides)})
    return rows


def caution(found: Mapping[str, Any]) -> str:
    """Warning for users of the effects of a trace.json; "" where none is due."""
    if found["verdict"] != "none_of_these" or not found["effects"]:
        return ""
    harm = [note for note in found["notes"] if note.endswith("with the effects found")]
    words = "caution: a residual remains, and the effects found may stand in for its cause"
    return "; ".join([words, *harm])
