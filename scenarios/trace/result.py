"""What a trace finds: a diagnosis, and what it changes in the filters."""

from dataclasses import dataclass
from typing import Any

from surefoot.models.attribution.diagnose import Diagnosis, plain
from surefoot.scenarios.trace.filters import BeforeAfter


@dataclass(frozen=True, kw_only=True)
class Trace(Diagnosis):
    """A diagnosis with the filters before and after, on the end of each log.

    filters: name -> {"before", "after"} -> mean metrics; stretches: what they are means of; motion:
    what would distinguish rivals.
    """

    filters: dict[str, dict[str, dict[str, float]]]
    stretches: tuple[BeforeAfter, ...] = ()
    motion: str = ""

    def as_dict(self) -> dict[str, Any]:
        """trace.json."""
        out = super().as_dict() | plain({"filters": self.filters})
        return out | {"motion": self.motion} if self.rivals else out
