"""Effects of the legs' geometry: lengths, mountings and feet.

Where a docstring gives no source for the bounds, none was found and they were chosen wide.
"""

from dataclasses import replace
from functools import partial

import mujoco
import numpy as np

from surefoot.sim.effects.base import AXES, Effect, Prior, Traced, turn_about
from surefoot.sim.log import Log
from surefoot.sim.physics.drives import foot_parts
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import posed

_pose = partial(Traced, channels=("leg_velocity", "foot_height", "base_wrench"), step=1e-3)


_geometry = partial(_pose, chain_rule="legs")


_FEET_OFF = Prior(0.014, "Zhao et al., ROBIO 2022: feet 14 mm off before calibration")


class LinkLength(Effect):
    """A link is longer than in the model: thigh (thigh to knee axis) or calf (knee to foot).

    The feet of an uncalibrated quadruped were found to be 14 mm off: Zhao et al., "Accurate Joint
    Offset Calibration for Quadrupedal Robots", ROBIO 2022.
    """

    unit = "m"
    bounds = (-0.03, 0.03)
    targets = "leg_link"
    groups = True
    traced = _geometry(
        prior=_FEET_OFF,
        motion="stand tall and crouched, and step over a known distance",
    )

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        model = spec.compile()
        data = posed(model)
        for leg, link in self._places(robot):
            names = [robot.joint_names[joint] for joint in robot.limbs.chains[leg]]
            upper_G = data.xanchor[model.joint(names[link]).id]
            if link + 1 < len(names):
                moved = [spec.joint(names[link + 1]).parent]
                lower_G = data.xanchor[model.joint(names[link + 1]).id]
            else:
                foot, site = foot_parts(spec, robot.limbs.legs[leg])
                # The touch site moves with the foot; a sprung foot moves with its body.
                sprung = site.parent.name not in robot.foot_bodies
                moved = [site.parent] if sprung else [foot, site]
                lower_G = data.site(site.name).xpos
            frame = model.body(moved[0].parent.name).id
            shift = _in_frame(data, frame, lower_G - upper_G) * self.value
            for part in moved:
                part.pos = part.pos + shift

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
        """Index of the leg, and of the joint within it, at the upper end of each link."""
        at = [robot.limbs.joints.index(joint) for joint in self.members(robot.limbs)]
        return [(i, c.index(j)) for j in at for i, c in enumerate(robot.limbs.chains) if j in c]


class HipOffset(Effect):
    """A leg is mounted with an offset along an axis of the base: its hip hinge and all below it."""

    unit = "m"
    bounds = (-0.05, 0.05)
    targets = "leg_axis"
    traced = _geometry(
        prior=_FEET_OFF,
        motion="turn on the spot and walk sideways, crouched and tall",
    )

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        hinge, _, axis_B = _hip(self, spec, robot)
        hinge.parent.pos = hinge.parent.pos + axis_B * self.value

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        offset = robot.legs.offset.copy()
        leg, axis = leg_and_axis(self, robot)
        offset[leg, 0, axis] += self.value
        return log, replace(robot, legs=robot.legs._replace(offset=offset))


PARALLEL = 0.01
"""Angle below which two axes count as parallel [rad]: of a rotation by 0.1 rad about one of them,
the component about the other is then off by at most 1 mrad, an encoder step.
"""


