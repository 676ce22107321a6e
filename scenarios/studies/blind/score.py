"""How the blind study is scored: each rule of it as one function of what a case left."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from scipy.stats import binomtest

from surefoot.scenarios.studies.blind.outside_effects import OUTSIDE

Record = Mapping[str, Any]


def named(record: Record) -> list[tuple[str, str]]:
    """Effects that the trace named, strongest first."""
    return [(e["name"], e["target"]) for e in record["effects_found"]]


def truth(record: Record) -> list[tuple[str, str]]:
    """Effects that were put in."""
    return [(e["name"], e["target"]) for e in record["effects"]]


def points(record: Record) -> float:
    """Of a log with one effect: 1 for the right effect and target first, a half where it is one of
    at most two that a `confounded` names, else 0."""
    said, true = named(record), truth(record)[0]
    others = [(r["name"], r["target"]) for r in record.get("rivals") or ()]
    if record["verdict"] == "confounded":
        among = {*said[:1], *others}
        return 0.5 if true in among and len(among) <= 2 else 0.0
    return 1.0 if said[:1] == [true] else 0.0


def sized(record: Record) -> bool | None:
    """Whether the size of the right effect is within a tenth, or within its interval."""
    if named(record)[:1] != truth(record)[:1]:
        return None
    found, true = record["effects_found"][0], record["effects"][0]["value"]
    low, high = found["interval"]
    return abs(found["value"] - true) <= 0.1 * abs(true) or low <= true <= high


def right_channel(record: Record) -> bool:
    """Of an effect that is in no catalogue: `none_of_these`, and the form of what is left, or else
    the channel that stands furthest above its floor, is in a channel that the effect shows in."""
    if record["verdict"] != "none_of_these":
        return False
    return channel_said(record) in OUTSIDE[record["effects"][0]["name"]].channels


def channel_said(record: Record) -> str:
    """The channel of the form of what is left, or else the one furthest above its floor."""
    if record.get("remainder"):
        return record["remainder"][0]["channel"]
    above = {
        name: c["before"] / c["noise_floor"]
        for name, c in record["channels"].items()
        if c["noise_floor"]
    }
    return max(above, key=lambda name: above[name], default="-")


def tells_twins(record: Record) -> bool:
    """Of effects that a standing robot cannot tell apart: `confounded`, both named."""
    name, target = record["twin"].split()
    both = {*named(record), *((r["name"], r["target"]) for r in record.get("rivals") or ())}
    return record["verdict"] == "confounded" and {truth(record)[0], (name, target)} <= both


def below_floor(record: Record) -> bool:
    """Whether an effect is smaller than this log could show."""
    return any(over is not None and over < 1.0 for over in record["over_floor"])


def share(hits: Sequence[float | bool]) -> str:
    """A share with its 95 % binomial interval: '91 % (83..96) of 100'."""
    if not hits:
        return "no case"
    ratio = sum(hits) / len(hits)
    interval = binomtest(round(sum(hits)), len(hits)).proportion_ci(method="wilson")
    return (
        f"{100 * ratio:.0f} % ({100 * interval.low:.0f}..{100 * interval.high:.0f}) of {len(hits)}"
    )


def rules(records: Sequence[Record]) -> list[dict[str, str]]:
    """The study's rules, what each asks for, and what was measured."""
    walked = [r for r in records if "fell" not in r]
    of = {
        kind: [r for r in walked if r["kind"] == kind]
        for kind in ("single", "clean", "outside", "together", "twins")
    }
    above = [r for r in of["single"] if not below_floor(r)]
    fits = [x for x in map(sized, of["single"]) if x is not None]
    both = [set(truth(r)) <= set(named(r)) for r in of["together"]]
    clear = [set(truth(r)) <= set(named(r)) for r in of["together"] if not below_floor(r)]
    rows = [
        ("right effect and target first", ">= 90 %", share([points(r) for r in of["single"]])),
        ("... of effects above the log's floor", "", share([points(r) for r in above])),
        ("its size within a tenth or its interval", "", share(fits)),
        ("a false name on a clean log", "<= 5 %", share([bool(named(r)) for r in of["clean"]])),
        (
            "none_of_these with the right channel, effect in no catalogue", ">= 80 %",
            share([right_channel(r) for r in of["outside"]]),
        ),
        ("two effects at once, both found", ">= 70 %", share(both)),
        ("... both above the log's floor", "", share(clear)),
        ("twins of a standing robot: confounded, both named", "",
         share([tells_twins(r) for r in of["twins"]])),
        ("the robot fell, no log", "", f"{len(records) - len(walked)} of {len(records)}"),
    ]  # fmt: skip
    return [{"rule": a, "asked": b, "measured": c} for a, b, c in rows]


def by_effect(records: Sequence[Record]) -> list[dict[str, Any]]:
    """A row an effect: how often it was found, how well sized, and what it was taken for."""
    rows = []
    single = [r for r in records if r["kind"] == "single" and "fell" not in r]
    for name in dict.fromkeys(truth(r)[0][0] for r in single):
        own = [r for r in single if truth(r)[0][0] == name]
        taken: dict[str, int] = {}
        for r in own:
            if points(r) == 1.0:
                continue
            first = named(r)[0][0] if named(r) else "nothing"
            if first == name:
                first = "confounded" if r["verdict"] == "confounded" else "another target"
            taken[first] = taken.get(first, 0) + 1
        sizes = [x for x in map(sized, own) if x is not None]
        rows.append(
            {
                "effect": name, "logs": len(own), "points": sum(points(r) for r in own),
                "below floor": sum(below_floor(r) for r in own),
                "size right": f"{sum(sizes)} of {len(sizes)}",
                "taken for": ", ".join(f"{k} ({v})" for k, v in taken.items()) or "-",
            }
        )  # fmt: skip
    return rows


def by_size(records: Sequence[Record]) -> list[dict[str, Any]]:
    """A row a range of size over floor."""
    edges = (0.0, 1.0, 2.0, 5.0, 20.0, float("inf"))
    single = [r for r in records if r["kind"] == "single" and "fell" not in r]
    rows = []
    for low, high in pairwise(edges):
        own = [
            r for r in single if r["over_floor"][0] is not None and low <= r["over_floor"][0] < high
        ]
        if own:
            hits = share([points(r) for r in own])
            rows.append({"size over floor": f"{low:g} to {high:g}", "right": hits})
    unknown = [r for r in single if r["over_floor"][0] is None]
    if unknown:
        hits = share([points(r) for r in unknown])
        rows.append({"size over floor": "not a candidate of trace", "right": hits})
    return rows
