"""What the measurements on real machines show, in words: a report and a page for each machine."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from surefoot.extend import read_toml
from surefoot.scenarios.reporting import Picture, Section

WORDS = Path(__file__).with_name("pages.toml")
"""Title, machine, method and caption of each page, and the table that it shows."""
Tables = Mapping[str, Sequence[Mapping[str, Any]]]
"""Rows of each table of a machine, by the name of its CSV."""
TABLES = {
    "alignment": ("Clock and place of the reference", "By IMU and reference alone."),
    "cases": ("Every change and fault", "What was put in, and what the trace says of it."),
    "counts": ("What was put in, and how often it is named", ""),
    "end_errors": ("Error at the end of each walk", "Leg filter, by model of the feet [% of way]."),
    "filters": ("Filters over the whole log", ""),
    "forces": (
        "Forces on the rear toes",
        "Delay of contacts after the load, friction of toes that scrape over the ground while they "
        "swing, and correlation of the slip of standing toes with the force on them (as of dry "
        "friction) and with its rate (as of a compliant leg).",
    ),
    "held_out": ("Held-out runs", "Root mean square of the residual, and what speaks against."),
    "least": ("Least changes", "The least change that is named in 95 of 100 runs like these."),
    "leg_filter": ("Leg filter by effects", ""),
    "lost_way": ("Way lost on each walk", "Way that the legs go and the body does not."),
    "plausibility": (
        "What is not plausible in the logs",
        "With the line of the map that mends it.",
    ),
    "radius": (
        "Radius of the feet",
        "Estimated from parts of the stance; on a round foot all would agree.",
    ),
    "residuals": ("Residuals", "Root mean square on rows that no fit has used."),
    "sizes": ("Effects found", "Sizes with 95 % intervals."),
    "stances": (
        "Way lost from stance to stance",
        "Within each walk, which the fit does not use.",
    ),
    "unchanged": ("Unchanged runs", "Root mean square of the residual torque."),
}
"""Heading and words of each table."""


def machine_report(name: str, row: Mapping[str, Any], figure: bytes) -> tuple[str, list[Section]]:
    """Title and sections of a machine's report and page: findings, machine, method, and all tables.

    Args:
        name: of the machine.
        row: tables and verdict.
        figure: PNG.
    """
    words, tables = read_toml(WORDS, "pages")[name], row["tables"]
    main, *rest = FINDINGS[name](tables, row["verdict"])
    columns = words["columns"] or None
    shown = [dict(list(line.items())[:columns]) for line in tables[words["shown"]]]
    further = [n for n in tables if tables[n] and (n != words["shown"] or columns)]
    return words["title"], [
        Section("Findings", f"{main}\n\n{' '.join(rest)}", shown),
        Section("The machine", words["machine"]),
        Section("What was done", words["method"], None, (Picture(figure, words["caption"]),)),
        *(Section(*TABLES[one], tables[one], file=one) for one in further),
    ]


def _verdict(verdict: str, where: str = "") -> str:
    name, _, meaning = verdict.partition(": ")
    return f"The verdict of `trace`{where} is `{name}`: {meaning}."


def _residual(rows: Sequence[Mapping[str, Any]], channel: str) -> str:
    """Before, after and noise floor of a channel."""
    row = next(row for row in rows if row["channel"].startswith(f"{channel} ["))
    unit = row["channel"].partition("[")[2].removesuffix("]")
    before, after = row["declared model"], row["with the effects found"]
    return f"from {before} to {after} {unit}; the noise floor is {row['noise floor']} {unit}"


def _of_pendulum(tables: Tables, verdict: str) -> list[str]:
    torque = [r for r in tables["held_out"] if r["channel"].startswith("joint_torque")]
    explained = [r for r in torque if float(r["declared model"]) <= float(r["noise floor"])]
    worst = max(torque, key=lambda r: float(r["declared model"]) / float(r["noise floor"]))
    lower = [r for r in torque if float(r["with the others' effects"]) < float(r["declared model"])]
    return [
        f"The rigid model explains the torque of {len(explained)} of {len(torque)} runs down to "
        "the noise.",
        f"The largest residual is that of `{worst['run held out']}`: {worst['declared model']} N m "
        f"at a noise floor of {worst['noise floor']} N m.",
        f"Effects found in the other runs lower the residual of {len(lower)} of {len(torque)} "
        "held-out runs.",
        _verdict(verdict, " on all runs together"),
    ]


def _of_drives(tables: Tables, verdict: str) -> list[str]:
    torque = _residual(tables["residuals"], "joint_torque")
    return [
        f"{len(tables['sizes'])} effects of the drives lower the residual torque {torque}.",
        _verdict(verdict),
        "Streams that are not plausible: "
        + "; ".join(f"{r['streams']} ({r['finding']})" for r in tables["plausibility"])
        + ".",
    ]


def _of_go1(tables: Tables, verdict: str) -> list[str]:
    rows = {r["model"]: r for r in tables["leg_filter"]}
    before, after = rows["as declared"], rows["all of them"]
    alone = [r for name, r in rows.items() if name.endswith(" alone")]
    best = min(alone, key=lambda r: r["APE_trans [m]"])
    moved = [r["APE_trans [m]"] for name, r in rows.items() if name.startswith("all of them, ")]
    return [
        "With the effects that `trace` finds, the leg filter's position error on the whole walk "
        f"falls from {before['APE_trans [m]']:.3f} to {after['APE_trans [m]']:.3f} m, and its NEES "
        f"of position from {before['NEES_pos']:.1f} to {after['NEES_pos']:.1f}.",
        f"Of single effects, {best['model'].removesuffix(' alone')} helps most "
        f"({best['APE_trans [m]']:.3f} m).",
        f"The residual of standing legs falls {_residual(tables['residuals'], 'leg_velocity')}.",
        _verdict(verdict),
        "With a reference that is moved by one standard deviation of its stamps, the error is "
        f"{min(moved):.3f} to {max(moved):.3f} m.",
    ]


def _of_scaler(tables: Tables, verdict: str) -> list[str]:
    rows = {r["feet"]: r for r in tables["end_errors"]}
    mean, worst = "mean of unseen walks [%]", "worst of unseen walks [%]"
    plain = rows["contacts by the gait"]
    with_effect = [row for name, row in rows.items() if name.startswith("and ")]
    way = [float(r["lost of the way [%]"]) for r in tables["lost_way"]]
    pairs = tables["stances"]
    slopes = [f"{r['lost for each radian [mm]']} mm/rad ({r['standing']})" for r in pairs]
    means, most = ([float(r[x]) for r in with_effect] for x in (mean, worst))
    return [
        f"The leg filter ends {plain[mean]} % of the way off; with the effect that `trace` finds "
        f"on the walks of one day, {min(means):.1f} to {max(means):.1f} % on those of the other "
        f"days, {max(most):.1f} % at worst.",
        f"The body goes {min(way):.1f} to {max(way):.1f} % less far than its legs.",
        f"With the contacts that the robot logged, the mean error is "
        f"{rows['contacts as logged'][mean]} %.",
        f"From stance to stance, the way lost grows by {' and '.join(slopes)}.",
    ]


def _of_icub(tables: Tables, verdict: str) -> list[str]:
    runs: dict[str, dict[str, float]] = {}
    for row in tables["filters"]:
        runs.setdefault(row["log"], {})[row["filter"]] = float(row["APE_trans [m]"])
    parts = {
        run: ", ".join(f"{error:.4f} m (`{name}`)" for name, error in own.items())
        for run, own in runs.items()
    }
    walk, *others = [f"{errors} on the log `{run}`" for run, errors in parts.items()]
    accel = _residual(tables["residuals"], "imu_accel")
    return [
        f"The position errors of the filters are {walk}.",
        *(f"They are {other}." for other in others),
        f"{_verdict(verdict)} The residual of the accelerometer falls {accel}.",
    ]


def _of_ricmonk(tables: Tables, verdict: str) -> list[str]:
    large, small, nothing, *faults = tables["counts"]
    cases = sum(r["cases"] for r in (nothing, *faults))
    wrong = sum(r["wrong"] for r in (nothing, *faults))
    silent = ", ".join(
        f"{r['right'] + r['nothing']} of {r['cases']} ({r['put in']})" for r in faults
    )
    return [
        f"`trace` names {large['right']} of {large['cases']} injected changes of a size that 95 of "
        f"100 runs should show, and {large['wrong']} of them wrongly.",
        f"Of smaller changes it names {small['right']} of {small['cases']}, {small['wrong']} "
        "wrongly.",
        f"A change of the machine is named in {wrong} of {cases} runs that have none: unchanged "
        "ones, and ones in which only a sensor is at fault.",
        f"Of sensor faults, the sensor or nothing is named in {silent}; in the others, that "
        "nothing can be identified.",
    ]


def _of_servos(tables: Tables, verdict: str) -> list[str]:
    rows = tables["residuals"]
    fitted, unseen = (
        _residual([r for r in rows if r["rows"].startswith(part)], "joint_rate")
        for part in ("fitted", "unseen")
    )
    found = "; ".join(f"{r['effect']}: {r['size']}" for r in tables["sizes"])
    return [
        f"The residual of the joint rates falls {fitted}.",
        f"On three runs that no fit has seen, it falls {unseen}.",
        f"Found: {found or 'nothing'}.",
        _verdict(verdict),
        f"Not plausible: {'; '.join(dict.fromkeys(r['streams'] for r in tables['plausibility']))}.",
    ]


FINDINGS: dict[str, Callable[[Tables, str], list[str]]] = {
    "ak80_pendulum": _of_pendulum,
    "go2_in_air": _of_drives,
    "go1_square": _of_go1,
    "scaler_trot": _of_scaler,
    "icub_biped": _of_icub,
    "ricmonk": _of_ricmonk,
    "so101": _of_servos,
}
"""Tables and verdict of a machine -> sentences, the main one first."""