class LegHeading(Effect):
    """A leg is mounted with a rotation about an axis of the base, through its hip hinge.

    No published figure was found; a seat machined to 0.1 mm over 50 mm is off by 2 mrad, printed
    parts by ten times as much.
    """

    unit = "rad"
    bounds = (-0.2, 0.2)
    targets = "leg_axis"
    traced = _geometry(
        prior=Prior(0.02, "no figure found: 0.8 mm over a seat of 40 mm"),
        motion="walk forwards and sideways: the error of a rotated leg is across its motion",
    )

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        hinge, model, axis_B = _hip(self, spec, robot)
        moved, joint = model.body(hinge.parent.name), model.joint(hinge.name)
        turn, quat = np.empty(4), np.empty(4)
        mujoco.mju_axisAngle2Quat(turn, axis_B, self.value)
        mujoco.mju_mulQuat(quat, turn, moved.quat)
        # Keep the hinge's anchor in place.
        before, after = np.empty(3), np.empty(3)
        mujoco.mju_rotVecQuat(before, joint.pos, moved.quat)
        mujoco.mju_rotVecQuat(after, joint.pos, quat)
        hinge.parent.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        hinge.parent.pos, hinge.parent.quat = moved.pos + before - after, quat

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        leg, axis = leg_and_axis(self, robot)
        legs, turn = robot.legs, turn_about(AXES[axis], self.value)
        offset, rotation = legs.offset.copy(), legs.rotation.copy()
        rotation[leg, 0] = turn @ legs.rotation[leg, 0]
        offset[leg, 0] += (legs.rotation[leg, 0] - rotation[leg, 0]) @ legs.anchor[leg, 0]
        return log, replace(robot, legs=legs._replace(offset=offset, rotation=rotation))

    @classmethod
    def equals_another(cls, target: str, robot: Robot) -> bool:
        # Rotation about the axis of the first hinge is equivalent to an encoder offset of that
        # joint.
        leg, axis = leg_and_axis(cls(target, 0.0), robot)
        hinge = robot.legs.rotation[leg, 0] @ robot.legs.axis[leg, 0]
        return bool(np.hypot(*np.delete(hinge, axis)) < PARALLEL)


def _hip(one: Effect, spec: mujoco.MjSpec, robot: Robot):
    """First hinge of an effect's leg, the compiled model, and the effect's axis of the base (3,) in
    the frame in which the hip's body is placed.
    """
    leg, axis = leg_and_axis(one, robot)
    hinge, model = spec.joint(robot.joint_names[robot.limbs.chains[leg][0]]), spec.compile()
    data = posed(model)
    along_G = data.xmat[model.body(robot.base_name).id].reshape(3, 3)[:, axis]
    return hinge, model, _in_frame(data, int(model.body(hinge.parent.name).parentid[0]), along_G)


def leg_and_axis(one: Effect, robot: Robot) -> tuple[int, int]:
    """Index of the leg and of the axis of an effect."""
    (target,) = one.members(robot.limbs)
    leg, axis = target.rsplit("_", 1)
    return robot.limbs.legs.index(leg), AXES.index(axis)


class FootRolling(Effect):
    """A foot rolls on a larger radius than declared, about the same centre.

    A model with point feet lacks the whole radius, 2 to 4 cm on most quadrupeds' models.
    """

    unit = "m"
    bounds = (-0.06, 0.06)
    targets = "leg"
    groups = True
    traced = _geometry(
        prior=Prior(0.04, "radii of feet in the models of quadrupeds: 2 to 4 cm"),
        motion="change the slope of the legs: long against short steps at one speed",
        spread=0.25,  # no published figure was found, and feet wear
        scales_with="foot_radius",
    )

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        for name in self.members(robot.limbs):
            foot, site = foot_parts(spec, name)
            radius = self.left_of(foot.size[0], f"foot {name}", 1e-3)
            foot.size, site.size = [radius, 0, 0], [1.3 * radius, 0, 0]

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        added = self.value * np.isin(robot.limbs.legs, self.members(robot.limbs))
        return log, replace(robot, foot_radius=robot.foot_radius + added)

    @classmethod
    def is_always_present(cls, target: str, robot: Robot) -> bool:
        return target == "all" and robot.limbs.point_feet and not robot.foot_radius.any()


def _in_frame(data: mujoco.MjData, body: int, along_G: np.ndarray) -> np.ndarray:
    return data.xmat[body].reshape(3, 3).T @ _unit(along_G)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)
