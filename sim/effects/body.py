"""Effects of the robot's body: its lengths, its feet and its masses.

Where a docstring gives no source for the bounds, none was found and they were chosen wide.
"""

from dataclasses import replace

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects.base import AXES, Effect, turn_about
from surefoot.sim.log import Log
from surefoot.sim.physics.scene import add_payload
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import LEGS
from surefoot.sim.sensors.streams import Reference

LINKS = tuple(f"{leg}_{link}" for leg in LEGS for link in ("thigh", "calf"))
HIPS = tuple(f"{leg}_{axis}" for leg in LEGS for axis in AXES)


class LinkLength(Effect):
    """A link is longer than the model says: thigh (thigh to knee axis) or calf (knee to foot).

    A quadruped was found to place its feet 14 mm wrong before it was calibrated: Zhao et al.,
    "Accurate Joint Offset Calibration for Quadrupedal Robots", ROBIO 2022.
    """

    name = "link_length"
    unit = "m"
    bounds = (-0.03, 0.03)
    channels = ("leg_velocity", "foot_height", "base_wrench")
    targets = LINKS
    step = 1e-3
    chain_rule = "legs"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        leg, link = self._place()
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        foot = _foot_geom(spec, robot, leg)
        thigh, knee = (data.xanchor[model.joint(robot.joint_names[3 * leg + j]).id] for j in (1, 2))
        if link == "thigh":
            moved = spec.joint(robot.joint_names[3 * leg + 2]).parent
            along_G = knee - thigh
            parent = model.body_parentid[model.body(moved.name).id]
            moved.pos = moved.pos + _in_frame(data, parent, along_G) * self.value
            return
        body = model.body(robot.foot_bodies[leg]).id
        place_G = data.xpos[body] + data.xmat[body].reshape(3, 3) @ robot.foot_places[leg]
        shift = _in_frame(data, body, place_G - knee) * self.value
        foot.pos = foot.pos + shift
        # Where the foot goes its touch site goes too.
        for site in spec.sites:
            if site.name == f"sole_{LEGS[leg]}":
                site.pos = site.pos + shift

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        leg, link = self._place()
        legs = robot.legs
        if link == "thigh":
            offset = legs.offset.copy()
            along = legs.offset[leg, 2] + legs.rotation[leg, 2] @ legs.anchor[leg, 2]
            offset[leg, 2] += _unit(along - legs.anchor[leg, 1]) * self.value
            return log, replace(robot, legs=legs._replace(offset=offset))
        foot = legs.foot.copy()
        foot[leg] += _unit(legs.foot[leg] - legs.anchor[leg, 2]) * self.value
        return log, replace(robot, legs=legs._replace(foot=foot))

    def _place(self) -> tuple[int, str]:
        leg, link = self.target.split("_")
        return LEGS.index(leg), link


class HipOffset(Effect):
    """A leg is mounted further along one of the base's axes: its hip's hinge and all below it."""

    name = "hip_offset"
    unit = "m"
    bounds = (-0.05, 0.05)
    channels = ("leg_velocity", "foot_height", "base_wrench")
    targets = HIPS
    step = 1e-3
    chain_rule = "legs"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        leg, axis = self.target.split("_")
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        along_G = data.xmat[model.body(robot.base_name).id].reshape(3, 3)[:, AXES.index(axis)]
        moved = spec.joint(robot.joint_names[3 * LEGS.index(leg)]).parent
        parent = model.body_parentid[model.body(moved.name).id]
        moved.pos = moved.pos + _in_frame(data, parent, along_G) * self.value

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        leg, axis = self.target.split("_")
        offset = robot.legs.offset.copy()
        offset[LEGS.index(leg), 0, AXES.index(axis)] += self.value
        return log, replace(robot, legs=robot.legs._replace(offset=offset))


