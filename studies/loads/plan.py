"""Plan of the study, `loads.toml`, and what is drawn from it: cases, and errors of machines."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from studies.blind.plan import study_robot
from surefoot import Robot, load_machine
from surefoot.extend import AXES, Effect, Modelled, Traced, effect

PLAN = Path(__file__).with_name("loads.toml")
MACHINES = PLAN.with_name("machines")
KINDS = ("doubled", "gears", "push", "delay")
"""Kinds of cases of machines on fixed bases."""
DELAYS = ("command_delay", "torque_delay", "rate_delay")


@dataclass(frozen=True)
class TiedLoad(Effect):
    """A small ball tied to a link, at a place in the frame of the link's body [m]."""

    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    name = "tied_load"
    unit = "kg"
    bounds = (0.0, 100.0)
    traced = Traced(channels=("joint_torque", "base_wrench"))
    targets = "joint"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        ball = link(spec, robot, self.target).add_body(pos=self.place)
        ball.add_geom(size=[0.02, 0, 0], mass=self.value, contype=0, conaffinity=0)

    def as_dict(self) -> dict[str, Any]:
        return super().as_dict() | {"place": list(self.place)}


class DenserLink(Effect):
    """A link is denser by a share, with its shape unchanged."""

    name = "denser_link"
    unit = "ratio"
    bounds = (0.0, 2.0)
    traced = Traced(channels=("joint_torque", "base_wrench"))
    targets = "joint"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        for geom in link(spec, robot, self.target).geoms:
            geom.mass = (1.0 + self.value) * geom.mass


def link(spec: mujoco.MjSpec, machine: Modelled, joint: str) -> mujoco.MjsBody:
    """The body that a joint moves."""
    return spec.joint(machine.joint_names[machine.limbs.joints.index(joint)]).parent


@lru_cache(maxsize=16)
def machine_of(name: str) -> Modelled:
    """A machine of the study's own folder, or else a robot of the blind study."""
    own = MACHINES / f"{name}.xml"
    return load_machine(own) if own.is_file() else study_robot(name)


@dataclass(frozen=True)
class LoadCase:
    """One run: its machine, and what is there that its model does not know.

    `individual` numbers the machines of a model that have errors of their own; None is as declared.
    """

    number: int
    kind: str  # load, unchanged, or one of KINDS
    machine: str
    individual: int | None = None
    effects: tuple[Effect, ...] = ()


def draw_load_cases(plan: Mapping[str, Any]) -> list[LoadCase]:
    """Draw every case of a plan from its seed."""
    rng, numbers = np.random.default_rng(plan["seed"]), count()
    loads, fixed, found = plan["loads"], plan["fixed"], []
    for individual in range(loads["individuals"]):
        for place, name in enumerate(loads["machines"]):
            for _ in range(loads["loads"]):
                load = _draw_load(machine_of(name), loads, rng)
                found.append(LoadCase(next(numbers), "load", name, individual, (load,)))
            turn = (individual + place) % len(loads["unchanged"])
            for _ in range(loads["unchanged"][turn]):
                found.append(LoadCase(next(numbers), "unchanged", name, individual))
    for turn in range(fixed["each"]):
        for place, kind in enumerate(KINDS):
            name = fixed["machines"][(turn + place) % len(fixed["machines"])]
            own = _draw_fixed(kind, turn, machine_of(name), fixed, rng)
            found.append(LoadCase(next(numbers), kind, name, None, own))
    return found


def _draw_load(machine: Modelled, plan: Mapping[str, Any], rng: np.random.Generator) -> TiedLoad:
    """A load on any link, anywhere between its joint and its end."""
    joint = str(rng.choice(machine.limbs.joints))
    mass = _log_uniform(plan["share"], rng) * moved_mass(machine)
    end = _link_end(machine, joint)
    place = rng.uniform(0.1, 1.0) * end + plan["away"] * rng.normal(size=3)
    return TiedLoad(joint, mass, tuple(place.tolist()))


