"""Verdict of a trace, with its reasons."""

from collections.abc import Sequence
from dataclasses import dataclass

from surefoot.models.attribution.effect_sizes import Found
from surefoot.models.attribution.evidence import Key
from surefoot.models.attribution.explain import FittedRun
from surefoot.models.attribution.forces import Push
from surefoot.models.attribution.levels import ChannelLevel
from surefoot.sim.effects import Effect
from surefoot.sim.robot.limbs import Limbs


@dataclass(frozen=True)
class HeldOutRuns:
    """Result on held-out logs.

    Attributes:
        channels: residual of each channel over all logs.
        runs: effects of each log's own.
    """

    channels: dict[str, ChannelLevel]
    runs: tuple[FittedRun, ...]


@dataclass(frozen=True)
class Findings:
    """What a verdict rests on.

    Attributes:
        found: effects, strongest first.
        channels: residuals on data that no fit has seen.
        imitated: keys of the effects that what the others leave may imitate.
        curves: whether a joint's encoder error is a curve of its angle.
        rivals: other explanations of an effect.
        pushes: sections with an outside force; channels are judged without them.
        pushed_away: effects that explain nothing but outside forces.
        limbs: of the machine, on which bounds depend.
    """

    found: Sequence[Found]
    channels: dict[str, ChannelLevel]
    imitated: frozenset[Key] = frozenset()
    curves: bool = False
    rivals: Sequence[object] = ()
    pushes: Sequence[Push] = ()
    pushed_away: Sequence[Found] = ()
    limbs: Limbs | None = None


def verdict_of(findings: Findings) -> tuple[str, tuple[str, ...]]:
    """The verdict and its reasons; `no_residual` and `attributed` have none."""
    found, channels, pushes = findings.found, findings.channels, findings.pushes
    above = [name for name, c in channels.items() if not c.at_floor or c.worse]
    reasons = [f"{name}: {_above(channels[name])}" for name in above]
    if findings.curves:
        reasons.append("a joint's encoder error varies with its angle")
    reasons += [
        f"{one.effect.name} {one.effect.target}: its size is at its bound"
        for one in found
        if _at_bound(one.effect, findings.limbs)
    ]
    if reasons:
        return "none_of_these", tuple(reasons)
    if pushes and (findings.pushed_away or not found):
        names = [f"{one.effect.name} {one.effect.target}" for one in findings.pushed_away]
        explained = [f"{name}: explains nothing but outside forces" for name in names]
        return "not_identifiable", (*explained, *(one.in_words() for one in pushes))
    if not found:
        return "no_residual", ()
    if not _gains(found, channels):
        why = "the effects found do not reduce the residual on unseen data"
        return "not_identifiable", (why,)
    imitated = [
        f"{one.effect.name} {one.effect.target}: what the other effects leave may imitate it"
        for one in found
        if (one.effect.name, one.effect.target) in findings.imitated
    ]
    return ("confounded" if findings.rivals or imitated else "attributed"), tuple(imitated)


def _above(c: ChannelLevel) -> str:
    if not c.at_floor:
        return f"{c.after:.3g} {c.unit} is left, above its noise floor of {c.noise_floor:.3g}"
    return f"worse with the effects found, {c.before:.3g} -> {c.after:.3g} {c.unit}"


def _at_bound(one: Effect, limbs: Limbs | None) -> bool:
    if not type(one).is_compensated():
        return False
    low, high = type(one).interior_bounds(one.target, limbs)
    return not low < one.value < high


def _gains(found: Sequence[Found], channels: dict[str, ChannelLevel]) -> bool:
    """Whether the effects reduce a channel that they show in on unseen data.

    True if one of them has an estimate of its own, as sliding feet have, and not from channels.
    """
    ones = [one.effect for one in found]
    if not all(one.is_compensated() and one.traced.by_search for one in ones):
        return True
    shown = {name for one in ones for name in one.traced_at(one.target).channels}
    own = [channels[name] for name in shown if name in channels]
    return not own or any(c.after < c.before for c in own)
