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
from surefoot.sim.sensors.streams import Reference


class LinkLength(Effect):
    """A link is longer than the model says: thigh (thigh to knee axis) or calf (knee to foot).

    A quadruped was found to place its feet 14 mm wrong before it was calibrated: Zhao et al.,
    "Accurate Joint Offset Calibration for Quadrupedal Robots", ROBIO 2022.
    """

    name = "link_length"
    unit = "m"
    bounds = (-0.03, 0.03)
    channels = ("leg_velocity", "foot_height", "base_wrench")
    targets = "leg_link"
    groups = True
    step = 1e-3
    chain_rule = "legs"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        for leg, link in self._places(robot):
            names = [robot.joint_names[joint] for joint in robot.limbs.chains[leg]]
            upper_G = data.xanchor[model.joint(names[link]).id]
            if link + 1 < len(names):
                moved = spec.joint(names[link + 1]).parent
                along_G = data.xanchor[model.joint(names[link + 1]).id] - upper_G
                parent = model.body_parentid[model.body(moved.name).id]
                moved.pos = moved.pos + _in_frame(data, parent, along_G) * self.value
                continue
            foot, body = _foot_geom(spec, robot, leg), model.body(robot.foot_bodies[leg]).id
            place_G = data.xpos[body] + data.xmat[body].reshape(3, 3) @ robot.foot_places[leg]
            shift = _in_frame(data, body, place_G - upper_G) * self.value
            foot.pos = foot.pos + shift
            # Where the foot goes its touch site goes too.
            for site in spec.sites:
                if site.name == f"sole_{robot.limbs.legs[leg]}":
                    site.pos = site.pos + shift

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        legs = robot.legs
        offset, foot = legs.offset.copy(), legs.foot.copy()
        for leg, link in self._places(robot):
            upper = legs.anchor[leg, link]
            if link + 1 < len(robot.limbs.chains[leg]):
                turned = legs.rotation[leg, link + 1] @ legs.anchor[leg, link + 1]
                lower = legs.offset[leg, link + 1] + turned
                offset[leg, link + 1] += _unit(lower - upper) * self.value
            else:
                foot[leg] += _unit(legs.foot[leg] - upper) * self.value
        return log, replace(robot, legs=legs._replace(offset=offset, foot=foot))

    def _places(self, robot: Robot) -> list[tuple[int, int]]:
        """Leg and place in it of the joint at the upper end of each link."""
        at = [robot.limbs.joints.index(joint) for joint in self.members(robot.limbs)]
        return [(i, c.index(j)) for j in at for i, c in enumerate(robot.limbs.chains) if j in c]


class HipOffset(Effect):
    """A leg is mounted further along one of the base's axes: its hip's hinge and all below it."""

    name = "hip_offset"
    unit = "m"
    bounds = (-0.05, 0.05)
    channels = ("leg_velocity", "foot_height", "base_wrench")
    targets = "leg_axis"
    step = 1e-3
    chain_rule = "legs"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        leg, axis = self._place(robot)
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        along_G = data.xmat[model.body(robot.base_name).id].reshape(3, 3)[:, axis]
        moved = spec.joint(robot.joint_names[robot.limbs.chains[leg][0]]).parent
        parent = model.body_parentid[model.body(moved.name).id]
        moved.pos = moved.pos + _in_frame(data, parent, along_G) * self.value

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        offset = robot.legs.offset.copy()
        leg, axis = self._place(robot)
        offset[leg, 0, axis] += self.value
        return log, replace(robot, legs=robot.legs._replace(offset=offset))

    def _place(self, robot: Robot) -> tuple[int, int]:
        """Index of the leg and of the axis."""
        (target,) = self.members(robot.limbs)
        leg, axis = target.rsplit("_", 1)
        return robot.limbs.legs.index(leg), AXES.index(axis)


class FootRolling(Effect):
    """A foot rolls on a radius larger than the declared one; its centre stays where it was.

    A declared model of point feet lacks the whole radius, 2 to 4 cm on most quadrupeds' models.
    """

    name = "foot_rolling"
    unit = "m"
    bounds = (-0.06, 0.06)
    channels = ("leg_velocity", "foot_height", "base_wrench")
    targets = "leg"
    groups = True
    step = 1e-3
    chain_rule = "legs"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        for name in self.members(robot.limbs):
            leg = robot.limbs.legs.index(name)
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
        added = self.value * np.isin(robot.limbs.legs, self.members(robot.limbs))
        return log, replace(robot, foot_radius=robot.foot_radius + added)


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
    name = robot.limbs.legs[leg]
    raise SurefootError(f"robot {robot.name}: foot {name} is not where its model says")


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