def _draw_fixed(
    kind: str, turn: int, machine: Modelled, plan: Mapping[str, Any], rng: np.random.Generator
) -> tuple[Effect, ...]:
    """Effects of a fixed base.

    Args:
        kind: of the case.
        turn: number of the case of its kind.
        machine: that has them.
        plan: of the study.
        rng: of the draw.
    """
    joint = str(rng.choice(machine.limbs.joints))
    if kind == "doubled":
        return (DenserLink(joint, 1.0),)
    if kind == "gears":
        return (effect("load_friction", joint, _log_uniform(plan["gears"], rng)),)
    if kind == "delay":
        return (effect(DELAYS[turn % len(DELAYS)], "all", rng.uniform(*plan["delays"])),)
    return ()


def moved_mass(machine: Modelled) -> float:
    """Mass of all moving parts [kg]."""
    return machine.mass if isinstance(machine, Robot) else machine.limbs.mass


def _link_end(machine: Modelled, joint: str) -> np.ndarray:
    """Place (3,) [m] of the next joint or of the foot in the frame of a joint's link; twice that
    of the centre of mass where there is none.
    """
    model = mujoco.MjModel.from_xml_path(str(machine.file))
    body = model.joint(machine.joint_names[machine.limbs.joints.index(joint)]).bodyid[0]
    next_ = np.flatnonzero((model.body_parentid == body) & (model.body_jntnum > 0))
    return model.body_pos[next_[0]] if len(next_) else 2.0 * model.body_ipos[body]


def _log_uniform(ends: tuple[float, float], rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(ends))))


def errors_of(machine: Modelled, rng: np.random.Generator) -> list[Effect]:
    """What the file of one machine does not know of it, the same in all of its runs."""
    limbs, own = machine.limbs, []
    model = mujoco.MjModel.from_xml_path(str(machine.file))
    for name, joint in zip(machine.joint_names, limbs.joints, strict=True):
        mass = float(model.body_mass[model.joint(name).bodyid[0]])
        own += [
            effect("link_mass", joint, 0.03 * mass * rng.normal()),
            effect("link_com", f"{joint}_{rng.choice(AXES)}", 0.004 * rng.normal()),
            effect("torque_scale", joint, 0.015 * rng.normal()),
        ]
    if limbs.legs:
        return [
            *own,
            *(effect("coulomb_friction", j, rng.uniform(0.1, 0.6)) for j in limbs.joints),
            effect("leg_compliance", "all", rng.uniform(2e-4, 8e-4)),
            effect("foot_rolling", "all", rng.uniform(2e-3, 5e-3)),
            effect("com_offset", "x", 0.005 * rng.normal()),
            effect("contact_delay", "touchdown", rng.uniform(5e-3, 0.02)),
        ]
    for joint, torque in zip(limbs.joints, usual_torques(machine), strict=True):
        own += [
            effect("coulomb_friction", joint, torque * rng.uniform(0.01, 0.04)),
            effect("viscous_friction", joint, torque * rng.uniform(0.01, 0.03)),
            effect("armature", joint, torque * rng.uniform(0.005, 0.02)),
        ]
    geared = str(rng.choice(limbs.joints))
    return [*own, effect("load_friction", geared, rng.uniform(0.02, 0.06))]


def errors_of_run(machine: Modelled, rng: np.random.Generator) -> list[Effect]:
    """What one run of a machine on a fixed base has for itself: its zeros."""
    return [
        one
        for joint, torque in zip(machine.limbs.joints, usual_torques(machine), strict=True)
        for one in (
            effect("encoder_offset", joint, 2e-3 * rng.normal()),
            effect("torque_bias", joint, 5e-3 * torque * rng.normal()),
        )
    ]


def usual_torques(machine: Modelled) -> np.ndarray:
    """Torques (J,) [N m] that give the joints of a machine on a fixed base 10 rad/s^2."""
    return 10.0 * np.array(machine.limbs.inertia)
