"""Result of a trace in sentences: what matters most comes first."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from surefoot.models.attribution.data import LACKING
from surefoot.models.attribution.judgement import ChannelLevel
from surefoot.scenarios.reporting.tables import cell
from surefoot.scenarios.trace.filters import (
    DEAD_RECKONING,
    OF_POSITION,
    REPORTED,
    change_of_errors,
)
from surefoot.scenarios.trace.result import Filters, Trace
from surefoot.sim.effects import Effect, known_effects

VERDICTS = {
    "attributed": "the model lacks {}; what remains of the residual is noise",
    "confounded": "the model lacks {}, but these data cannot tell it from other effects",
    "none_of_these": "a residual remains that no effect of the catalogue explains",
    "not_identifiable": "the data cannot identify an effect",
    "no_residual": "the model explains the log down to its noise floor",
    "unchanged": "nothing has changed since the runs that the declared effects were found in",
}
"""The result in one sentence; `{}` stands for the effects found."""
_PLURALS = {"joint": "joints", "link": "links", "leg": "legs", "leg_link": "links"}
"""Kind of target that has groups (`Effect.targets`) -> plural noun."""
_MUCH = 0.1
"""Share of the squared residual that an effect outside its bounds must explain to be mentioned."""
_SCALE = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "s": (1e3, "ms"), "ratio": (1e2, "%")}
DRIFT_PARTS = {
    "RPE [mm]": 1e3,
    "height [mm/m]": 1e3,
    "yaw [deg/m]": np.degrees(1.0),
    "distance [%]": 1e2,
}
"""Parts of a drift (`filters.drift_parts`) as they are shown, and their factors."""
FIRST = ("drift", "ape_trans", "rpe_trans", "nees_position")
"""Metrics of a filter that are shown first."""


def motion_to_distinguish(names: Sequence[str]) -> str:
    """Motion that would distinguish effects of these names."""
    known = known_effects()
    return "; ".join(dict.fromkeys(known[name].traced.motion for name in names))


def headline(found: Trace) -> str:
    """The result in one sentence."""
    effects = [_sized(found, one) for one in found.effects]
    several = f"{', '.join(effects[:-1])} and {effects[-1]}" if effects[1:] else "".join(effects)
    if found.verdict == "none_of_these" and effects:
        what = "1 effect explains" if len(effects) == 1 else f"{len(effects)} effects explain"
        return f"{what} a part of the residual, and no effect of the catalogue the rest"
    return VERDICTS[found.verdict].format(several)


def _sized(found: Trace, one: Effect) -> str:
    factor, unit = _scale(found, one.name, one.target)
    return f"{one.name} {target_in_words(one)} {factor * one.value:+.3g} {unit}"


def _scale(found: Trace, name: str, target: str) -> tuple[float, str]:
    """Factor to a suitable multiple of an effect's unit, and this multiple."""
    unit = found.unit_of(name, target)
    return _SCALE.get(unit, (1.0, unit))


def target_in_words(one: Effect) -> str:
    """A target in words: 'left' becomes 'of the left legs', 'calf' 'of every calf'; a single joint
    or leg keeps its name.
    """
    kind = type(one).targets
    if not type(one).groups or isinstance(kind, tuple):
        return one.target
    several = _PLURALS[kind]
    if one.target == "all":
        return f"of all {several}"
    if one.target in ("left", "right", "front", "rear"):
        return f"of the {one.target} {several}"
    return f"of every {one.target}" if one.target in ("hip", "thigh", "calf") else one.target


def unexplained_in_words(found: Trace) -> list[str]:
    """The three strongest correlations of the unexplained residual, one line each."""
    return [
        f"{100 * r.share:.0f} % of the remaining residual in {r.channel} {r.column} is explained "
        f"by {', '.join(r.regressors)}"
        if r.regressors
        else f"no regressor explains the remaining residual in {r.channel} {r.column}"
        for r in found.unexplained[:3]
    ]


def beyond_bounds(found: Trace) -> list[str]:
    """The two effects that would explain most of the remaining residual, but only with impossible
    sizes, one line each; none if the trace explains the log.
    """
    if found.verdict != "none_of_these" or not found.rounds:
        return []
    out = [c for c in found.rounds[0] if c.at_bound and c.share > _MUCH]
    lines = []
    for one in sorted(out, key=lambda c: -c.share)[:2]:
        kind = known_effects()[one.key[0]]
        factor, unit = _scale(found, *one.key)
        low, high = (factor * x for x in kind.bounds_on(found.limbs, one.key[1]))
        lines.append(
            f"{one.key[0]} {one.key[1]} of {factor * one.size:+.3g} {unit} would explain "
            f"{100 * one.share:.0f} % of the residual, but its bounds are {low:.3g} and "
            f"{high:.3g}"
        )
    return lines


def state_of(level: ChannelLevel) -> str:
    """What a channel's residual says of the model."""
    if level.worse:
        return "worse"
    if level.evaluation_only:
        return "for evaluation only"
    return "at its floor" if level.at_floor else "above its floor"


def ranked_notes(found: Trace) -> tuple[list[str], list[str], list[str]]:
    """Notes on faults of the logs and the result; on what the logs cannot show; on assumptions."""
    urgent = {*found.channels, "excluded from the verdict", *found.warnings, *found.worse}
    first, lacking, assumed = [], [], []
    if "leg_velocity" in found.channels:
        assumed.append(f"masked as slipping: {100 * found.masked_share:.1f} % of stance time")
    if found.channels:
        assumed.append(f"noise floor: {found.floor}")
    for note in dict.fromkeys(one for one in found.notes if one not in found.reasons):
        without = any(words in note for words in (LACKING, "not used", "not identifiable"))
        of_result = {note, note.partition(":")[0]} & urgent
        (first if of_result else lacking if without else assumed).append(note)
    return first, lacking, assumed


def filter_rows(filters: Filters, metrics: Collection[str]) -> list[dict[str, str]]:
    """One row per filter: metrics before and after, and whether errors of the position grew."""
    rows: list[dict[str, str]] = []
    for name, sides in filters.items():
        before, after = sides["before"], sides["after"]
        row = {
            REPORTED[key]: f"{cell(before[key], 4)} → {cell(after[key], 4)}"
            for key in metrics
            if key in OF_POSITION or name != DEAD_RECKONING
        }
        rows.append({"filter": name, **row, "": change_of_errors(sides)})
    return rows


def caution(found: Mapping[str, Any]) -> str:
    """Warning for users of the effects of a trace.json; "" where none is due."""
    if found["verdict"] != "none_of_these" or not found["effects"]:
        return ""
    harm = [note for note in found["notes"] if note.endswith("with the effects found")]
    words = "caution: a residual remains, and the effects found may stand in for its cause"
    return "; ".join([words, *harm])
