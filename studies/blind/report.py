"""Report of the blind study: its rules, tables by effect, size and case, and two figures."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import binomtest

from studies.blind.outside_effects import OUTSIDE_EFFECTS
from studies.blind.plan import PLAN, draw_cases, study_robot
from surefoot.extend import known_effects, read_toml
from surefoot.scenarios.reporting import (
    AFTER,
    INK,
    Picture,
    Section,
    new_figure,
    origin_of,
    set_title,
    write_page,
    write_results,
)
from surefoot.scenarios.reporting import OUTSIDE as MISSED

Record = Mapping[str, Any]
Rows = list[dict[str, Any]]
CASE_KINDS = ("single", "clean", "outside", "together", "twins")
BEYOND_KINDS = ("exact", "late", "large")
NOT_NAMED = ("nothing", "another target", "confounded")
"""Further columns of the confusion matrix, for logs whose effect was not found."""


def write_report_of(
    out: Path, records: Sequence[Record], page: Path | None = None, plan: Path = PLAN
) -> str:
    """Write report.html, table.md, cases.csv and, if given, the page of a plan's results.

    Returns the tables as text.
    """
    walked = [r for r in records if "fell" not in r]
    of = {kind: [r for r in walked if r["kind"] == kind] for kind in CASE_KINDS + BEYOND_KINDS}
    drawn = read_toml(plan, "study")
    if drawn["each"]:
        title = "Blind study of trace"
        limits = Section("Limits of the sizes", "", plan_table(drawn), file="limits")
        sections = [
            *(results(of, records) if of["single"] else ()),
            Section("Method", f"{plan_prose(drawn, len(records))}\n\n{RULES_PROSE}"),
            limits,
        ]
    else:
        title = "Beyond the blind study of trace"
        sections = beyond(of, len(records) - len(walked))
    every = Section("Every case", "", [_row(r) for r in records], file="cases")
    if page:
        origin = origin_of(__name__, "make study-trace")
        write_page(page, title, [*sections, every], origin)
    return write_results(out, title, [*sections, every], force=True)


def plan_prose(plan: Mapping[str, Any], finished: int) -> str:
    """Describe the cases of a plan, and how many are finished."""
    planned = draw_cases(plan)
    count = Counter(case.kind for case in planned)
    robots, seeds = plan["walk"]["robots"], plan["walk"]["seeds"]
    grouped = sum(
        one.target not in one.single_targets(study_robot(case.robot).limbs)
        for case in planned
        for one in case.effects
        if case.kind == "single"
    )
    return (
        f"{len(planned)} cases, all drawn from seed {plan['seed']} before the first was run: "
        f"{count['single']} logs with one undeclared effect ({grouped} of them on a group of "
        f"parts), {count['clean']} without any, {count['outside']} with an effect that is in no "
        f"catalogue, {count['together']} with two at once, {count['twins']} of a robot at rest "
        f"with one of two effects that cannot be distinguished at rest. {' and '.join(robots)} "
        f"walk on courses {seeds[0]} to {seeds[-1]}; these robots and courses were "
        f"{'' if plan.get('pilot') else 'not '}used in development. Sizes are log-uniform between "
        "the limits of the table of sizes. "
        f"Finished so far: {finished} of {len(planned)}."
    )


def plan_table(plan: Mapping[str, Any]) -> Rows:
    """One row for each effect: the limits between which its size is drawn."""
    return [
        {
            "effect": name,
            "in the catalogue": known,
            "from": low,
            "to": high,
            "unit": (known_effects() if known else OUTSIDE_EFFECTS)[name].unit,
        }
        for known, key in ((True, "sizes"), (False, "outside_sizes"))
        for name, (low, high) in plan[key].items()
    ]


def results(of: Mapping[str, Sequence[Record]], records: Sequence[Record]) -> list[Section]:
    """Sections on the results of the finished cases."""
    lines = rules(records)
    found, of_above, _, false_names, outside, *_ = (line["measured"] for line in lines)
    prose = (
        f"Trace names the effect that was put in, and its target, first in {found} logs with one "
        f"effect, and in {of_above} whose effect is larger than the least that the log could show. "
        f"False names on logs without an effect: {false_names}. An effect that is in no catalogue "
        f"ends in `none_of_these`, on the right channel, in {outside} logs."
    )
    return [
        Section("Findings", prose, lines),
        Section(
            "By effect",
            "",
            by_effect(of["single"]),
            (
                Picture(
                    confusion(of["single"]),
                    "Rows: the true effect of each log. Columns: the effect that trace named "
                    "first. On the diagonal, the target (joint, leg or axis) is right too, and the "
                    "verdict is not `confounded`.",
                ),
            ),
            file="by_effect",
        ),
        Section(
            "By size over the least that the log could show",
            "",
            by_size(of["single"]),
            (
                Picture(
                    sizes(of["single"]),
                    "One dot for each log whose effect and target were named right first. The band "
                    "is 10 % about the true size; dots are red if neither the band nor the "
                    "interval contains it. Dots beyond the axis are drawn at its edge.",
                ),
            ),
            file="by_size",
        ),
        *details(of),
    ]


def beyond(of: Mapping[str, Sequence[Record]], fell: int) -> list[Section]:
    """Sections on what the study's draws do not reach."""
    exact, late, large = (of[kind] for kind in BEYOND_KINDS)
    lines = [
        ("robot as declared: no_residual", [r["verdict"] == "no_residual" for r in exact]),
        ("robot as declared: no effect named", [not named(r) for r in exact]),
        ("all joint readings late: named first", [named(r)[:1] == truth(r) for r in late]),
        ("twice the largest size: named first", [named(r)[:1] == truth(r) for r in large]),
        ("late or large: nothing else named", [named(r) == truth(r) for r in (*late, *large)]),
    ]
    rows = [{"of": a, "measured": share(hits)} for a, hits in lines]
    prose = (
        f"A robot that equals its model ends in `no_residual` in {rows[0]['measured']} walks on a "
        "slope, on ice, on stairs and on rough ground. Joint readings that are all late are named "
        f"first in {rows[2]['measured']}, and effects of twice the largest size of the blind study "
        f"in {rows[3]['measured']}."
    )
    method = (
        "Angles, rates and torques of all joints are late by the same time. Shares with their 95 % "
        f"interval (Wilson) in brackets. Falls, which leave no log: {fell}."
    )
    grounds = [
        {
            "ground": r["ground"],
            "robot": r["robot"],
            "verdict": r["verdict"],
            "reasons": "; ".join(r["reasons"]) or "-",
            "masked as slipping [%]": 100.0 * r["masked_share"],
        }
        for r in exact
    ]
    large_and_late = [_short(r) for r in (*late, *large)]
    return [
        Section("Findings", prose, rows),
        Section("Method", method),
        Section("Robots as declared", "", grounds, file="as_declared"),
        Section("Late joints and large effects", "", large_and_late, file="late_and_large"),
    ]


