"""What a trace says of changes and of sensor faults that are put into runs of one machine.

Each run is taken as new once: the others are traced together, and the new one is compared with
them, with the effects that they show declared.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from studies.hardware.traces import traced
from surefoot import Log, Trace, TraceOptions, import_log
from surefoot.extend import STICTION_RATE, Effect, LinkChange, Modelled, known_effects
from surefoot.scenarios.reporting import finished_case

ChangeKey = tuple[str, str]
"""Name and target of an effect."""
KINDS = ("link_mass", "link_com", "coulomb_friction", "encoder_offset")
"""Kinds of the changes that are drawn."""
DRAWN_RATIOS = (0.5, 5.0)
"""Range of a drawn size, relative to the least that is named in 95 of 100 runs like the one that it
is put into.
"""
FARTHEST_COM = 0.3
"""Largest plausible offset of a centre of mass [m]: the links are 0.3 m long."""
FAULTS = ("attitude off", "attitude drifts", "gyro scaled", "encoder held")
ATTITUDE_OFF = np.radians([2.0, 6.0])
"""Range of an attitude's error, and of its drift by the end of a swing [rad]."""
GYRO_SCALE = 0.05
SHARE_HELD = 1.0 / 3.0
"""Share of a swing during which an encoder is held."""
_SMOOTH = 0.010
"""Width of the kernel that smooths positions before differentiation [s]."""


@dataclass(frozen=True)
class Runs:
    """Runs of one machine.

    Attributes:
        files: CSV of each swing, by run.
        rules: the map by which they are imported.
        machine: as published.
        out: folder of the traces.
        kept: folder of the finished rows.
        inputs: digests of the recordings.
    """

    files: Mapping[str, Sequence[Path]]
    rules: str
    machine: Modelled
    out: Path
    kept: Path
    inputs: Mapping[str, str]

    def logs(self, run: str) -> list[Log]:
        """The swings of a run, as recorded."""
        return [import_log(file, self.rules) for file in self.files[run]]


@dataclass(frozen=True)
class ChangeCase:
    """What is put into a run: nothing, a change with a key, or a sensor's fault.

    Attributes:
        run: that is new.
        change: effect and target; None for none.
        fault: one of FAULTS, "" for none.
        size: of the change or the fault.
        seed: of the fault's draws.
        least: of the change, the least that is named in 95 of 100 runs like this one.
    """

    run: str
    change: ChangeKey | None = None
    fault: str = ""
    size: float = 0.0
    seed: int = 0
    least: float = 1.0

    @property
    def ratio(self) -> float:
        """Size of the change relative to the least that is named."""
        return abs(self.size) / self.least


Tried = tuple[ChangeCase, dict[str, Any]]
"""A case, and its row: verdict, reasons, effects, rivals and channels as of trace.json."""


def link_of(key: Sequence[str]) -> str:
    """The joint that an effect concerns, or that moves the link that it concerns."""
    name, target = key
    return target.rsplit("_", 1)[0] if name == "link_com" else target


def tried_cases(runs: Runs, each: int = 5, faults: int = 10) -> list[Tried]:
    """What the trace says of each unchanged run, of drawn changes and of drawn faults.

    each: changes of each kind on each link. faults: faults of each kind.
    """
    before = _traces_without(runs)
    whole = [_tried(f"unchanged_{run}", ChangeCase(run), runs, before) for run in runs.files]
    rng = np.random.default_rng(0)
    changes = drawn_changes(whole, runs.machine.joint_names, each, rng)
    drawn = {
        **{f"change_{k:02d}": case for k, case in enumerate(changes)},
        **{f"fault_{k:02d}": case for k, case in enumerate(drawn_faults(runs.files, faults, rng))},
    }
    return [*whole, *(_tried(name, case, runs, before) for name, case in drawn.items())]


def _traces_without(runs: Runs) -> Callable[[str], Trace]:
    """The trace of all runs but one, made when it is first asked for."""

    @cache
    def without(run: str) -> Trace:
        others = [log for other in runs.files if other != run for log in runs.logs(other)]
        return traced(others, runs.machine, runs.out / f"without_{run}")

    return without


def _tried(name: str, case: ChangeCase, runs: Runs, before: Callable[[str], Trace]) -> Tried:
    def said() -> dict[str, Any]:
        known = before(case.run)
        options = TraceOptions(declared=known.effects, since=known.model_error)
        found = traced(_logs_of(case, runs), runs.machine, runs.out / "since", options).as_dict()
        kept = {k: found.get(k, []) for k in ("verdict", "reasons", "effects", "rivals")}
        if case.change is None and not case.fault:
            kept |= {"least": found.get("least", []), "channels": found["channels"]}
        return kept

    given = {**runs.inputs, **asdict(case)}
    return case, finished_case(runs.kept, name, given, __name__, said)


