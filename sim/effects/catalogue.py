"""Catalogue of the effects that a real robot has and a model may lack.

Packages add effects by the entry point group `surefoot.effects`, scripts by `@add`.
"""

from collections.abc import Iterable
from typing import Any, TypeVar, get_args

from surefoot.sim.common.errors import SurefootError, check_known, errors_in
from surefoot.sim.common.plugins import Registry
from surefoot.sim.effects import body, contact, elastic, imu, joint, links, timing
from surefoot.sim.effects.base import Effect
from surefoot.sim.effects.targets import Part
from surefoot.sim.log import Log

M = TypeVar("M")

K = TypeVar("K", bound=type[Effect])

GROUP = "surefoot.effects"
RENAMED = {"joint_compliance": "leg_compliance"}
"""Old names of effects, from version 0.1.0, which files and logs may still contain."""
CATALOGUE: dict[str, type[Effect]] = {
    kind.name: kind
    for kind in (
        *(joint.EncoderOffset, body.LinkLength, body.FootRolling, imu.ImuRotation, imu.GyroScale),
        *(timing.JointDelay, imu.GyroBias, imu.AccelBias, imu.AccelScale, imu.ImuPosition),
        *(imu.GyroGSensitivity, timing.ImuDelay, imu.ImuLowpass, joint.EncoderScale),
        *(elastic.LegCompliance, elastic.FootElasticity, joint.Backlash, body.HipOffset),
        *(body.MountingRotation, contact.ViscousFriction, contact.CoulombFriction),
        *(contact.LoadFriction, contact.Armature, joint.TorqueScale, joint.TorqueBias),
        *(timing.TorqueDelay, body.Payload, body.ComOffset, contact.FootSlip, contact.SoftGround),
        *(timing.ContactDelay, timing.ReferenceDelay, timing.ClockScale, body.LegHeading),
        *(timing.RateDelay, timing.CommandDelay, links.LinkMass, links.LinkCom),
        links.LinkInertia,
    )
}


def known_effects() -> Registry:
    """Name -> class of every effect: the bundled ones, then those of installed packages.

    A package's effect is imported and checked when it is looked up.
    """
    return _EFFECTS


def add(kind: K) -> K:
    """Class decorator that adds an effect to the catalogue of this process.

    Spawned processes import the script again and know the effect too. The workers of a cluster do
    not; an effect for those needs a package with an entry point.

    Raises SurefootError if the class lacks a required attribute, or its name is taken.
    """
    with errors_in(f"effect {kind.__name__}"):
        _EFFECTS.check_member(getattr(kind, "name", ""), kind)
    known = CATALOGUE.setdefault(kind.name, kind)
    if (known.__module__, known.__qualname__) != (kind.__module__, kind.__qualname__):
        raise SurefootError(f"effect {kind.name}: the catalogue has one of that name")
    CATALOGUE[kind.name] = kind
    return kind


def _check(kind: Any) -> None:
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise SurefootError(f"{kind!r} is no class of Effect")
    if not isinstance(kind.targets, tuple) and kind.targets not in get_args(Part):
        raise SurefootError(f"targets: a tuple of words or one of {', '.join(get_args(Part))}")
    if kind.is_compensated() and not getattr(kind, "step", 0.0) > 0.0:
        raise SurefootError("step must be a number above 0")


_EFFECTS = Registry(GROUP, CATALOGUE, ("name", "unit", "bounds", "channels", "targets"), _check)


def effect(name: str, target: str, value: float) -> Effect:
    """Create the effect of that name. Raises SurefootError for an unknown name or target, or a size
    out of bounds.
    """
    known = known_effects()
    name = RENAMED.get(name, name)
    check_known("effect", name, known)
    return known[name](target, float(value))


def declared_effects(log: Log) -> list[Effect]:
    """The effects that a log declares. Raises SurefootError for an unknown one."""
    return [effect(e["name"], e["target"], e["value"]) for e in log.meta.effects]


def in_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Effects in the order in which they are compensated: errors of sensors before those of the
    body, whose sizes are in true units, and last those that take loads from the log.
    """

    def place(one: Effect) -> tuple[bool, bool]:
        return one.uses_loads, type(one).edit_spec is not Effect.edit_spec

    return tuple(sorted(effects, key=place))


def compensate_all(effects: Iterable[Effect], log: Log, robot: M) -> tuple[Log, M]:
    """The log and the robot with all `effects` compensated.

    Effects that no model can compensate (`Effect.is_compensated`) stay in the log. The machine may
    have a fixed base if no effect changes its body. Raises SurefootError for an effect on a body of
    which only the feet are known.
    """
    known: Any = robot
    for one in in_order(effects):
        if one.is_compensated():
            if known.limbs.feet_alone and not one.on_given_feet:
                raise SurefootError(
                    f"effect {one.name}: needs joint angles and a robot model; {log.name} gives "
                    "the feet alone"
                )
            if one.name not in CATALOGUE:
                log = log.with_columns({})  # a plug-in may write to its frame
            log, known = one.compensate(log, known)
    return log, known