RULES_PROSE = (
    "Shares, with their 95 % interval (Wilson) in brackets. A `confounded` verdict that names the "
    "true effect among two counts as half. An effect is above the floor if its size exceeds the "
    "smallest that its log could show. The logs are simulated with the same physics that trace "
    "assumes, so the study measures how well effects are distinguished from each other, not how "
    "well a model describes a robot."
)


def named(record: Record) -> list[tuple[str, str]]:
    """Name and target of the effects that the trace found, strongest first."""
    return [(e["name"], e["target"]) for e in record["effects_found"]]


def truth(record: Record) -> list[tuple[str, str]]:
    """Name and target of the effects that were injected."""
    return [(e["name"], e["target"]) for e in record["effects"]]


def rivals(record: Record) -> list[tuple[str, str]]:
    """Name and target of the effects that the trace could not distinguish from the one it found."""
    return [(r["name"], r["target"]) for r in record.get("rivals") or ()]


def points(record: Record) -> float:
    """Score of a log with one effect.

    1 if the right effect and target are named first, 1/2 if the verdict is `confounded` and names
    them among at most two, else 0.
    """
    first, true = named(record)[:1], truth(record)[0]
    if record["verdict"] == "confounded":
        among = {*first, *rivals(record)}
        return 0.5 if true in among and len(among) <= 2 else 0.0
    return 1.0 if first == [true] else 0.0


def sized(record: Record) -> bool | None:
    """Whether the size found is within 10 % of the true one, or its interval contains that; None
    if another effect was named first.
    """
    if named(record)[:1] != truth(record)[:1]:
        return None
    found, true = record["effects_found"][0], record["effects"][0]["value"]
    low, high = found["interval"]
    return abs(found["value"] - true) <= 0.1 * abs(true) or low <= true <= high


def right_channel(record: Record) -> bool:
    """Whether the trace of a log with an effect outside the catalogue is right: the verdict is
    `none_of_these`, and `main_channel` is one that the effect shows in.
    """
    if record["verdict"] != "none_of_these":
        return False
    return main_channel(record) in OUTSIDE_EFFECTS[record["effects"][0]["name"]].traced.channels


def main_channel(record: Record) -> str:
    """The channel whose unexplained residual has a form, or else the one furthest above its noise
    floor.
    """
    if record.get("remainder"):
        return record["remainder"][0]["channel"]
    above = {
        name: c["before"] / c["noise_floor"]
        for name, c in record["channels"].items()
        if c["noise_floor"]
    }
    return max(above, key=lambda name: above[name], default="-")


