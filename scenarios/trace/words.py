"""Result of a trace in sentences, for the screen and the report."""

from collections.abc import Mapping, Sequence
from functools import partial
from math import isfinite
from typing import Any

from surefoot.models.attribution.effect_sizes import Found
from surefoot.models.attribution.levels import ChannelLevel
from surefoot.scenarios.trace.filters import DEAD_RECKONING
from surefoot.scenarios.trace.result import Filters, Trace
from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import read_toml
from surefoot.sim.effects import Effect, known_effects

VERDICTS = {
    "attributed": "traced to effects that the model lacks; the remaining residual is noise",
    "confounded": "the residual has more than one explanation that these data cannot distinguish",
    "none_of_these": "a residual remains that no effect of the catalogue explains",
    "not_identifiable": "the data cannot identify an effect",
    "no_residual": "the model explains the log down to its noise floor",
    "unchanged": "nothing has changed since the runs that the declared effects were found in",
}
_MOTIONS = bundled("surefoot.scenarios.trace", "motions.toml")
_PLURALS = {"joint": "joints", "leg": "legs", "leg_link": "links", "leg_axis": "legs"}
"""Kind of target (`Effect.targets`) -> plural noun."""
_MUCH = 0.1
"""Share of the squared residual that an effect outside its bounds must explain to be mentioned."""
_SCALE = {"rad": (1e3, "mrad"), "m": (1e3, "mm"), "s": (1e3, "ms"), "ratio": (1e2, "%")}


def motion_to_distinguish(names: Sequence[str]) -> str:
    """Motion that would distinguish effects of these names."""
    motions = read_toml(_MOTIONS)
    return "; ".join(dict.fromkeys(motions.get(name, "more varied motion") for name in names))


def size_in_words(found: Found, unit: str) -> str:
    """An effect with its size and interval, in a suitable multiple of its unit.

    For example 'encoder_offset FL_thigh +19.8 mrad (95 % interval +19.1 .. +20.4)'.
    """
    one = found.effect
    factor, unit = _SCALE.get(unit, (1.0, unit))
    low, high = (factor * x for x in found.interval)
    return (
        f"{one.name} {target_in_words(one)} {factor * one.value:+.3g} {unit} "
        f"(95 % interval {low:+.3g} .. {high:+.3g})"
    )


def sizes_in_words(found: Trace, ones: Sequence[Found]) -> list[str]:
    """Effects of a trace with their sizes (`size_in_words`)."""
    return [size_in_words(f, found.unit_of(f.effect.name, f.effect.target)) for f in ones]


def target_in_words(one: Effect) -> str:
    """A target in words: 'left' becomes 'of the left legs', 'calf' 'of every calf'; a single joint
    or leg keeps its name.
    """
    kind = type(one).targets
    if not type(one).groups or isinstance(kind, tuple):
        return one.target
    several = "links" if one.name.startswith("link_") else _PLURALS[kind]
    if one.target == "all":
        return f"of all {several}"
    if one.target in ("left", "right", "front", "rear"):
        return f"of the {one.target} {several}"
    return f"of every {one.target}" if one.target in ("hip", "thigh", "calf") else one.target


def unexplained_in_words(found: Trace) -> list[str]:
    """The three strongest correlations of the unexplained residual, one line each."""
    return [
        f"  {100 * r.share:.0f} % of the remaining residual in {r.channel} {r.column} is explained "
        f"by {', '.join(r.regressors)}"
        if r.regressors
        else f"  no regressor explains the remaining residual in {r.channel} {r.column}"
        for r in found.unexplained[:3]
    ]


def beyond_bounds(found: Trace) -> list[str]:
    """The two effects that would explain most of the remaining residual, but only with impossible
    sizes, one line each; none if the trace explains the log.
    """
    if found.verdict != "none_of_these" or found.attribution is None:
        return []
    first = found.attribution.rounds[0] if found.attribution.rounds else ()
    out = [c for c in first if c.at_bound and c.share > _MUCH]
    lines = []
    for one in sorted(out, key=lambda c: -c.share)[:2]:
        kind = known_effects()[one.key[0]]
        unit = found.unit_of(*one.key)
        factor, unit = _SCALE.get(unit, (1.0, unit))
        low, high = (factor * x for x in kind.bounds_on(found.limbs, one.key[1]))
        lines.append(
            f"  {one.key[0]} {one.key[1]} of {factor * one.size:+.3g} {unit} would explain "
            f"{100 * one.share:.0f} % of the residual, but its bounds are {low:.3g} and "
            f"{high:.3g}"
        )
    return lines


