"""Result of a trace: a diagnosis, and its influence on the filters."""

from dataclasses import dataclass, field
from typing import Any

from surefoot.models.attribution.diagnose import Diagnosis
from surefoot.models.attribution.explain import Candidate
from surefoot.models.attribution.judgement import ChannelLevel
from surefoot.scenarios.reporting.html import Step
from surefoot.scenarios.trace.filters import BeforeAfter, DriftCauses
from surefoot.sim.common.files import plain_json
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
        causes: of the leg filter's drift (`scenarios.trace.filters.causes_of_drift`), on held-out
            logs where there are any. None where that filter does not run.
        warnings: those of the notes that say what is implausible in the logs.
        steps: what to do next.
        limbs: of the machine.
    """

    filters: Filters
    stretches: tuple[BeforeAfter, ...] = ()
    unseen_filters: Filters = field(default_factory=dict)
    worse: tuple[str, ...] = ()
    causes: DriftCauses | None = None
    warnings: tuple[str, ...] = ()
    steps: tuple[Step, ...] = ()
    limbs: Limbs = field(default_factory=lambda: Limbs((), (), ()))

    @property
    def unseen_channels(self) -> dict[str, ChannelLevel]:
        """Residuals on the held-out logs; without any, on the parts of the logs used by no fit."""
        return self.held_out.channels if self.held_out else self.channels

    @property
    def judged_filters(self) -> Filters:
        """Metrics of the filters on the held-out logs; without any, on the end of each log."""
        return self.unseen_filters if self.held_out else self.filters

    @property
    def motion(self) -> str:
        """What to record to distinguish rival explanations."""
        known = known_effects()
        return "; ".join(dict.fromkeys(known[one["name"]].traced.motion for one in self.rivals))

    @property
    def rounds(self) -> tuple[tuple[Candidate, ...], ...]:
        """Candidates of each round of the search."""
        return self.attribution.rounds if self.attribution else ()

    def unit_of(self, name: str, target: str) -> str:
        """Unit of an effect on this machine (`Effect.unit_on`)."""
        return known_effects()[name].unit_on(target, self.limbs)

    def as_dict(self) -> dict[str, Any]:
        """The content of trace.json."""
        out = super().as_dict() | plain_json({"filters": self.filters, "worse": self.worse})
        runs = (*out["runs"], *out.get("holdout", {"runs": ()})["runs"])
        for one in (
            *out["effects"],
            *out.get("least", ()),
            *(zero for run in runs for zero in run),
        ):
            one["unit"] = self.unit_of(one["name"], one["target"])
        if self.causes:
            added = [
                {"name": one.name, "target": one.target, "drift": drift.tolist()}
                for one, drift in self.causes.added
            ]
            ends = {side: getattr(self.causes, side).tolist() for side in ("declared", "left")}
            out["drift"] = ends | {"added": added}
        if self.held_out:
            out["holdout"]["filters"] = plain_json(self.unseen_filters)
        return out | {"motion": self.motion} if self.rivals else out
