"""Result of a trace: a diagnosis, and its influence on the filters."""

from dataclasses import dataclass, field
from typing import Any

from surefoot.models.attribution.diagnose import Diagnosis, plain
from surefoot.scenarios.trace.filters import BeforeAfter
from surefoot.sim.effects import known_effects
from surefoot.sim.robot.limbs import Limbs

Filters = dict[str, dict[str, dict[str, float]]]
"""Filter -> "before" or "after" -> metric -> value."""


@dataclass(frozen=True, kw_only=True)
class Trace(Diagnosis):
    """A diagnosis, and the influence of its effects on the filters on the last part of each log.

    Attributes:
        filters: metrics averaged over logs.
        stretches: each log's estimates, over which they are averaged.
        unseen_filters: the same over whole held-out logs.
        worse: channels and filters that got worse.
        motion: what to record to distinguish rival explanations.
        limbs: of the machine.
    """

    filters: Filters
    stretches: tuple[BeforeAfter, ...] = ()
    unseen_filters: Filters = field(default_factory=dict)
    worse: tuple[str, ...] = ()
    motion: str = ""
    limbs: Limbs = field(default_factory=lambda: Limbs((), (), ()))

    def unit_of(self, name: str, target: str) -> str:
        """Unit of an effect on this machine (`Effect.unit_on`)."""
        return known_effects()[name].unit_on(target, self.limbs)

    def as_dict(self) -> dict[str, Any]:
        """The content of trace.json."""
        out = super().as_dict() | plain({"filters": self.filters, "worse": self.worse})
        runs = (*out["runs"], *out.get("holdout", {"runs": ()})["runs"])
        for one in (
            *out["effects"],
            *out.get("least", ()),
            *(zero for run in runs for zero in run),
        ):
            one["unit"] = self.unit_of(one["name"], one["target"])
        if self.held_out:
            out["holdout"]["filters"] = plain(self.unseen_filters)
        return out | {"motion": self.motion} if self.rivals else out
