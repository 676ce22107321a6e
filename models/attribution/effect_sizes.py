"""Sizes of effects: as found, as plausible on real machines, and which of them belong to a run."""

from dataclasses import dataclass, replace

import numpy as np

from surefoot.sim.effects import Effect, effect, known_effects
from surefoot.sim.effects.timing import Delay
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine


@dataclass(frozen=True)
class Found:
    """An effect with what speaks for it.

    Attributes:
        effect: with its size.
        interval: 95 % interval of its size.
        excess: its size in standard deviations by noise and the model's error.
        least: size from which it would have been named [its unit].
        agreement: its size in standard deviations between blocks of the logs, or between
            channels if these differ by more.
    """

    effect: Effect
    interval: tuple[float, float]
    excess: float = np.nan
    least: float = np.nan
    agreement: float = np.nan


def interior_bounds(name: str, target: str, machine: Machine) -> tuple[float, float]:
    """Bounds of an effect on this machine, for derivatives within them: no size is implausible, and
    no link of a machine on a fixed base loses more mass than it has.
    """
    kind, limbs = known_effects()[name], machine.limbs
    low, high = kind.interior_bounds(target, limbs)
    most = kind.size_prior().most
    return max(low, -most, -kind.most_taken(target, machine)), min(high, most)


def with_clipped_size(one: Effect, value: float, machine: Machine) -> Effect:
    """The effect with its value clipped to its bounds on a machine."""
    low, high = interior_bounds(one.name, one.target, machine)
    return replace(one, value=float(np.clip(value, low, high)))


def with_deviation(key: tuple[str, str], size: float, deviation: float, machine: Machine) -> Found:
    """The effect of a name and target with this size, clipped, and its standard deviation."""
    half = 1.96 * deviation
    return Found(with_clipped_size(effect(*key, 0.0), size, machine), (size - half, size + half))


def per_run_effects() -> frozenset[str]:
    """Names of the effects whose size differs between runs."""
    kinds = known_effects().usable()[0]
    return frozenset(name for name, kind in kinds.items() if kind.traced.belongs_to == "run")


WITHIN_ROW = 0.55
"""Share of a row up to which a lag between readings of one row is one of sampling: the nearest row
is half a row away, and the lag is measured to a few percent.
"""


def is_sampling_lag(one: Effect, rate: float) -> bool:
    """Whether an effect is a lag between readings that a log at this rate [Hz] gives the same row.

    A log does not say when within a row each reading was taken. A simulator that steps rates before
    angles (semi-implicit Euler) has rates half a step before them.
    """
    within_rows = isinstance(one, Delay) and one.is_within_rows()
    return within_rows and abs(one.value) * rate <= WITHIN_ROW


def plausible_size(name: str, target: str, limbs: Limbs) -> float:
    """Bound on an effect's magnitude for 19 of 20 machines with these limbs."""
    return known_effects()[name].plausible_size(target, limbs)


def price_of_some_parts(name: str, target: str, limbs: Limbs) -> float:
    """What it costs an effect to be on some parts of a kind only, -2 log of a prior odds.

    An effect that machines have by construction has much the same size on all parts of a kind
    (`Traced.spread`). On some of these parts only, it differs from the others by its whole size.
    """
    kind = known_effects()[name]
    if kind.traced.spread is None:
        return 0.0
    members = kind.members_of(target, limbs)
    every = len(limbs.legs)
    if members[0] in limbs.joints:
        kinds = limbs.kind_of
        touched = {kinds[limbs.joints.index(one)] for one in members}
        every = sum(one in touched for one in kinds)
    return 0.0 if len(members) == every else (1.96 / kind.traced.spread) ** 2