def _logs_of(case: ChangeCase, runs: Runs) -> list[Log]:
    """The swings of a case's run; a fault is put into their files before they are imported."""
    if case.change is not None:
        logs = runs.logs(case.run)
        return [with_change(log, runs.machine, case.change, case.size) for log in logs]
    if not case.fault:
        return runs.logs(case.run)
    rng, logs = np.random.default_rng(case.seed), []
    with TemporaryDirectory() as folder:
        for file in runs.files[case.run]:
            path = Path(folder) / file.name
            with_fault(pd.read_csv(file), case, rng).to_csv(path, index=False)
            logs.append(import_log(path, runs.rules))
    return logs


def drawn_changes(
    unchanged: Sequence[Tried], links: Sequence[str], each: int, rng: np.random.Generator
) -> list[ChangeCase]:
    """Draw changes of every kind on every link.

    Sizes are log-uniform within DRAWN_RATIOS of the least that is named. Offsets of a centre of
    mass beyond FARTHEST_COM are left out. Masses and friction only increase.

    Args:
        unchanged: the unchanged runs, whose rows have the least changes.
        links: joints that move them.
        each: number of changes of each kind on each link.
        rng: draws runs, axes, sizes and signs.
    """
    least = {
        case.run: {(one["name"], one["target"]): one["value"] for one in row["least"]}
        for case, row in unchanged
    }
    names, drawn = list(least), []
    for kind in KINDS:
        for link in links:
            for _ in range(each):
                run = names[int(rng.integers(len(names)))]
                keys = [k for k in sorted(least[run]) if k[0] == kind and link_of(k) == link]
                key = keys[rng.integers(len(keys))]
                low, high = np.log(DRAWN_RATIOS)
                size = least[run][key] * float(np.exp(rng.uniform(low, high)))
                sign = rng.choice([-1.0, 1.0]) if kind in ("link_com", "encoder_offset") else 1.0
                if kind != "link_com" or size <= FARTHEST_COM:
                    drawn.append(ChangeCase(run, key, size=sign * size, least=least[run][key]))
    return drawn


def drawn_faults(runs: Mapping[str, Any], each: int, rng: np.random.Generator) -> list[ChangeCase]:
    """Draw sensor faults: `each` of every kind, in runs drawn by `rng`."""
    names, drawn = list(runs), []
    for fault in FAULTS:
        for _ in range(each):
            run, sign = names[int(rng.integers(len(names)))], rng.choice([-1.0, 1.0])
            size = GYRO_SCALE if fault == "gyro scaled" else rng.uniform(*ATTITUDE_OFF)
            seed = int(rng.integers(2**31))
            drawn.append(ChangeCase(run, None, fault, float(sign * size), seed))
    return drawn


def with_change(log: Log, machine: Modelled, key: ChangeKey, size: float) -> Log:
    """Inject a change into a log of the machine, keeping its noise and jolts.

    A zero is added to the angle. For any other change, the torque that it requires along the motion
    is added, also to a passive joint's.

    Args:
        log: as read.
        machine: as declared.
        key: effect and target.
        size: of the effect.
    """
    name, target = key
    j = log.joints.index(link_of(key))
    if name == "encoder_offset":
        return log.with_columns({f"q_{target}": log.q[:, j] + size})
    # Rates computed differently from those of the balance.
    step = float(np.median(np.diff(log.t)))
    t = np.arange(log.t[0], log.t[-1] + step, step)
    q = gaussian_filter1d(CubicSpline(log.t, log.q)(t), _SMOOTH / step, axis=0, mode="nearest")
    smooth = CubicSpline(t, q)
    q, dq, ddq = (smooth(log.t, order) for order in range(3))
    if name == "coulomb_friction":
        added = size * np.tanh(dq / STICTION_RATE) * (np.arange(len(log.joints)) == j)
    else:
        change = LinkChange(j, mass=size)
        if name == "link_com":
            axis = "xyz".index(target[-1])
            change = LinkChange(j, com=tuple(size * np.eye(3)[axis]))
        links = (*machine.extras.links, change)
        changed = replace(machine, extras=replace(machine.extras, links=links))
        added, before = (one.dynamics.inverse(q, dq, ddq)[1] for one in (changed, machine))
        added -= before
    read = enumerate(log.joints)
    return log.with_columns({f"tau_{name}": log.tau[:, k] + added[:, k] for k, name in read})


def with_fault(rows: pd.DataFrame, case: ChangeCase, rng: np.random.Generator) -> pd.DataFrame:
    """The rows of a swing's CSV with a fault of one of its sensors.

    The hook's angle is that of the body's attitude less the tail's, and its rate that of the gyro
    less the tail's; the attitude is the integrated gyro. rng: draws which encoder is held, and
    when.
    """
    rows, size, t = rows.copy(), case.size, rows["t"] - rows["t"].iloc[0]
    if case.fault == "attitude off":
        rows["q_hook"] += size
    elif case.fault == "attitude drifts":
        rows["q_hook"] += size * t / t.iloc[-1]
    elif case.fault == "gyro scaled":
        attitude = rows["q_hook"] + rows["q_tail"]
        rows["q_hook"] += size * (attitude - attitude.iloc[0])
        rows["dq_hook"] += size * (rows["dq_hook"] + rows["dq_tail"])
    else:
        joint = rng.choice(["tail", "phi"])
        first = int(rng.uniform(0.2, 0.8 - SHARE_HELD) * len(rows))
        held = slice(first, first + int(SHARE_HELD * len(rows)))
        rows.loc[rows.index[held], f"q_{joint}"] = rows[f"q_{joint}"].iloc[first]
    return rows


