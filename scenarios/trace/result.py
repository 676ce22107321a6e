"""What a trace finds: a diagnosis, and what it changes in the filters."""

from dataclasses import dataclass, field
from typing import Any

from surefoot.models.attribution.diagnose import Diagnosis, plain
from surefoot.scenarios.trace.filters import BeforeAfter

Filters = dict[str, dict[str, dict[str, float]]]
"""Filter -> "before" or "after" -> metric -> value."""


@dataclass(frozen=True, kw_only=True)
class Trace(Diagnosis):
    """A diagnosis, and what its effects change in the filters on the last part of each log.

    filters: metrics averaged over logs; stretches: each log's estimates, over which they are
    averaged; unseen_filters: as filters, over whole held-out logs; worse: channels and filters that
    got worse; motion: what to record so that rival explanations can be told apart.
    """

    filters: Filters
    stretches: tuple[BeforeAfter, ...] = ()
    unseen_filters: Filters = field(default_factory=dict)
    worse: tuple[str, ...] = ()
    motion: str = ""

    def as_dict(self) -> dict[str, Any]:
        """The content of trace.json."""
        out = super().as_dict() | plain({"filters": self.filters, "worse": self.worse})
        if self.held_out:
            out["holdout"]["filters"] = plain(self.unseen_filters)
        return out | {"motion": self.motion} if self.rivals else out
