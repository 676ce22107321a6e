"""Logs and robots with several effects compensated, in the order that this needs."""

from collections.abc import Iterable
from typing import Any, TypeVar

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects.base import Effect
from surefoot.sim.effects.catalogue import CATALOGUE, effect
from surefoot.sim.log import Log

M = TypeVar("M")


def declared_effects(log: Log) -> list[Effect]:
    """The effects that a log declares. Raises SurefootError for an unknown one."""
    return [effect(e["name"], e["target"], e["value"]) for e in log.meta.effects]


def in_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Effects in the order in which they are compensated: errors of sensors before those of the
    body, whose sizes are in true units, and last those that take loads from the log.
    """

    def place(one: Effect) -> tuple[bool, bool]:
        return one.traced.uses_loads, type(one).edit_spec is not Effect.edit_spec

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
            if known.limbs.feet_alone and not one.traced.on_given_feet:
                raise SurefootError(
                    f"effect {one.name}: needs joint angles and a robot model; {log.name} gives "
                    "the feet alone"
                )
            if one.name not in CATALOGUE.bundled:
                log = log.with_columns({})  # a plug-in may write to its frame
            log, known = one.compensate(log, known)
    return log, known
