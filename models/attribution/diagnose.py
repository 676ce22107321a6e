"""Which effect does the model of a robot lack? From logs to the verdict."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from surefoot.models.attribution.angle_error import angle_errors
from surefoot.models.attribution.data import cannot_tell, data_notes, dead_contacts, readings
from surefoot.models.attribution.evidence import LogUnderModel, log_under_model
from surefoot.models.attribution.levels import ChannelLevel, channel_levels, without_bias
from surefoot.models.attribution.noise_floor import noise_floor
from surefoot.models.attribution.search import Attribution, attribute
from surefoot.models.attribution.selection import Candidate
from surefoot.models.attribution.settings import DEFAULT, TraceSettings
from surefoot.models.attribution.split import split_of
from surefoot.models.attribution.unexplained import Unexplained, sparse_regression
from surefoot.sim.common.errors import check_seed
from surefoot.sim.effects import Effect, compensate_all
from surefoot.sim.log import Log
from surefoot.sim.robot.fixed_base import Machine


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """What logs show of their model.

    verdict: attributed, confounded, none_of_these, not_identifiable or no_residual; attribution:
    the search, None where there was none; channels: levels by channel on data that no fit has seen;
    rivals: other explanations of an effect; unexplained: the form of what is left; floor: where the
    noise floor is from; masked_share: of the stance, masked as slipping; notes: for the reader.
    """

    verdict: str
    attribution: Attribution | None = None
    channels: dict[str, ChannelLevel]
    masked_share: float = 0.0
    floor: str = "none"
    rivals: tuple[dict[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    unexplained: tuple[Unexplained, ...] = ()

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects found, strongest first."""
        return tuple(f.effect for f in self.attribution.found) if self.attribution else ()

    def as_dict(self) -> dict[str, Any]:
        """For JSON: nothing in it depends on what a log is called or what its metadata are."""
        found = self.attribution.found if self.attribution else ()
        rounds = self.attribution.rounds if self.attribution else ()
        levels = ("before", "after", "noise_floor", "unit")
        out: dict[str, Any] = {
            "verdict": self.verdict,
            "effects": [{**f.effect.as_dict(), "interval": list(f.interval)} for f in found],
            "channels": {
                name: {level: getattr(c, level) for level in levels}
                for name, c in self.channels.items()
            },
            "masked_share": self.masked_share,
            "floor": self.floor,
            "notes": list(self.notes),
            "candidates": [[_candidate(c) for c in candidates] for candidates in rounds],
        }
        if self.verdict == "none_of_these":
            out["remainder"] = [asdict(form) for form in self.unexplained]
        if self.rivals:
            out["rivals"] = list(self.rivals)
        return plain(out)


def diagnose(
    logs: Sequence[Log],
    robot: Machine,
    seed: int = 0,
    progress: Callable[[float], None] = lambda share: None,
    declared: Sequence[Effect] = (),
    settings: TraceSettings = DEFAULT,
) -> Diagnosis:
    """Find which effect `robot` lacks as a model of the logs.

    Args:
        logs: of one machine; time, IMU, joints, feet, reference and rate are read, nothing else.
        robot: the declared model.
        seed: of the bootstrap.
        progress: called with the share that is done.
        declared: effects that belong to the model: compensated before anything is asked.
        settings: thresholds and constants.

    Raises LogError where a log lacks a reference that it needs.
    """
    check_seed(seed)
    cases = cases_of(logs, robot, declared, settings)
    split = split_of(cases)
    cannot = cannot_tell(cases, split)
    if cannot:
        return Diagnosis(verdict="not_identifiable", channels={}, notes=(cannot,))
    progress(0.02)
    floor = noise_floor(cases)
    progress(0.4)
    rng = np.random.default_rng(seed)
    result = attribute(cases, floor, split, rng, lambda share: progress(0.4 + 0.55 * share))
    channels = channel_levels(cases, result, split)
    curves = angle_errors(cases, result, split, rng)
    verdict, unexplained = _verdict(result, channels, bool(curves)), ()
    if verdict == "none_of_these":
        above = [name for name, c in channels.items() if not c.at_floor or c.worse]
        above.sort(key=lambda name: -channels[name].after / channels[name].highest)
        left = without_bias(result.evidence, result.robust_weights, split.fit | split.select)
        unexplained = tuple(
            Unexplained(one.channel, one.joint, (f"curve_of_angle_{one.joint}",), one.share)
            for one in curves
        ) + sparse_regression(cases, left, result.robust_weights, above, split.fit, split.select)
    dead = dict.fromkeys(note for log in logs if (note := dead_contacts(log, settings)))
    progress(1.0)
    return Diagnosis(
        verdict=verdict,
        attribution=result,
        channels=channels,
        masked_share=result.robust_weights.share,
        floor=result.floor.source,
        rivals=tuple(
            {"name": name, "target": target, "overlap": shared}
            for (name, target), shared in result.rivals
        ),
        notes=(*dead, *data_notes(cases, floor), *_result_notes(result, channels)),
        unexplained=unexplained,
    )


def cases_of(
    logs: Sequence[Log],
    robot: Machine,
    declared: Sequence[Effect],
    settings: TraceSettings = DEFAULT,
) -> list[LogUnderModel]:
    """The logs' readings under the model with its declared effects."""
    return [
        log_under_model(*compensate_all(declared, readings(log, settings), robot), settings)
        for log in logs
    ]


def _verdict(result: Attribution, channels: dict[str, ChannelLevel], curves: bool) -> str:
    at_floor = not curves and all(c.at_floor and not c.worse for c in channels.values())
    if not result.found:
        return "no_residual" if at_floor else "none_of_these"
    if not at_floor:
        return "none_of_these"
    return "confounded" if result.rivals else "attributed"


def _result_notes(result: Attribution, channels: dict[str, ChannelLevel]) -> list[str]:
    notes = []
    if "leg_velocity" in channels:
        notes.append(
            "foot_slip: not identifiable; friction shows where feet slide, and that they did on "
            f"{100 * result.robust_weights.share:.1f} % of their stance, wherever it was slippery"
        )
    notes += [f"{name}: worse with what was found" for name, c in channels.items() if c.worse]
    notes += [
        f"{name}: what is left is {c.after / c.highest:.0f} times what the declared model leaves; "
        "sizes may be its doing"
        for name, c in channels.items()
        if result.found and c.after > c.settings.far * c.highest
    ]
    return notes


def _candidate(c: Candidate) -> dict[str, Any]:
    name, target = c.key
    return {
        "name": name,
        "target": target,
        "value": c.size,
        "floor": c.floor,
        "gain": c.share,
        "earned": c.earned,
    }


def plain(value: Any) -> Any:
    """The same for JSON, which has neither NaN nor numpy."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.generic):
        return value.item()
    return value