class FootRolling(Effect):
    """Every foot rolls on a radius larger than the declared one; its centre stays where it was.

    A declared model of point feet lacks the whole radius, 2 to 4 cm on most quadrupeds' models.
    """

    name = "foot_rolling"
    unit = "m"
    bounds = (-0.06, 0.06)
    channels = ("leg_velocity", "foot_height", "base_wrench")
    targets = ("all",)
    step = 1e-3
    chain_rule = "legs"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        for leg, name in enumerate(LEGS):
            foot = _foot_geom(spec, robot, leg)
            radius = foot.size[0] + self.value
            if radius < 1e-3:
                raise SurefootError(
                    f"effect foot_rolling: {self.value:g} m leaves foot {name} no radius "
                    f"(it has {foot.size[0]:g} m)"
                )
            foot.size = [radius, 0, 0]
            for site in spec.sites:
                if site.name == f"sole_{name}":
                    site.size = [1.3 * radius, 0, 0]

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log, replace(robot, foot_radius=robot.foot_radius + self.value)


class Payload(Effect):
    """A mass on the base, a small ball at its origin.

    Spot carries up to 14 kg (Boston Dynamics, "Spot Specifications").
    """

    name = "payload"
    unit = "kg"
    bounds = (0.0, 30.0)
    channels = ("base_wrench",)
    targets = ("all",)
    step = 0.1
    chain_rule = "mass"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        if self.value:
            add_payload(spec, robot, self.value)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        known = replace(robot.extras, payload=robot.extras.payload + self.value)
        return log, replace(robot, extras=known)


class ComOffset(Effect):
    """The base's own centre of mass lies further along one of the base's axes.

    "Walk These Ways" (CoRL 2022) draws +-0.15 m in its public code.
    """

    name = "com_offset"
    unit = "m"
    bounds = (-0.2, 0.2)
    channels = ("base_wrench",)
    targets = AXES
    step = 1e-3
    chain_rule = "mass"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        base, model = spec.body(robot.base_name), spec.compile()
        built = model.body(robot.base_name)
        place = built.ipos.copy()
        place[AXES.index(self.target)] += self.value
        if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
            # The other bodies keep the inertia of their geoms, as the file asks.
            for body in spec.bodies:
                body.explicitinertial = False
            spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
        base.explicitinertial = True
        base.mass = float(built.mass[0])
        base.ipos, base.iquat, base.inertia = place, built.iquat, built.inertia
        base.fullinertia = [np.nan, 0, 0, 0, 0, 0]

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        along = self.value * np.eye(3)[AXES.index(self.target)]
        known = replace(robot.extras, com_shift=robot.extras.com_shift + along)
        return log, replace(robot, extras=known)


def _foot_geom(spec: mujoco.MjSpec, robot: Robot, leg: int):
    """The geom that `Robot` took for this leg's foot: the sphere at its place on its body."""
    for geom in spec.body(robot.foot_bodies[leg]).geoms:
        is_sphere = geom.type == mujoco.mjtGeom.mjGEOM_SPHERE
        if is_sphere and np.allclose(geom.pos, robot.foot_places[leg], atol=1e-9):
            return geom
    raise SurefootError(f"robot {robot.name}: foot {LEGS[leg]} is not where its model says")


def _in_frame(data: mujoco.MjData, body: int, along_G: np.ndarray) -> np.ndarray:
    return data.xmat[body].reshape(3, 3).T @ _unit(along_G)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


class MountingRotation(Effect):
    """The IMU sits turned on the body about one of its own nominal axes, and the reference was
    aligned with the IMU: the two agree, and the legs are turned against both.

    Motion capture is aligned to a body or to its IMU by hand or by fitting, to a degree or so.
    """

    name = "mounting_rotation"
    unit = "rad"
    bounds = (-0.5, 0.5)
    channels = ("leg_velocity", "foot_height", "base_wrench")
    targets = AXES
    needs = ("reference",)
    step = 1e-3

    def alter_mounting(self, robot: Robot) -> Robot:
        return replace(robot, R_BI=robot.R_BI @ turn_about(self.target, self.value))

    def alter_reference(self, reference: Reference) -> Reference:
        return replace(reference, R_GI=reference.R_GI @ turn_about(self.target, self.value))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log, replace(robot, R_BI=robot.R_BI @ turn_about(self.target, self.value))
