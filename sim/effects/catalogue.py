"""Catalogue of the effects that a real robot has and a model may lack.

Packages add effects by the entry point group `surefoot.effects`, scripts by `@add`. Names are
listed without importing the classes. Several effects of a log are compensated in an order.
"""

from collections.abc import Iterable
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from surefoot.sim.common.errors import SurefootError, check_known, errors_in
from surefoot.sim.common.plugins import Registry

if TYPE_CHECKING:
    from surefoot.sim.effects.base import Effect
    from surefoot.sim.log import Log

M = TypeVar("M")
Kind = TypeVar("Kind", bound="type[Effect]")

RENAMED = {"joint_compliance": "leg_compliance"}
"""Old names of effects, from version 0.1.0, which files and logs may still contain."""


def _check(kind: Any) -> None:
    """Raise SurefootError for a class that is no effect, or that says too little."""
    from surefoot.sim.effects.base import Effect, Part, Traced

    if not issubclass(kind, Effect):
        raise SurefootError(f"{kind!r} is no subclass of Effect")
    if not isinstance(kind.targets, tuple) and kind.targets not in get_args(Part):
        raise SurefootError(f"targets: a tuple of words or one of {', '.join(get_args(Part))}")
    if not isinstance(kind.traced, Traced):
        raise SurefootError(f"traced must be Traced(...), is {kind.traced!r:.60}")
    if misplaced := [field.name for field in fields(Traced) if hasattr(kind, field.name)]:
        raise SurefootError(f"{', '.join(misplaced)}: to be stated by traced = Traced(...)")
    if kind.is_compensated() and not (kind.traced.channels and kind.traced.step > 0.0):
        raise SurefootError("traced must name channels, and a step above 0")


CATALOGUE = Registry(
    "surefoot.effects",
    {
        "encoder_offset": "surefoot.sim.effects.readings:EncoderOffset",
        "link_length": "surefoot.sim.effects.body:LinkLength",
        "foot_rolling": "surefoot.sim.effects.body:FootRolling",
        "imu_rotation": "surefoot.sim.effects.imu:ImuRotation",
        "gyro_scale": "surefoot.sim.effects.imu:GyroScale",
        "joint_delay": "surefoot.sim.effects.timing:JointDelay",
        "gyro_bias": "surefoot.sim.effects.imu:GyroBias",
        "accel_bias": "surefoot.sim.effects.imu:AccelBias",
        "accel_scale": "surefoot.sim.effects.imu:AccelScale",
        "imu_position": "surefoot.sim.effects.imu:ImuPosition",
        "gyro_g_sensitivity": "surefoot.sim.effects.imu:GyroGSensitivity",
        "imu_delay": "surefoot.sim.effects.timing:ImuDelay",
        "imu_lowpass": "surefoot.sim.effects.imu:ImuLowpass",
        "encoder_scale": "surefoot.sim.effects.readings:EncoderScale",
        "leg_compliance": "surefoot.sim.effects.elastic:LegCompliance",
        "foot_elasticity": "surefoot.sim.effects.elastic:FootElasticity",
        "backlash": "surefoot.sim.effects.drive:Backlash",
        "hip_offset": "surefoot.sim.effects.body:HipOffset",
        "mounting_rotation": "surefoot.sim.effects.imu:MountingRotation",
        "viscous_friction": "surefoot.sim.effects.drive:ViscousFriction",
        "coulomb_friction": "surefoot.sim.effects.drive:CoulombFriction",
        "load_friction": "surefoot.sim.effects.drive:LoadFriction",
        "armature": "surefoot.sim.effects.drive:Armature",
        "torque_scale": "surefoot.sim.effects.readings:TorqueScale",
        "torque_bias": "surefoot.sim.effects.readings:TorqueBias",
        "torque_delay": "surefoot.sim.effects.timing:TorqueDelay",
        "payload": "surefoot.sim.effects.masses:Payload",
        "com_offset": "surefoot.sim.effects.masses:ComOffset",
        "foot_creep": "surefoot.sim.effects.creep:FootCreep",
        "foot_scrub": "surefoot.sim.effects.creep:FootScrub",
        "foot_slip": "surefoot.sim.effects.contact:FootSlip",
        "soft_ground": "surefoot.sim.effects.contact:SoftGround",
        "contact_delay": "surefoot.sim.effects.contact:ContactDelay",
        "reference_delay": "surefoot.sim.effects.timing:ReferenceDelay",
        "clock_scale": "surefoot.sim.effects.timing:ClockScale",
        "leg_heading": "surefoot.sim.effects.body:LegHeading",
        "rate_delay": "surefoot.sim.effects.timing:RateDelay",
        "command_delay": "surefoot.sim.effects.timing:CommandDelay",
        "link_mass": "surefoot.sim.effects.masses:LinkMass",
        "link_com": "surefoot.sim.effects.masses:LinkCom",
        "link_inertia": "surefoot.sim.effects.masses:LinkInertia",
    },
    needs=("name", "unit", "bounds", "targets"),
    check=_check,
)
"""Name -> class of every effect: the bundled ones, then those of installed packages."""


def known_effects() -> Registry:
    """Name -> class of every effect: the bundled ones, then those of installed packages.

    A package's effect is imported and checked when it is looked up.
    """
    return CATALOGUE


def add(kind: Kind) -> Kind:
    """Class decorator that adds an effect to the catalogue of this process.

    Spawned processes import the script again and know the effect too. The workers of a cluster do
    not; an effect for those needs a package with an entry point.

    Raises SurefootError if it is no class, the class lacks a required attribute, or its name is
    taken.
    """
    with errors_in(f"effect {getattr(kind, '__name__', type(kind).__name__)}"):
        CATALOGUE.check_member(getattr(kind, "name", ""), kind)
    known = CATALOGUE[kind.name] if kind.name in CATALOGUE.bundled else kind
    if (known.__module__, known.__qualname__) != (kind.__module__, kind.__qualname__):
        raise SurefootError(f"effect {kind.name}: the catalogue has one of that name")
    CATALOGUE.bundled[kind.name] = kind
    return kind


def effect(name: str, target: str, value: float) -> "Effect":
    """Create the effect of that name. Raises SurefootError for an unknown name or target, or a size
    out of bounds.
    """
    name = RENAMED.get(name, name)
    check_known("effect", name, CATALOGUE)
    return CATALOGUE[name](target, float(value))


def declared_effects(log: "Log") -> "list[Effect]":
    """The effects that a log declares. Raises SurefootError for an unknown one."""
    return [effect(e["name"], e["target"], e["value"]) for e in log.meta.effects]


def in_order(effects: "Iterable[Effect]") -> "tuple[Effect, ...]":
    """Effects in the order in which they are compensated (`Effect.order`)."""
    return tuple(sorted(effects, key=lambda one: one.order))


def compensate_all(effects: "Iterable[Effect]", log: "Log", robot: M) -> "tuple[Log, M]":
    """The log and the robot with all `effects` compensated.

    Effects that no model can compensate (`Effect.is_compensated`) stay in the log. The machine may
    have a fixed base if no effect changes its body. Raises SurefootError for an effect on a body of
    which only the feet are known.
    """
    known: Any = robot
    for one in in_order(effects):
        if one.is_compensated():
            if known.limbs.feet_alone and not one.traced.on_given_feet:
                raise SurefootError(
                    f"effect {one.name}: needs joint angles and a robot model; {log.name} gives "
                    "the feet alone"
                )
            if one.name not in CATALOGUE.bundled:
                log = log.with_columns({})  # a plug-in may write to its frame
            log, known = one.compensate(log, known)
    return log, known
