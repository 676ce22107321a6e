"""Close the loop: residual of measured logs -> the effect the model lacks -> before and after."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.attribution import Attribution, Split, attribute
from models.candidates import Case, all_keys, case_of, channels_of
from models.floor import Floor, floor_of
from models.levels import Channel, channel_levels, without_bias
from models.remainder import Remainder, form
from scenarios.filters import Learnt
from scenarios.trace_filters import BeforeAfter, before_and_after, mean_metrics
from scenarios.trace_report import write_outputs
from scenarios.trace_words import motion_to_tell_apart
from sim.effects import Effect, explain_all
from sim.errors import SurefootError, check_seed
from sim.fixed_base import Machine
from sim.log import Log
from sim.robot import Robot

REPORT_SHARE = 0.35
"""Of each log, at its end, that no fit and no choice sees."""
BLOCK, GAP = 4.0, 0.2
"""s: blocks that fit and blocks that select take turns, with gaps between them."""
SHORTEST = 12.0
"""s of a log below which there is too little to split."""
SHORTEST_FIXED = 3.5
"""s, of a machine on a fixed base, every row of which tells something."""
NEEDS = {
    "imu_gyro": ("imu", "reference"),
    "imu_accel": ("imu", "reference"),
    "leg_velocity": ("q", "contact", "reference"),
    "foot_height": ("q", "contact", "reference"),
    "joint_torque": ("q", "tau"),
    "base_wrench": ("q", "tau", "contact", "reference"),
    "joint_rate": ("q", "dq"),
}
"""Groups of columns that each channel takes."""
OUTPUTS = ("trace.json", "effects.toml", "report.html", "trace.rrd")


@dataclass(frozen=True)
class Trace:
    """What a trace found; see `as_dict` for the form of trace.json."""

    verdict: str
    attribution: Attribution | None
    channels: dict[str, Channel]
    filters: dict[str, dict[str, dict[str, float]]]
    masked_share: float
    floor: str
    rivals: tuple[dict[str, Any], ...]
    motion: str
    notes: tuple[str, ...]
    stretches: tuple[BeforeAfter, ...]
    remainder: tuple[Remainder, ...] = ()

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects found, strongest first."""
        return tuple(f.effect for f in self.attribution.found) if self.attribution else ()

    def as_dict(self) -> dict[str, Any]:
        """trace.json: nothing in it depends on what a log is called or what it says of itself."""
        found = self.attribution.found if self.attribution else ()
        rounds = self.attribution.rounds if self.attribution else ()
        out: dict[str, Any] = {
            "verdict": self.verdict,
            "effects": [{**f.effect.as_dict(), "interval": list(f.interval)} for f in found],
            "channels": {
                name: {
                    "before": c.before, "after": c.after, "noise_floor": c.noise_floor,
                    "unit": c.unit,
                }
                for name, c in self.channels.items()
            },
            "filters": self.filters,
            "masked_share": self.masked_share,
            "floor": self.floor,
            "notes": list(self.notes),
            "candidates": [
                [
                    {
                        "name": c.key[0], "target": c.key[1], "value": c.size,
                        "floor": c.floor, "gain": c.share, "earned": c.earned,
                    }
                    for c in one
                ]
                for one in rounds
            ],
        }  # fmt: skip
        if self.verdict == "none_of_these":
            out["remainder"] = [asdict(r) for r in self.remainder]
        if self.rivals:
            out |= {"rivals": list(self.rivals), "motion": self.motion}
        return _plain(out)


def trace(
    logs: Sequence[Log],
    robot: Machine,
    out: Path | str,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    force: bool = False,
    declared: Sequence[Effect] = (),
    learnt: Learnt | None = None,
) -> Trace:
    """Find which effect `robot` lacks as a model of the logs, and what adding it changes.

    Of the logs only time, IMU, joints, feet and reference are read, and the rate. `declared`
    effects belong to the model: they are explained before anything is asked. The folder `out` gets
    trace.json, effects.toml, report.html and trace.rrd. `progress` is told the share that is done.
    Raises SurefootError where `out` has such files (no `force`), and LogError where a log
    has no reference.
    """
    out = Path(out)
    if not logs:
        raise SurefootError("trace: needs at least one log")
    if not force:
        for name in OUTPUTS:
            if (out / name).exists():
                raise SurefootError(f"{out / name}: exists already; give --force to overwrite it")
    found = diagnose(logs, robot, seed, progress, declared, learnt)
    write_outputs(found, robot, out, force)
    return found