def names_both_twins(record: Record) -> bool:
    """Whether the verdict on a standing robot is `confounded`, and both effects that cannot be
    distinguished there are named.
    """
    twin = tuple(record["twin"].split())
    both = {truth(record)[0], twin} <= {*named(record), *rivals(record)}
    return record["verdict"] == "confounded" and both


def names_all(record: Record) -> bool:
    """Whether every injected effect was found."""
    return set(truth(record)) <= set(named(record))


def below_floor(record: Record) -> bool:
    """Whether an injected effect is smaller than the least size that its log could show."""
    return any(over is not None and over < 1.0 for over in record["over_floor"])


def share(hits: Sequence[float | bool]) -> str:
    """A share with its 95 % binomial interval: '91 % (83..96) of 100'."""
    if not hits:
        return "no case"
    ratio = sum(hits) / len(hits)
    interval = binomtest(round(sum(hits)), len(hits)).proportion_ci(method="wilson")
    # Nearly all is not all, nor is hardly any none.
    digits = 1 if round(100 * ratio) in (0, 100) and 0 < ratio < 1 else 0
    between = f"{100 * interval.low:.0f}..{100 * interval.high:.0f}"
    return f"{100 * ratio:.{digits}f} % ({between}) of {len(hits)}"


def count(hits: Sequence[bool]) -> str:
    """A count that should be zero, with the 95 % interval of its share: '1 of 300 (0.1..1.9 %)'."""
    if not hits:
        return "no case"
    interval = binomtest(sum(hits), len(hits)).proportion_ci(method="wilson")
    between = f"{100 * interval.low:.1f}..{100 * interval.high:.1f} %"
    return f"{sum(hits)} of {len(hits)} ({between})"


def rules(records: Sequence[Record]) -> Rows:
    """The study's rules: what each requires, and what was measured."""
    walked = [r for r in records if "fell" not in r]
    single, clean, outside, together, twins = (
        [r for r in walked if r["kind"] == kind] for kind in CASE_KINDS
    )
    above = [r for r in single if not below_floor(r)]
    clear = [r for r in together if not below_floor(r)]
    fits = [fit for fit in map(sized, single) if fit is not None]
    lines = [
        ("right effect and target first", ">= 90 %", share([points(r) for r in single])),
        ("... of effects above the log's floor", ">= 95 %", share([points(r) for r in above])),
        ("its size within a tenth or its interval", "", share(fits)),
        ("a false name on a clean log", "none", count([bool(named(r)) for r in clean])),
        (
            "none_of_these with the right channel, effect in no catalogue",
            ">= 90 %",
            share([right_channel(r) for r in outside]),
        ),
        ("two effects at once, both found", ">= 75 %", share([names_all(r) for r in together])),
        ("... both above the log's floor", "", share([names_all(r) for r in clear])),
        (
            "twins of a standing robot: confounded, both named",
            "",
            share([names_both_twins(r) for r in twins]),
        ),
        (
            "a channel above all walks of its floor, worse by a tenth with what was named",
            "none",
            count(made_worse(walked)),
        ),
        ("the robot fell, no log", "", f"{len(records) - len(walked)} of {len(records)}"),
    ]
    return [{"rule": a, "asked": b, "measured": c} for a, b, c in lines]


def made_worse(walked: Sequence[Record]) -> list[bool]:
    """For each log in which effects were found: whether compensation raised the residual of a
    channel by more than 10 %, and above that of every walk of the noise floor.
    """
    return [
        any(
            c["after"] > max(1.1 * c["before"], c["highest"] or 0.0) for c in r["channels"].values()
        )
        for r in walked
        if named(r)
    ]


def named_first(record: Record) -> str:
    """The effect named first or, if it is the right one but does not count, the reason from
    NOT_NAMED.
    """
    first = named(record)[0][0] if named(record) else "nothing"
    if first == truth(record)[0][0] and points(record) < 1.0:
        return "confounded" if record["verdict"] == "confounded" else "another target"
    return first


def by_effect(single: Sequence[Record]) -> Rows:
    """One row for each effect: how often it and its size were found, and what was named instead."""
    rows = []
    for name in dict.fromkeys(truth(r)[0][0] for r in single):
        own = [r for r in single if truth(r)[0][0] == name]
        instead = Counter(named_first(r) for r in own if points(r) < 1.0)
        fits = [fit for fit in map(sized, own) if fit is not None]
        row = {
            "effect": name,
            "logs": len(own),
            "points": sum(points(r) for r in own),
            "below floor": sum(below_floor(r) for r in own),
            "size right": f"{sum(fits)} of {len(fits)}",
            "named instead": ", ".join(f"{k} ({v})" for k, v in instead.items()) or "-",
        }
        rows.append(row)
    return rows


