"""A trace as files: trace.json, effects.toml, a report with figures, and a recording."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surefoot.models.attribution.levels import ChannelLevel
from surefoot.models.residuals.registry import channels
from surefoot.scenarios.reporting.html import Picture, Section, write_report
from surefoot.scenarios.trace.figures import candidate_gains, residuals
from surefoot.scenarios.trace.result import Trace
from surefoot.scenarios.trace.words import VERDICTS, size_in_words, summary, unexplained_in_words
from surefoot.scenarios.viewer.recording import write_recording
from surefoot.sim.common.files import whole_file
from surefoot.sim.effects.file import save_effects
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import Machine

_METRICS = {
    "ape_trans": ("APE, translation", "m"),
    "ape_rot": ("APE, rotation", "deg"),
    "rpe_trans": ("RPE over 1 m, translation", "m"),
    "rpe_rot": ("RPE over 1 m, rotation", "deg/m"),
    "velocity": ("velocity, root mean square", "m/s"),
    "nees_position": ("NEES of position (3 if consistent)", ""),
    "nees_velocity": ("NEES of velocity (3 if consistent)", ""),
    "nees_attitude": ("NEES of attitude (3 if consistent)", ""),
}


def write_outputs(found: Trace, robot: Machine, out: Path, force: bool = False) -> None:
    """Write the trace's files, trace.json last: where it is, the others are whole too."""
    effects = found.effects
    if found.stretches and found.stretches[0].log.has("q"):
        shown = found.stretches[0]
        names = {f"{shown.filter} (declared model)": shown.before}
        if effects:
            names[f"{shown.filter} (effect added)"] = shown.after
        assert isinstance(robot, Robot)
        write_recording(out / "trace.rrd", shown.log, robot, names, force=force)
    write_report(out / "report.html", "Trace: what does the model lack?", sections(found), force)
    save_effects(out / "effects.toml", effects, force)
    with whole_file(out / "trace.json", force) as temporary:
        text = json.dumps(found.as_dict(), indent=2, allow_nan=False) + "\n"
        temporary.write_text(text, encoding="utf-8")


def sections(found: Trace) -> list[Section]:
    """The report's parts."""
    parts = [
        Section(
            "Verdict",
            f"{found.verdict}: {VERDICTS[found.verdict]}.\n\n" + "\n\n".join(_sentences(found)),
            table=_effects(found),
        )
    ]
    if found.channels:
        picture = Picture(
            residuals(channel_rows(found.channels)),
            "Root mean square residual of each channel on the end of the log, which no fit and no "
            "choice has seen. The dashed line is what a robot leaves that is as its model.",
        )
        masked = f"Masked as slipping: {100 * found.masked_share:.1f} % of stance time. "
        masked = masked if "leg_velocity" in found.channels else ""
        parts.append(
            Section(
                "Residual before and after",
                "Residuals are means over 20 ms. Turn-on biases of the IMU belong to the declared "
                "sensors and are taken off. "
                f"{masked}Noise floor: {found.floor}.",
                pictures=(picture,),
            )
        )
    rounds = found.attribution.rounds if found.attribution else ()
    chosen = [f"{e.name} {e.target}" for e in found.effects]
    pictures = []
    for k, candidates in enumerate(one for one in rounds if one):
        figure = candidate_gains(
            {f"{c.key[0]} {c.key[1]}": _gain(c) for c in candidates},
            chosen if k < len(chosen) else (),
            title=f"Round {k + 1}: share of the residual explained on held-out blocks",
        )
        model = "Candidates are fitted along with what is in the model already."
        if k == 0:
            model = "The best that earns its place enters the model."
        judged = "Each candidate is fitted on some blocks of the log and judged on others."
        pictures.append(Picture(figure, f"{judged} {model}"))
    if pictures:
        parts.append(Section("Candidates", pictures=tuple(pictures)))
    for name, metrics in found.filters.items():
        before, after = metrics["before"], metrics["after"]
        rows = [
            {"metric": words, "unit": unit, "before": before[key], "after": after[key]}
            for key, (words, unit) in _METRICS.items()
        ]
        words = (
            "The filter runs over the same end of the log, started from the reference: with the "
            "declared model, and with the effect added to it."
        )
        parts.append(Section(f"What it does to the {name} filter", words, table=rows))
    return parts


def channel_rows(levels: Mapping[str, ChannelLevel]) -> dict[str, dict[str, Any]]:
    """What the figure shows of each channel."""
    return {
        name: {**vars(level), "label": channels()[name].label} for name, level in levels.items()
    }


def _sentences(found: Trace) -> list[str]:
    lines = [
        f"Lacks {size_in_words(f)}." for f in (found.attribution.found if found.attribution else ())
    ]
    lines += [
        f"Or {r['name']} {r['target']}: their regressors overlap by {r['overlap']:.2f}."
        for r in found.rivals
    ]
    lines += [f"To distinguish them: {found.motion}."] if found.rivals else []
    lines += [line.strip() + "." for line in unexplained_in_words(found)]
    return lines + [f"Note: {note}." for note in found.notes]


def _effects(found: Trace):
    if not found.attribution or not found.attribution.found:
        return None
    return [
        {
            "effect": f.effect.name,
            "target": f.effect.target,
            "value": f.effect.value,
            "low": f.interval[0],
            "high": f.interval[1],
            "unit": f.effect.unit,
        }
        for f in found.attribution.found
    ]


def _gain(candidate) -> tuple[float, float, float]:
    scale = candidate.share / candidate.gain if candidate.gain else 0.0
    return candidate.share, candidate.interval[0] * scale, candidate.interval[1] * scale


__all__ = ["sections", "summary", "write_outputs"]