def diagnose(
    logs: Sequence[Log],
    robot: Machine,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    declared: Sequence[Effect] = (),
    learnt: Learnt | None = None,
) -> Trace:
    """`trace` without the files."""
    check_seed(seed)
    learnt = learnt or Learnt()
    tell = progress or (lambda share: None)
    cases = []
    for log in logs:
        known, model = explain_all(declared, _readings(log), robot)
        cases.append(case_of(known, model))
    cannot = _cannot_tell(cases)
    if cannot:
        return Trace("not_identifiable", None, {}, {}, 0.0, "none", (), "", (cannot,), ())
    tell(0.02)
    floor = floor_of(cases)
    tell(0.35)
    split, notes = split_of(cases), _said(cases, floor)
    rng = np.random.default_rng(seed)
    result = attribute(cases, floor, split, rng, lambda share: tell(0.35 + 0.5 * share))
    effects = [f.effect for f in result.found]
    channels = channel_levels(cases, result, split)
    verdict, remainder = _verdict(result, channels), ()
    if verdict == "none_of_these":
        above = [name for name, c in channels.items() if not c.at_floor or c.worse]
        above.sort(key=lambda name: -channels[name].after / channels[name].highest)
        used = split.fit | split.select
        left = without_bias(result.evidence, result.trust, used)
        remainder = form(cases, left, result.trust, above, split.fit, split.select)
    notes += tuple(f"{name}: worse with what was found" for name, c in channels.items() if c.worse)
    tell(0.88)
    stretches = _filtered(cases, effects, learnt)
    filters = {}
    for name in dict.fromkeys(s.filter for s in stretches):
        pairs = [s.metrics for s in stretches if s.filter == name]
        before, after = (mean_metrics([pair[i] for pair in pairs]) for i in (0, 1))
        filters[name] = {"before": before, "after": after}
    rivals = tuple(
        {"name": name, "target": target, "overlap": shared}
        for (name, target), shared in result.rivals
    )
    tell(1.0)
    return Trace(
        verdict=verdict,
        attribution=result,
        channels=channels,
        filters=filters,
        masked_share=result.trust.share,
        floor=result.floor.source,
        rivals=rivals,
        motion=motion_to_tell_apart([r["name"] for r in rivals]) if rivals else "",
        notes=notes,
        stretches=stretches,
        remainder=remainder,
    )


def split_of(cases: Sequence[Case]) -> Split:
    """Each log's end reports; before it, blocks that fit and blocks that select take turns."""
    parts = []
    for case in cases:
        t = case.frame.t - case.frame.t[0]
        begin = (1 - REPORT_SHARE) * t[-1]
        block = np.floor(t / BLOCK).astype(int)
        used = (t < begin - GAP) & (t - BLOCK * block >= GAP)
        parts.append((used & (block % 2 == 0), used & (block % 2 == 1), t >= begin))
    return Split(*(np.concatenate(masks) for masks in zip(*parts, strict=True)))


def _readings(log: Log) -> Log:
    """The log without anything that a measured one could not have."""
    known = ("t", "gyro_", "accel_", "q_", "dq_", "tau_", "contact_", "force_", "ref_")
    names = [n for n in log.frame if str(n) == "t" or str(n).startswith(known[1:])]
    return Log(log.frame.filter(items=names), log.meta, log.name)


def _cannot_tell(cases: Sequence[Case]) -> str:
    if not any(all_keys(case) for case in cases):
        return (
            "no channel: needs gyro and accel, or q and contact, beside the reference; or q and "
            "tau of a fixed base"
        )
    longest = max(case.frame.t[-1] - case.frame.t[0] for case in cases)
    shortest = SHORTEST_FIXED if cases[0].fixed else SHORTEST
    if longest < shortest:
        return f"too short: {longest:.1f} s where {shortest:.0f} s are needed to fit and to check"
    return ""


def _said(cases: Sequence[Case], floor: Floor) -> tuple[str, ...]:
    """What the reader should know of the data before the result."""
    notes = []
    there = set.intersection(*(set(channels_of(case)) for case in cases))
    for channel, needed in NEEDS.items():
        lacking = [g for g in needed if not all(case.log.has(g) for case in cases)]
        if channel in there:
            continue
        if lacking:
            notes.append(f"{channel}: not used, the log lacks {' and '.join(lacking)}")
        elif channel == "foot_height":
            notes.append("foot_height: not used, the ground is not level")
    if cases[0].fixed:
        notes.append("without a reference the base is taken to be held still and level")
    elif not all(case.log.has("ref_v") for case in cases):
        notes.append("the reference's velocity is derived from its positions, which smooths it")
    if not floor.repeats and not cases[0].fixed:
        notes.append("the model does not walk in simulation: the floor is sensor noise alone")
    if any(isinstance(c.robot, Robot) and np.any(c.robot.foot_radius == 0) for c in cases):
        notes.append("the model's feet are points; the floor is from walks with the file's feet")
    return tuple(notes)


def _filtered(
    cases: Sequence[Case], effects: Sequence[Effect], learnt: Learnt
) -> tuple[BeforeAfter, ...]:
    done: list[BeforeAfter] = []
    for case in cases:
        if case.fixed or not isinstance(case.robot, Robot) or not case.log.has("imu"):
            continue
        t = case.log.t
        begin = t[0] + (1 - REPORT_SHARE) * (t[-1] - t[0])
        done += before_and_after(case.log, case.robot, effects, learnt, begin, t[-1])
    return tuple(done)


def _verdict(result: Attribution, channels: dict[str, Channel]) -> str:
    at_floor = all(c.at_floor and not c.worse for c in channels.values())
    if not result.found:
        return "no_residual" if at_floor else "none_of_these"
    if not at_floor:
        return "none_of_these"
    return "confounded" if result.rivals else "attributed"


def _plain(value: Any) -> Any:
    """JSON has no NaN and no numpy."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.generic):
        return value.item()
    return value
