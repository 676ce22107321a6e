"""Result of a trace: a diagnosis, and its influence on the filters."""

from dataclasses import dataclass, field
from typing import Any

from surefoot.models.attribution.diagnose import Diagnosis, plain
from surefoot.scenarios.trace.filters import BeforeAfter

Filters = dict[str, dict[str, dict[str, float]]]
"""Filter -> "before" or "after" -> metric -> value."""

_OF_SLIDES = {
    "encoder_offset": "m",
    "backlash": "m",
    "torque_bias": "N",
    "coulomb_friction": "N",
    "viscous_friction": "N s/m",
    "armature": "kg",
    "leg_compliance": "m/N",
}
"""Units of effects on a joint that slides, whose angle is a distance and whose torque a force."""


@dataclass(frozen=True, kw_only=True)
class Trace(Diagnosis):
    """A diagnosis, and the influence of its effects on the filters on the last part of each log.

    Attributes:
        filters: metrics averaged over logs.
        stretches: each log's estimates, over which they are averaged.
        unseen_filters: the same over whole held-out logs.
        worse: channels and filters that got worse.
        motion: what to record to distinguish rival explanations.
        slides: names of prismatic joints.
    """

    filters: Filters
    stretches: tuple[BeforeAfter, ...] = ()
    unseen_filters: Filters = field(default_factory=dict)
    worse: tuple[str, ...] = ()
    motion: str = ""
    slides: tuple[str, ...] = ()

    def unit_of(self, name: str, target: str, unit: str) -> str:
        """Unit of an effect on this machine: m and N for joints that slide, else `unit`."""
        return _OF_SLIDES.get(name, unit) if target in self.slides else unit

    def as_dict(self) -> dict[str, Any]:
        """The content of trace.json."""
        out = super().as_dict() | plain({"filters": self.filters, "worse": self.worse})
        runs = (*out["runs"], *out.get("holdout", {"runs": ()})["runs"])
        for one in (*out["effects"], *(zero for run in runs for zero in run)):
            one["unit"] = self.unit_of(one["name"], one["target"], one["unit"])
        if self.held_out:
            out["holdout"]["filters"] = plain(self.unseen_filters)
        return out | {"motion": self.motion} if self.rivals else out
