"""Close the loop: residual of measured logs -> the effect the model lacks -> before and after."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.models.attribution.angle_error import angle_errors
from surefoot.models.attribution.evidence import LogUnderModel, log_under_model
from surefoot.models.attribution.levels import ChannelLevel, channel_levels, without_bias
from surefoot.models.attribution.noise_floor import noise_floor
from surefoot.models.attribution.search import Attribution, attribute
from surefoot.models.attribution.unexplained import Unexplained, sparse_regression
from surefoot.scenarios.estimate.registry import Learnt
from surefoot.scenarios.trace.data import (
    REPORT_SHARE,
    cannot_tell,
    data_notes,
    dead_contacts,
    readings,
    split_of,
)
from surefoot.scenarios.trace.filters import BeforeAfter, before_and_after, mean_metrics
from surefoot.scenarios.trace.report import write_outputs
from surefoot.scenarios.trace.words import motion_to_tell_apart
from surefoot.sim.common.errors import SurefootError, check_seed
from surefoot.sim.effects import Effect, compensate_all
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import Machine

FAR = 3.0
"""Times the floor beyond which what is left of a channel makes every size doubtful."""
HARM = 1.05
"""Ratio of a filter's errors, after to before, from which what was found is said to do harm."""
OUTPUTS = ("trace.json", "effects.toml", "report.html", "trace.rrd")


@dataclass(frozen=True)
class Trace:
    """What a trace found; see `as_dict` for the form of trace.json."""

    verdict: str
    attribution: Attribution | None
    channels: dict[str, ChannelLevel]
    filters: dict[str, dict[str, dict[str, float]]]
    masked_share: float
    floor: str
    rivals: tuple[dict[str, Any], ...]
    motion: str
    notes: tuple[str, ...]
    stretches: tuple[BeforeAfter, ...]
    remainder: tuple[Unexplained, ...] = ()

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
        known, model = compensate_all(declared, readings(log), robot)
        cases.append(log_under_model(known, model))
    split = split_of(cases)
    cannot = cannot_tell(cases, split)
    if cannot:
        return Trace("not_identifiable", None, {}, {}, 0.0, "none", (), "", (cannot,), ())
    tell(0.02)
    floor = noise_floor(cases)
    tell(0.35)
    dead = dict.fromkeys(note for note in map(dead_contacts, logs) if note)
    notes = (*dead, *data_notes(cases, floor))
    rng = np.random.default_rng(seed)
    result = attribute(cases, floor, split, rng, lambda share: tell(0.35 + 0.5 * share))
    effects = [f.effect for f in result.found]
    channels = channel_levels(cases, result, split)
    bent = angle_errors(cases, result, split, rng)
    verdict, remainder = _verdict(result, channels, bool(bent)), ()
    if verdict == "none_of_these":
        above = [name for name, c in channels.items() if not c.at_floor or c.worse]
        above.sort(key=lambda name: -channels[name].after / channels[name].highest)
        used = split.fit | split.select
        left = without_bias(result.evidence, result.robust_weights, used)
        remainder = tuple(
            Unexplained(one.channel, one.joint, (f"curve_of_angle_{one.joint}",), one.share)
            for one in bent
        ) + sparse_regression(cases, left, result.robust_weights, above, split.fit, split.select)
    if "leg_velocity" in channels:
        notes += (
            "foot_slip: cannot be told; friction shows where feet slide, and that they did on "
            f"{100 * result.robust_weights.share:.1f} % of their stance, wherever it was slippery",
        )
    notes += tuple(f"{name}: worse with what was found" for name, c in channels.items() if c.worse)
    notes += tuple(
        f"{name}: what is left is {c.after / c.highest:.0f} times what the declared model leaves; "
        "sizes may be its doing"
        for name, c in channels.items()
        if result.found and c.after > FAR * c.highest
    )
    tell(0.88)
    stretches = _filtered(cases, effects, learnt)
    filters = {}
    for name in dict.fromkeys(s.filter for s in stretches):
        pairs = [s.metrics for s in stretches if s.filter == name]
        before, after = (mean_metrics([pair[i] for pair in pairs]) for i in (0, 1))
        filters[name] = {"before": before, "after": after}
    notes += tuple(
        f"{name} filter: farther off with what was found"
        for name, m in filters.items()
        if m["after"]["ape_trans"] > HARM * m["before"]["ape_trans"]
    )
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
        masked_share=result.robust_weights.share,
        floor=result.floor.source,
        rivals=rivals,
        motion=motion_to_tell_apart([r["name"] for r in rivals]) if rivals else "",
        notes=notes,
        stretches=stretches,
        remainder=remainder,
    )


def _filtered(
    cases: Sequence[LogUnderModel], effects: Sequence[Effect], learnt: Learnt
) -> tuple[BeforeAfter, ...]:
    done: list[BeforeAfter] = []
    for case in cases:
        if case.fixed or not isinstance(case.robot, Robot) or not case.log.has("imu"):
            continue
        t = case.log.t
        begin = t[0] + (1 - REPORT_SHARE) * (t[-1] - t[0])
        done += before_and_after(case.log, case.robot, effects, learnt, begin, t[-1])
    return tuple(done)


def _verdict(result: Attribution, channels: dict[str, ChannelLevel], bent: bool) -> str:
    at_floor = not bent and all(c.at_floor and not c.worse for c in channels.values())
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
