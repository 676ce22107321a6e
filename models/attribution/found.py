"""An effect found by a trace, with its confidence interval."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surefoot.sim.effects import Effect, effect, known_effects
from surefoot.sim.robot.machine import Machine


@dataclass(frozen=True)
class Found:
    """An effect and the 95 % interval of its size."""

    effect: Effect
    interval: tuple[float, float]


def in_order(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Effects in the order in which they are compensated: errors of sensors before those of the
    body, whose sizes are in true units.
    """
    return tuple(sorted(effects, key=lambda one: type(one).edit_spec is not Effect.edit_spec))


def interior_bounds(name: str, target: str, machine: Machine) -> tuple[float, float]:
    """Bounds of an effect on this machine, for derivatives within them: no link of a machine on a
    fixed base loses more mass than it has.
    """
    kind, limbs = known_effects()[name], machine.limbs
    low, high = kind.interior_bounds(target, limbs)
    if name == "link_mass" and machine.fixed and machine.dynamics is not None:
        model = machine.dynamics.model
        parts = kind.members_of(target, limbs)
        low = max(low, *(-float(model.body_mass[model.joint(j).bodyid[0]]) for j in parts))
    return low, high


def with_clipped_size(one: Effect, value: float, machine: Machine) -> Effect:
    """The effect with its value clipped to its bounds on a machine."""
    low, high = interior_bounds(one.name, one.target, machine)
    return replace(one, value=float(np.clip(value, low, high)))


def sized(key: tuple[str, str], size: float, deviation: float, machine: Machine) -> Found:
    """The effect of a name and target with this size, clipped, and its standard deviation."""
    half = 1.96 * deviation
    return Found(with_clipped_size(effect(*key, 0.0), size, machine), (size - half, size + half))