def outcome_of(case: ChangeCase, row: Mapping[str, Any]) -> str:
    """Outcome of a case: right, not alone (another part is also possible), nothing, not
    identifiable, or wrong.

    A change of the machine is right on its link, and a zero as an error of the joint's angle. Where
    nothing changed but a sensor is at fault, only an error of a sensor is right.
    """
    named = [(one["name"], one["target"]) for one in row["effects"]]
    of_body = [key for key in named if not _of_sensor(key[0])]
    if row["verdict"] == "unchanged":
        return "nothing"
    if case.change is None:
        if not named:
            return "not identifiable"
        return "right" if case.fault and not of_body else "wrong"
    kind, link = case.change[0], link_of(case.change)
    if kind == "encoder_offset" and of_body:
        return "wrong"
    if not named:
        sensor = bool(row["reasons"]) and f"q_{link} " in row["reasons"][0] + " "
        return "right" if kind == "encoder_offset" and sensor else "not identifiable"
    rivals = [(one["name"], one["target"]) for one in row["rivals"]]
    if link not in {link_of(key) for key in [*named, *rivals]}:
        return "wrong"
    return "not alone" if rivals else "right"


def _of_sensor(name: str) -> bool:
    """Whether an effect is an error of a sensor, and not of the machine's body."""
    return known_effects()[name].edit_spec is Effect.edit_spec


def counts_table(tried: Sequence[Tried]) -> pd.DataFrame:
    """Number of cases with each outcome: by size of the change, and by kind of fault."""
    ends = ("right", "not alone", "nothing", "not identifiable", "wrong")

    def part(words: str, own: Callable[[ChangeCase], object]) -> dict[str, Any]:
        found = [outcome_of(case, row) for case, row in tried if own(case)]
        return {"put in": words, "cases": len(found)} | {end: found.count(end) for end in ends}

    return pd.DataFrame([
        part("a change, at least the least named", lambda one: one.change and one.ratio >= 1.0),
        part("a smaller change", lambda one: one.change and one.ratio < 1.0),
        part("nothing", lambda one: not (one.change or one.fault)),
        *(part(fault, lambda one, fault=fault: one.fault == fault) for fault in FAULTS),
    ])  # fmt: skip


def unchanged_table(tried: Sequence[Tried]) -> pd.DataFrame:
    """One row for each unchanged run: its residual torque, and what the trace says of it."""
    rows = []
    for case, row in tried:
        if not (case.change or case.fault):
            level = row["channels"]["joint_torque"]
            rows.append(
                {
                    "run": case.run,
                    "verdict": row["verdict"].replace("_", " "),
                    "others' effects declared [N m]": f"{level['before']:.3f}",
                    "and errors as theirs, own zeros [N m]": f"{level['after']:.3f}",
                    "noise [N m]": f"{level['noise_floor']:.3f}",
                }
            )
    return pd.DataFrame(rows)


def least_table(tried: Sequence[Tried]) -> pd.DataFrame:
    """One row for each change that is drawn: the least that is named in 95 of 100 runs, by run."""
    rows: dict[ChangeKey, dict[str, str]] = {}
    for case, row in tried:
        for one in row.get("least", ()):
            key = one["name"], one["target"]
            first = {"change": _words(key), "unit": known_effects()[key[0]].unit}
            if key[0] in KINDS:
                rows.setdefault(key, first)[case.run] = f"{one['value']:.3f}"
    return pd.DataFrame([rows[key] for key in sorted(rows)])


def cases_table(tried: Sequence[Tried]) -> pd.DataFrame:
    """One row for each change and fault: what was put in, and what the trace said."""
    return pd.DataFrame(
        {
            "run": case.run,
            "put in": case.fault or _sized(case.change or ("", ""), case.size),
            "of the least named": f"{case.ratio:.2f}" if case.change else "",
            "verdict": row["verdict"].replace("_", " "),
            "named": "; ".join(_sized((e["name"], e["target"]), e["value"]) for e in row["effects"])
            or "; ".join(row["reasons"][:1]),
            "outcome": outcome_of(case, row),
        }
        for case, row in tried
        if case.change or case.fault
    )


def _words(key: Sequence[str]) -> str:
    return " ".join(key).replace("_", " ")


def _sized(key: Sequence[str], size: float) -> str:
    return f"{_words(key)} {size:+.3f} {known_effects()[key[0]].unit}"