def by_size(single: Sequence[Record]) -> Rows:
    """One row for each range of the size relative to the least that the log could show."""
    rows = []
    for low, high in pairwise((0.0, 1.0, 2.0, 5.0, 20.0, float("inf"))):
        over = [(r, r["over_floor"][0]) for r in single if r["over_floor"][0] is not None]
        own = [points(r) for r, size in over if low <= size < high]
        rows += [{"size over floor": f"{low:g} to {high:g}", "right": share(own)}] if own else []
    unknown = [points(r) for r in single if r["over_floor"][0] is None]
    if unknown:
        rows.append({"size over floor": "not a candidate of trace", "right": share(unknown)})
    return rows


def details(of: Mapping[str, Sequence[Record]]) -> list[Section]:
    """A table for each kind of case, with one row per log; of the logs with one effect, only those
    that were missed.
    """
    tables = {
        "Every miss": [
            _short(r) | {"size over floor": r["over_floor"][0]}
            for r in of["single"]
            if points(r) < 1
        ],
        "False names on clean logs": [_short(r) for r in of["clean"] if named(r)],
        "Effects in no catalogue": [
            _short(r) | {"channel": main_channel(r), "right": right_channel(r)}
            for r in of["outside"]
        ],
        "Two effects at once": [_short(r) | {"both": names_all(r)} for r in of["together"]],
        "Twins of a robot that stands": [
            _short(r) | {"its twin": r["twin"], "right": names_both_twins(r)} for r in of["twins"]
        ],
    }
    return [
        Section(heading, "", rows, file=heading.lower().replace(" ", "_"))
        for heading, rows in tables.items()
        if rows
    ]


def confusion(single: Sequence[Record]) -> Figure:
    """Confusion matrix: the true effect against the one named first, as counts."""
    names = list(known_effects())
    columns = [*names, *NOT_NAMED]
    counts = np.zeros((len(names), len(columns)))
    for r in single:
        counts[names.index(truth(r)[0][0]), columns.index(named_first(r))] += 1
    figure, axes = new_figure(size=(9.5, 8.5))
    ax = axes[0, 0]
    ax.imshow(counts, cmap="Blues", vmin=0, vmax=max(1.0, counts.max()), aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        color = "white" if counts[i, j] > 0.6 * counts.max() else INK
        ax.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=7, color=color)
    ax.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=90)
    ax.set_yticks(range(len(names)), [n.replace("_", " ") for n in names])
    ax.tick_params(labelsize=7)
    ax.grid(False)
    ax.axvline(len(names) - 0.5, color=INK, linewidth=0.8)
    ax.set_xlabel("named first")
    ax.set_ylabel("put in")
    set_title(ax, "Effects put in, and effects that trace names first")
    return figure


def sizes(single: Sequence[Record]) -> Figure:
    """Ratio of the size found to the true size, against the true size over the noise floor."""
    figure, axes = new_figure(size=(7.5, 4.2))
    ax = axes[0, 0]
    least, most = 0.5, 1.5
    for r in single:
        over, fit = r["over_floor"][0], sized(r)
        if fit is None or over is None:
            continue
        found, true = r["effects_found"][0], r["effects"][0]["value"]
        ratio = np.clip(np.array([found["value"], *found["interval"]]) / true, least, most)
        color = AFTER if fit else MISSED
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


def _short(record: Record) -> dict[str, Any]:
    row = _row(record)
    name = row["named"] if row["rivals"] == "-" else f"{row['named']} (rivals: {row['rivals']})"
    return {key: row[key] for key in ("put in", "robot", "verdict")} | {"named": name}


def _row(record: Record) -> dict[str, Any]:
    over = [x for x in record.get("over_floor", ()) if x is not None]
    return {
        "case": record["number"],
        "kind": record["kind"],
        "robot": record["robot"],
        "seed": record["seed"],
        "put in": listed(record["effects"]),
        "verdict": record.get("verdict", "fell"),
        "named": listed(record.get("effects_found", ())),
        "rivals": ", ".join(" ".join(rival) for rival in rivals(record)) or "-",
        "size over floor": over[0] if over else None,
    }


def listed(effects: Sequence[Mapping[str, Any]]) -> str:
    """Effects of a record in words; "-" for none."""
    parts = [f"{e['name']} {e['target']} {e['value']:.3g} {e['unit']}" for e in effects]
    return ", ".join(parts) or "-"
