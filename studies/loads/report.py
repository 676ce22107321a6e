"""Report of the study: its rules, and tables by machine and case."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studies.blind.report import listed, share
from studies.loads.plan import KINDS, PLAN, draw_load_cases
from surefoot.extend import read_toml
from surefoot.scenarios.reporting import Section, origin_of, write_page, write_results

Record = Mapping[str, Any]
Rows = list[dict[str, Any]]
LOAD = ("link_mass", "link_com", "link_inertia", "armature")
"""Effects by which a load may be named. A link that turns about a vertical axis shows its load as
`armature`, which no motion tells from the inertia of the first link.
"""
RULES_PROSE = (
    "Shares, with their 95 % interval (Wilson) in brackets. A load is named right if every effect "
    "named is of the link that it is tied to; a `confounded` verdict with this link among two "
    "counts as half. It is above the least change if it shows more clearly than so much mass at "
    "the link's centre as would have been named in 95 of 100 runs. A verdict is refuted by a "
    "held-out run of the same machine where the effects found leave more than without them, or "
    "where a verdict by which nothing else is missing leaves 1.5 times what the true effects leave."
)


def write_page_of(out: Path, records: Sequence[Record], page: Path | None = None) -> str:
    """Write report.html, table.md, cases.csv and, if given, the page of results.

    Returns the tables as text.
    """
    drawn = draw_load_cases(read_toml(PLAN, "study"))
    every = [_row(r) for r in records]
    rules = rules_of_loads(records)
    main = (
        f"Loads above the least change are named on the right link in {rules[0]['measured']}; "
        f"asked are {rules[0]['asked']}."
    )
    plan = _plan_prose(Counter(case.kind for case in drawn), len(records))
    sections = [
        Section("Findings", main, rules),
        Section("Method", f"{plan}\n\n{RULES_PROSE}"),
        Section("By machine", "", by_machine(records), file="machines"),
        Section("Every case", "", every, file="cases"),
    ]
    title = "Loads tied to links, and machines on fixed bases"
    if page:
        write_page(page, title, sections, origin_of(__name__, "make study-loads"))
    return write_results(out, title, sections, force=True)


def _plan_prose(count: Mapping[str, int], finished: int) -> str:
    plan = read_toml(PLAN, "study")
    loads, fixed = plan["loads"], plan["fixed"]
    return (
        f"{sum(count.values())} cases, all drawn from seed {plan['seed']} before the first was "
        f"run. {', '.join(loads['machines'])}: {loads['individuals']} machines each, with errors "
        f"of their own in masses, gears and sensors, calibrated on {loads['runs']} runs by `trace "
        f"RUNS... -o DIR`; then {count['load']} runs with a load at an unknown place of an unknown "
        f"link and {count['unchanged']} runs without, by `trace RUN --declared DIR/effects.toml`. "
        f"{', '.join(fixed['machines'])}: {fixed['each']} runs each of a link of twice the "
        "density, of gears that lose a share of their torque, of pushes by a hand, and of delays. "
        f"Finished so far: {finished}."
    )


def rules_of_loads(records: Sequence[Record]) -> Rows:
    """What was asked, and what was measured."""
    loads = [r for r in records if r["kind"] == "load"]
    above, below = ([r for r in loads if is_above(r) is side] for side in (True, False))
    unchanged = [r for r in records if r["kind"] == "unchanged"]
    fixed = [r for r in records if r["kind"] in KINDS]
    delays = [r for r in fixed if r["kind"] == "delay"]
    lines = [
        (
            "loads above the least change: right link",
            "90 %",
            share([points_of(r) for r in above]),
        ),
        (
            "loads above the least change: `not_identifiable`",
            "at most 10 %",
            share([r["verdict"] == "not_identifiable" for r in above]),
        ),
        ("loads below it: another link named", "-", share([is_wrong(r) for r in below])),
        (
            "unchanged runs in which a change is named",
            "0 of 30",
            f"{sum(bool(r['effects_found']) for r in unchanged)} of {len(unchanged)}",
        ),
        (
            "fixed bases: verdicts that a held-out run refutes",
            "0 of 40",
            f"{sum(bool(r['refuted']) for r in fixed)} of {len(fixed)}",
        ),
        ("delays within their interval", "95 %", share([has_delay(r) for r in delays])),
        ("CPU seconds a case: mean, most", "-", _times([r["cpu"] for r in records])),
    ]
    return [{"rule": a, "asked": b, "measured": c} for a, b, c in lines]


def _times(seconds: Sequence[float]) -> str:
    return f"{np.mean(seconds):.0f}, {np.max(seconds):.0f}" if seconds else "-"


def is_above(record: Record) -> bool:
    """Whether a load is above the least change; one that shows in nothing is not."""
    return (record.get("over_least") or 0.0) > 1.0


def named_links(effects: Sequence[Mapping[str, Any]]) -> set[str]:
    """The links of effects of links, and the effects that are of none."""
    return {
        e["target"].removesuffix(f"_{e['target'][-1]}")
        if e["name"] == "link_com"
        else e["target"]
        if e["name"] in LOAD
        else e["name"]
        for e in effects
    }


def points_of(record: Record) -> float:
    """1 if only the load's link is named, 1/2 if it is one of two that the runs do not tell."""
    true, found = {record["effects"][0]["target"]}, named_links(record["effects_found"])
    if record["verdict"] == "confounded":
        among = found | named_links(record["rivals"] or ())
        return 0.5 if true <= among and len(among) <= 2 else 0.0
    return float(record["verdict"] == "attributed" and found == true)


def is_wrong(record: Record) -> bool:
    """Whether a load is named as something else."""
    return bool(named_links(record["effects_found"]) - {record["effects"][0]["target"]})


def has_delay(record: Record) -> bool:
    """Whether a delay is named and its interval has the true one."""
    true = record["effects"][0]
    own = [e for e in record["effects_found"] if e["name"] == true["name"]]
    return any(e["interval"][0] <= true["value"] <= e["interval"][1] for e in own)


def right(record: Record) -> float | None:
    """Points of a case; None for a load below the least change that is not named wrong."""
    if record["kind"] == "load":
        return points_of(record) if is_above(record) else 0.0 if is_wrong(record) else None
    if record["kind"] == "unchanged":
        return float(not record["effects_found"])
    return float(not record["refuted"] and (record["kind"] != "delay" or has_delay(record)))


def by_machine(records: Sequence[Record]) -> Rows:
    """One row for each machine and kind of case."""
    rows = []
    for machine, kind in dict.fromkeys((r["machine"], r["kind"]) for r in records):
        own = [r for r in records if (r["machine"], r["kind"]) == (machine, kind)]
        judged = [x for x in map(right, own) if x is not None]
        verdicts = Counter(r["verdict"] for r in own)
        rows.append(
            {
                "machine": machine,
                "kind": kind,
                "cases": len(own),
                "right": f"{sum(judged):g} of {len(judged)}",
                "verdicts": ", ".join(f"{k} ({v})" for k, v in verdicts.items()),
            }
        )
    return rows


def _row(record: Record) -> dict[str, Any]:
    return {
        "case": record["number"],
        "kind": record["kind"],
        "machine": record["machine"],
        "put in": listed(record["effects"]),
        "verdict": record["verdict"],
        "named": listed(record["effects_found"]),
        "rivals": ", ".join(f"{r['name']} {r['target']}" for r in record["rivals"] or ()) or "-",
        "over the least": record.get("over_least"),
        "refuted by": ", ".join(record.get("refuted", ())) or "-",
        "right": right(record),
    }
