"""Effects that a real robot has and a model may lack: one small class each.

An effect knows two things that share no code: how to put itself into the simulation (the MjSpec or
the sensor streams), and how a model that knows of it undoes it on a log (`explain`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from sim.errors import SurefootError
from sim.legs import JOINTS, LEGS
from sim.log import Log
from sim.robot import Robot
from sim.sensors import Streams

AXES = ("x", "y", "z")
LINKS = tuple(f"{leg}_{link}" for leg in LEGS for link in ("thigh", "calf"))


@dataclass(frozen=True)
class Effect:
    """One effect on one target (a joint, leg, axis or "all"), of one scalar size.

    A subclass says its name, unit, bounds and valid targets, which residual channels it can touch,
    how it is put into the simulation, and how it is explained away. Raises SurefootError for a
    target it does not have or a size out of bounds.
    """

    target: str
    value: float

    name: ClassVar[str]
    unit: ClassVar[str]
    bounds: ClassVar[tuple[float, float]]
    channels: ClassVar[tuple[str, ...]]
    targets: ClassVar[tuple[str, ...]]
    step: ClassVar[float]
    """A small size, for numerical derivatives by it."""

    def __post_init__(self):
        if self.target not in self.targets:
            raise SurefootError(
                f"effect {self.name}: unknown target '{self.target}'; known: "
                f"{', '.join(self.targets)}"
            )
        low, high = self.bounds
        if not low <= self.value <= high:
            raise SurefootError(
                f"effect {self.name}: value must lie between {low:g} and {high:g} {self.unit}, "
                f"is {self.value:g}"
            )

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Change the simulated world; most effects of sensors do not."""

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        """Change what the sensors see; most effects of the world do not."""
        return streams

    def explain(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        """The log and the robot as a model sees them that knows of the effect.

        What it changed in the readings is undone in the log; what it changed in the robot is added
        to the robot's declared model.
        """
        raise NotImplementedError

    def as_dict(self) -> dict[str, Any]:
        return {"name": self.name, "target": self.target, "value": self.value, "unit": self.unit}


class EncoderOffset(Effect):
    """A joint's encoder reads its angle plus a constant."""

    name = "encoder_offset"
    unit = "rad"
    bounds = (-0.2, 0.2)
    channels = ("leg_velocity",)
    targets = JOINTS
    step = 1e-3

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        q = streams.q.copy()
        q[:, JOINTS.index(self.target)] += self.value
        return replace(streams, q=q)

    def explain(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        column = f"q_{self.target}"
        return _with_columns(log, {column: log.frame[column].to_numpy() - self.value}), robot


class LinkLength(Effect):
    """A link is longer than the model says: thigh (thigh to knee axis) or calf (knee to foot)."""

    name = "link_length"
    unit = "m"
    bounds = (-0.03, 0.03)
    channels = ("leg_velocity",)
    targets = LINKS
    step = 1e-3

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

    def explain(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
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


class FootRolling(Effect):
    """Every foot rolls on a radius larger than the declared one; its centre stays where it was."""

    name = "foot_rolling"
    unit = "m"
    bounds = (-0.06, 0.06)
    channels = ("leg_velocity",)
    targets = ("all",)
    step = 1e-3

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

    def explain(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log, replace(robot, foot_radius=robot.foot_radius + self.value)


class ImuRotation(Effect):
    """The IMU is turned about one of its own nominal axes; the reference is not."""

    name = "imu_rotation"
    unit = "rad"
    bounds = (-0.5, 0.5)
    channels = ("imu_gyro", "imu_accel", "leg_velocity")
    targets = AXES
    step = 1e-3

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        turn = self._turn()
        # Row vectors: x @ R is R^T x, the reading in the turned sensor's own axes.
        return replace(streams, gyro=streams.gyro @ turn, accel=streams.accel @ turn)

    def explain(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        back = self._turn().T
        gyro, accel = log.gyro @ back, log.accel @ back
        columns = {f"gyro_{a}": gyro[:, i] for i, a in enumerate(AXES)}
        columns |= {f"accel_{a}": accel[:, i] for i, a in enumerate(AXES)}
        return _with_columns(log, columns), robot

    def _turn(self) -> np.ndarray:
        return Rotation.from_rotvec(self.value * np.eye(3)[AXES.index(self.target)]).as_matrix()


class GyroScale(Effect):
    """One axis of the gyro reads the rate times one plus a constant."""

    name = "gyro_scale"
    unit = "ratio"
    bounds = (-0.3, 0.3)
    channels = ("imu_gyro", "leg_velocity")
    targets = AXES
    step = 1e-3

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        gyro = streams.gyro.copy()
        gyro[:, AXES.index(self.target)] *= 1.0 + self.value
        return replace(streams, gyro=gyro)

    def explain(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        column = f"gyro_{self.target}"
        return _with_columns(log, {column: log.frame[column].to_numpy() / (1 + self.value)}), robot


class JointDelay(Effect):
    """Joint positions, velocities and torques arrive late by a constant time."""

    name = "joint_delay"
    unit = "s"
    bounds = (-0.05, 0.05)
    channels = ("leg_velocity",)
    targets = ("all",)
    step = 1e-3

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        then = np.clip(streams.t - self.value, streams.t[0], streams.t[-1])

        def late(x: np.ndarray) -> np.ndarray:
            return np.column_stack([np.interp(then, streams.t, column) for column in x.T])

        return replace(streams, q=late(streams.q), dq=late(streams.dq), tau=late(streams.tau))

    def explain(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        t = log.t
        then = np.clip(t + self.value, t[0], t[-1])
        names = [f"{kind}_{j}" for kind in ("q", "dq", "tau") if log.has(kind) for j in log.joints]
        # A spline passes noise at every fraction of a sample; lines would smooth it at the half.
        moved = CubicSpline(t, log.frame[names].to_numpy())(then)
        return _with_columns(log, {name: moved[:, i] for i, name in enumerate(names)}), robot


CATALOGUE: Mapping[str, type[Effect]] = {
    kind.name: kind
    for kind in (EncoderOffset, LinkLength, FootRolling, ImuRotation, GyroScale, JointDelay)
}


def effect(name: str, target: str, value: float) -> Effect:
    """The effect of that name. Raises SurefootError for an unknown name or target, or bad size."""
    if name not in CATALOGUE:
        raise SurefootError(f"unknown effect '{name}'; known: {', '.join(CATALOGUE)}")
    return CATALOGUE[name](target, float(value))


def explain_all(effects, log: Log, robot: Robot) -> tuple[Log, Robot]:
    """The log and robot as a model sees them that knows of all `effects`."""
    for one in effects:
        log, robot = one.explain(log, robot)
    return log, robot


def _with_columns(log: Log, columns: Mapping[str, np.ndarray]) -> Log:
    frame = log.frame.copy(deep=False)
    for name, values in columns.items():
        frame[name] = values
    return replace(log, frame=frame)


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