def summary(found: Trace) -> str:
    """The output of `surefoot trace`."""
    lines = [f"verdict: {found.verdict}: {VERDICTS[found.verdict]}"]
    lines += [f"  because {why}" for why in found.reasons]
    lines += [f"  lacks {one}" for one in sizes_in_words(found, found.found)]
    for number, run in enumerate(found.runs, 1):
        own = [one for one in run.zeros if one.effect in run.compensated]
        lines += [f"  run {number} has {one}" for one in sizes_in_words(found, own)]
    lines += [f"  or {r['name']} {r['target']} (overlap {r['overlap']:.2f})" for r in found.rivals]
    if found.rivals:
        lines.append(f"  to distinguish them: {found.motion}")
    lines += beyond_bounds(found)
    lines += unexplained_in_words(found)
    lines += least_changes(found)
    if found.channels:
        over = f"{1e3 * found.averaged_over:.0f} ms"
        lines.append(
            f"residual on the part used by no fit (root mean square of means over {over}):"
        )
        lines += _channel_lines(found.channels) + _filter_lines(found.filters)
        for one in found.stretches:
            sides = zip(("before", "after"), one.lost, strict=True)
            lines += [f"  {one.log.name} {side}: {why}" for side, why in sides if why]
    if found.held_out:
        lines.append("on held-out logs, used by no fit:")
        lines += _channel_lines(found.held_out.channels) + _filter_lines(found.unseen_filters)
    if "leg_velocity" in found.channels:
        lines.append(f"masked as slipping: {100 * found.masked_share:.1f} % of stance time")
    if found.channels:
        lines.append(f"noise floor: {found.floor}")
    lines += [f"note: {note}" for note in found.notes if note not in found.reasons]
    return "\n".join(lines)


def least_changes(found: Trace) -> list[str]:
    """For each effect, the least change that would have been named, on the part where it is
    smallest and where it is largest.
    """
    by_name: dict[str, list[tuple[float, str]]] = {}
    for (name, target), least in found.least.items():
        by_name.setdefault(name, []).append((least, target))
    lines = ["would have been named, of 100 such changes 95, from:"] if by_name else []
    for name, sizes in by_name.items():
        ends = []
        for least, target in dict.fromkeys((min(sizes), max(sizes))):
            factor, unit = _SCALE.get(of := found.unit_of(name, target), (1.0, of))
            ends.append(f"{factor * least:.3g} {unit} ({target})")
        lines.append(f"  {name} {' to '.join(ends)}")
    return lines


def _channel_lines(channels: Mapping[str, ChannelLevel]) -> list[str]:
    """A line for each channel: before, after, noise floor."""
    width, lines = max(map(len, channels), default=0), []
    for name, c in channels.items():
        floor = "unknown" if c.noise_floor is None else f"{c.noise_floor:.3g}"
        change = f"{c.before:.3g} -> {c.after:.3g} {c.unit}"
        lines.append(f"  {name:{width}s} {change}, noise floor {floor}")
    return lines


def _filter_lines(filters: Filters) -> list[str]:
    """A line for each filter: errors before and after."""
    lines = []
    for name, metrics in filters.items():
        change = partial(_change, metrics["before"], metrics["after"])
        ape, rpe = f"APE {change('ape_trans', 3)} m", f"RPE {change('rpe_trans', 4)} m"
        kind = "legs alone, dead reckoning"
        if name != DEAD_RECKONING:
            kind = f"{name} filter"
            ape += f", {change('ape_rot', 2)} deg"
            rpe += f", {change('rpe_rot', 3)} deg/m"
        lines.append(f"  {kind}: {ape}; {rpe}; drift {change('drift', 4)} m/m")
    return lines


def caution(found: Mapping[str, Any]) -> str:
    """Warning for users of the effects of a trace.json; "" where none is due."""
    if found["verdict"] != "none_of_these" or not found["effects"]:
        return ""
    harm = [note for note in found["notes"] if note.endswith("with the effects found")]
    words = "caution: a residual remains, and the effects found may stand in for its cause"
    return "; ".join([words, *harm])


def _change(before: dict[str, float], after: dict[str, float], metric: str, digits: int) -> str:
    """A metric before and after; a dash where the walk is too short for it."""
    shown = [f"{m[metric]:.{digits}f}" if isfinite(m[metric]) else "–" for m in (before, after)]
    return " -> ".join(shown)
