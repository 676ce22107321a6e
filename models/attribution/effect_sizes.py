"""Sizes of effects: as found, as plausible on real machines, and which of them belong to a run.

Priors of the catalogue are in priors.toml. A plug-in effect states its own by the class attribute
`plausible`, in its unit; without it, any size within its bounds is equally plausible.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import read_typed
from surefoot.sim.effects import Effect, effect, known_effects
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine


@dataclass(frozen=True)
class Found:
    """An effect with what speaks for it.

    Attributes:
        effect: with its size.
        interval: 95 % interval of its size.
        excess: its size in standard deviations by noise and the model's error.
        agreement: its size in standard deviations between blocks of the logs.
    """

    effect: Effect
    interval: tuple[float, float]
    excess: float = np.nan
    agreement: float = np.nan


def interior_bounds(name: str, target: str, machine: Machine) -> tuple[float, float]:
    """Bounds of an effect on this machine, for derivatives within them: no size is implausible, and
    no link of a machine on a fixed base loses more mass than it has.
    """
    kind, limbs = known_effects()[name], machine.limbs
    low, high = kind.interior_bounds(target, limbs)
    most = prior_of(kind).most
    low, high = max(low, -most), min(high, most)
    if name == "link_mass" and machine.fixed and machine.dynamics is not None:
        model = machine.dynamics.model
        parts = kind.members_of(target, limbs)
        low = max(low, *(-float(model.body_mass[model.joint(j).bodyid[0]]) for j in parts))
    return low, high


def with_clipped_size(one: Effect, value: float, machine: Machine) -> Effect:
    """The effect with its value clipped to its bounds on a machine."""
    low, high = interior_bounds(one.name, one.target, machine)
    return replace(one, value=float(np.clip(value, low, high)))


def with_deviation(key: tuple[str, str], size: float, deviation: float, machine: Machine) -> Found:
    """The effect of a name and target with this size, clipped, and its standard deviation."""
    half = 1.96 * deviation
    return Found(with_clipped_size(effect(*key, 0.0), size, machine), (size - half, size + half))


PER_RUN_EFFECTS = frozenset(
    {"encoder_offset", "torque_bias", "gyro_bias", "accel_bias", "reference_delay", "clock_scale"}
)
"""Effects whose size differs between runs."""


SAMPLING_LAGS = frozenset({"rate_delay", "torque_delay"})
"""Lags between readings of one row."""
WITHIN_ROW = 0.55
"""Share of a row up to which such a lag is one of sampling: the nearest row is half a row away, and
the lag is measured to a few percent.
"""


def is_sampling_lag(one: Effect, rate: float) -> bool:
    """Whether an effect is a lag between readings that a log at this rate [Hz] gives the same row.

    A log does not say when within a row each reading was taken. A simulator that steps rates before
    angles (semi-implicit Euler) has rates half a step before them.
    """
    return one.name in SAMPLING_LAGS and abs(one.value) * rate <= WITHIN_ROW


@dataclass(frozen=True)
class Prior:
    """Prior of an effect's size, in the effect's unit.

    Attributes:
        within: bound on the magnitude for 19 of 20 machines.
        source: of that figure.
        most: magnitude beyond which the size is implausible for any machine, so that another cause
            must explain the residual.
    """

    within: float
    source: str
    most: float = np.inf


@cache
def priors() -> dict[str, Prior]:
    """Name of an effect -> its prior, from priors.toml."""
    return read_typed(
        bundled("surefoot.models.attribution", "priors.toml"), dict[str, Prior], "priors"
    )


def prior_of(kind: type[Effect]) -> Prior:
    """Prior of an effect: its own `plausible`, else that in priors.toml, else its bounds."""
    own = getattr(kind, "plausible", None)
    if own is not None:
        return Prior(float(own), f"{kind.__module__}: {kind.__name__}.plausible")
    wide = float(np.max(np.abs(kind.bounds)))
    return priors().get(kind.name) or Prior(wide, "no figure found: as wide as the bounds")


LOAD_SHARE = 0.4
"""Load that a machine on a fixed base carries for 19 of 20, as a share of its moving mass:
Universal Robots UR10e, technical specifications: 12.5 kg of 33.5 kg.
"""
REFLECTED_SHARE = 1.0
"""Inertia of a rotor and its gear, as a share of what its joint moves: Armstrong, Khatib and
Burdick, ICRA 1986: 0.2 to 4.7 kg m^2 in the PUMA 560, as much as its links.
"""


def plausible_size(name: str, target: str, limbs: Limbs) -> float:
    """Bound on an effect's magnitude for 19 of 20 machines with these limbs (`Prior.within`).

    Figures of legged robots are too small for loads and rotors of large machines on a fixed base;
    there they grow with the masses of the model.
    """
    kind = known_effects()[name]
    within = prior_of(kind).within
    if limbs.legs:
        return within
    if name == "link_mass":
        return max(within, LOAD_SHARE * limbs.mass)
    if name == "armature" and limbs.inertia:
        moved = dict(zip(limbs.joints, limbs.inertia, strict=True))
        return max(
            within, REFLECTED_SHARE * max(moved[one] for one in kind.members_of(target, limbs))
        )
    return within


SPREAD_BETWEEN_PARTS: dict[str, float] = {"leg_compliance": 0.25, "foot_rolling": 0.25}
"""Name -> relative spread between parts of one kind, at 95 %.

No published figure was found: manufacturers of gears state typical stiffnesses only, and feet wear.
"""


def price_of_some_parts(name: str, target: str, limbs: Limbs) -> float:
    """What it costs an effect to be on some parts of a kind only, -2 log of a prior odds.

    An effect that machines have by construction has much the same size on all parts of a kind
    (`SPREAD_BETWEEN_PARTS`). On some of these parts only, it differs from the others by its whole
    size.
    """
    if name not in SPREAD_BETWEEN_PARTS:
        return 0.0
    members = known_effects()[name].members_of(target, limbs)
    every = len(limbs.legs)
    if members[0] in limbs.joints:
        kinds = [limbs.kind(i) for i in range(len(limbs.joints))]
        touched = {kinds[limbs.joints.index(one)] for one in members}
        every = sum(kind in touched for kind in kinds)
    return 0.0 if len(members) == every else (1.96 / SPREAD_BETWEEN_PARTS[name]) ** 2
