"""What a trace finds: a diagnosis, and what it changes in the filters."""

from dataclasses import dataclass, field
from typing import Any

from surefoot.models.attribution.diagnose import Diagnosis, plain
from surefoot.scenarios.trace.filters import BeforeAfter

Filters = dict[str, dict[str, dict[str, float]]]
"""Filter -> "before", "after" -> metrics."""


@dataclass(frozen=True, kw_only=True)
class Trace(Diagnosis):
    """A diagnosis with the filters before and after, on the end of each log.

    filters: means over logs; stretches: what they are means of; unseen_filters: the same over whole
    held-out logs; worse: what got worse, a line each; motion: what would distinguish rivals.
    """

    filters: Filters
    stretches: tuple[BeforeAfter, ...] = ()
    unseen_filters: Filters = field(default_factory=dict)
    worse: tuple[str, ...] = ()
    motion: str = ""

    def as_dict(self) -> dict[str, Any]:
        """trace.json."""
        out = super().as_dict() | plain({"filters": self.filters, "worse": self.worse})
        if self.held_out:
            out["holdout"]["filters"] = plain(self.unseen_filters)
        return out | {"motion": self.motion} if self.rivals else out
