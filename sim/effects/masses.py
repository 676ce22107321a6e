"""Effects of masses and inertias: of the base, and of the links of legs, arms and pendulums.

A link is the body that a joint moves, and is named after the joint; the machine may have a fixed
base. The bounds are wide: CAD models omit cables, screws and covers, a tenth to a half of a link's
mass, and a gantry carries a hundred kilograms.
"""

from functools import partial
from typing import Any

import mujoco
import numpy as np

from surefoot.sim.effects.base import AXES, Effect, Prior, Traced, along, declared_on
from surefoot.sim.log import Log
from surefoot.sim.physics.scene import add_payload
from surefoot.sim.robot import Robot
from surefoot.sim.robot.body_changes import LinkChange, with_own_inertia
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine


class Payload(Effect):
    """A mass on the base, as a small ball at its origin.

    Spot carries up to 14 kg (Boston Dynamics, "Spot Specifications").
    """

    unit = "kg"
    bounds = (0.0, 30.0)
    targets = ("all",)
    traced = Traced(
        channels=("base_wrench",),
        step=0.1,
        chain_rule="mass",
        prior=Prior(14.0, "Boston Dynamics, Spot Specifications: up to 14 kg"),
    )

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        if self.value:
            add_payload(spec, robot, self.value)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log, declared_on(robot, payload=self.value)


class ComOffset(Effect):
    """The base's own centre of mass is shifted along an axis of the base.

    "Walk These Ways" (CoRL 2022) draws +-0.15 m in its public code.
    """

    unit = "m"
    bounds = (-0.2, 0.2)
    targets = AXES
    traced = Traced(
        channels=("base_wrench",),
        step=1e-3,
        chain_rule="mass",
        prior=Prior(0.15, "Margolis and Agrawal, CoRL 2022, public code: 0.15 m"),
    )

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        base = with_own_inertia(spec, robot.base_name)
        base.ipos = base.ipos + along(self.target, self.value)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log, declared_on(robot, com_shift=along(self.target, self.value))


_LEAST = 1e-12
"""Least mass [kg] and moment [kg m^2] of a link, which must have some."""


_mass = partial(Traced, channels=("joint_torque", "base_wrench"), chain_rule="mass")


_LOAD_SHARE = 0.4
"""Load that a machine on a fixed base carries for 19 of 20, as a share of its moving mass:
Universal Robots UR10e, technical specifications: 12.5 kg of 33.5 kg.
"""


class LinkMass(Effect):
    """A link is heavier than in the model, with the same centre of mass."""

    unit = "kg"
    bounds = (-20.0, 200.0)
    targets = "link"
    groups = True
    traced = _mass(
        step=1e-2,
        bounds_on_legs=(-0.5, 5.0),
        prior=Prior(0.6, "Tan et al., RSS 2018: masses of 80 to 120 %, of links up to 3 kg"),
        motion="move the joint fast and slowly, and hold it level: only a mass has weight",
    )

    @classmethod
    def plausible_size(cls, target: str, limbs: Limbs) -> float:
        # Legged robots are too small to tell how much a large machine carries.
        within = super().plausible_size(target, limbs)
        return within if limbs.legs else max(within, _LOAD_SHARE * limbs.mass)

    @classmethod
    def most_taken(cls, target: str, machine: Machine) -> float:
        if not machine.fixed or machine.dynamics is None:
            return np.inf
        model, links = machine.dynamics.model, cls.members_of(target, machine.limbs)
        return min(float(model.body_mass[model.joint(one).bodyid[0]]) for one in links)

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        for joint in self.members(robot.limbs):
            body = _link(spec, robot, joint)
            body.mass = self.left_of(body.mass, f"the link of {joint}", _LEAST)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log, _with_links(self, robot, mass=self.value)


class LinkCom(Effect):
    """A link's centre of mass is shifted along an axis of its body, `<joint>_<axis>`."""

    unit = "m"
    bounds = (-0.5, 0.5)
    targets = "link_axis"
    traced = _mass(
        step=1e-3,
        bounds_on_legs=(-0.1, 0.1),
        prior=Prior(0.05, "no figure found: a quarter of a link of 0.2 m, drawn and not weighed"),
        motion="move the joint fast and slowly, in several attitudes of the link",
    )

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        joint, axis = self.target.rsplit("_", 1)
        body = _link(spec, robot, joint)
        body.ipos = body.ipos + along(axis, self.value)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        joint, axis = self.target.rsplit("_", 1)
        at = robot.limbs.joints.index(joint)
        change = LinkChange(at, com=tuple(along(axis, self.value)))
        return log, declared_on(robot, links=(change,))


class LinkInertia(Effect):
    """A link has more inertia than in the model, about every axis through its centre of mass.

    Excludes the first link of a fixed base, whose inertia no motion distinguishes from `armature`.
    """

    unit = "kg m^2"
    bounds = (0.0, 20.0)
    may_lessen = True
    targets = "link"
    groups = True
    traced = _mass(
        step=1e-5,
        bounds_on_legs=(0.0, 0.5),
        prior=Prior(0.02, "Tan et al., RSS 2018: 50 to 150 % of links up to 0.04 kg m^2"),
        motion="move the joint fast and slowly: an inertia only resists acceleration",
    )

    @classmethod
    def single_targets(cls, limbs: Limbs) -> tuple[str, ...]:
        return limbs.joints if limbs.legs else limbs.joints[1:]

    @classmethod
    def group_targets(cls, limbs: Limbs) -> dict[str, tuple[str, ...]]:
        return super().group_targets(limbs) if limbs.legs else {}

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        for joint in self.members(robot.limbs):
            body = _link(spec, robot, joint)
            least, middle, most = np.sort(body.inertia)
            # A body's largest moment is at most the sum of the other two.
            self.left_of(min(least, least + middle - most), f"the link of {joint}", _LEAST)
            body.inertia = body.inertia + self.value

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log, _with_links(self, robot, inertia=self.value)


def _with_links(one: Effect, robot: Robot, **change: Any) -> Robot:
    """The robot with this change of each of the effect's links declared."""
    joints = [robot.limbs.joints.index(joint) for joint in one.members(robot.limbs)]
    return declared_on(robot, links=tuple(LinkChange(joint, **change) for joint in joints))


def _link(spec: mujoco.MjSpec, robot: Robot, joint: str) -> mujoco.MjsBody:
    """The body that a joint moves, with its inertia given explicitly."""
    name = robot.joint_names[robot.limbs.joints.index(joint)]
    return with_own_inertia(spec, spec.joint(name).parent.name)
