"""A robot with legs, read from its MJCF or URDF: legs, feet, IMU and limits."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.quaternion import matrix_from_quaternion
from surefoot.sim.log import Log
from surefoot.sim.robot.body_changes import BodyChanges, LinkChange
from surefoot.sim.robot.catalog import robot_file, robot_of_log
from surefoot.sim.robot.feet import LegFeet
from surefoot.sim.robot.home_pose import home_pose, joint_ranges
from surefoot.sim.robot.inverse_dynamics import Dynamics, dynamics_of
from surefoot.sim.robot.kinematics import Legs, feet
from surefoot.sim.robot.legs import find_legs
from surefoot.sim.robot.limbs import Limbs, refuse_foreign
from surefoot.sim.robot.model_file import compiled_model, read_model

_OF_JOINTS = ("joint_range", "torque_limit", "q_home")
_OF_LEGS = ("foot_radius", "foot_reach", "sole", "foot_places")
NO_ROBOT = "the log names no robot: say which"
IMU_SITES = ("imu", "imu_site", "IMU", "trunk_imu")


@dataclass(frozen=True)
class DeclaredExtras:
    """Properties of a robot's declared model beyond its file: the effects added to it."""

    payload: float = 0.0  # kg at the base's origin
    com_shift: np.ndarray = field(default_factory=lambda: np.zeros(3))  # m, of the base's own, in B
    imu_lowpass: float = 0.0  # s, time constant
    softness: float = 0.0  # s, what the ground takes longer to push back than hard ground
    touchdown_late: float = 0.0  # s, part of a contact's delay that a log still has
    liftoff_late: float = 0.0  # s, the same of the end of a contact
    links: tuple[LinkChange, ...] = ()  # masses and inertias of links
    command_late: float = 0.0  # s, of torques behind their commands
    declared: tuple[tuple[tuple[str, str], float], ...] = ()  # as of `Limbs`


@dataclass(frozen=True)
class Robot:
    """The declared model of a robot with L legs and J joints, those of the legs first.

    The legs of a quadruped are FL, FR, RL, RR and, with three hinges each, their joints hip, thigh
    and calf; two legs are left and right, others are named after their first body, and their joints
    as in the model. The base frame B is that of the body with the free joint, the IMU frame I that
    of the site that carries a gyro or is named "imu" (the base frame where the model has none).
    `foot_radius` is the declared radius of rolling feet; zero means point or flat feet.
    """

    name: str
    file: Path
    mass: float  # kg
    imu: str | None  # its site; None: the model has none, and the base frame stands for it
    p_BI: np.ndarray  # (3,) m, the IMU's origin in B
    R_BI: np.ndarray  # (3, 3), maps I to B
    foot_radius: np.ndarray  # (L,) m
    foot_reach: np.ndarray  # (L,) m, from a foot's place to what of its shape may touch the ground
    sole: np.ndarray  # (L, 2) m, half lengths of flat feet, fore and aft and sideways; else zero
    joint_range: np.ndarray  # (J, 2) rad
    torque_limit: np.ndarray  # (J,) N m, infinite where the model has none
    q_home: np.ndarray  # (J,) rad, standing
    limbs: Limbs  # names of legs and joints
    legs: Legs
    drawn: Legs  # `legs` as the file has them
    base_name: str
    joint_names: tuple[str, ...]  # the model's own names, in the order of `limbs`
    foot_bodies: tuple[str, ...]  # name of the body that carries each foot
    foot_places: np.ndarray  # (L, 3) m in that body: a sphere's centre, or the middle of a sole
    extras: DeclaredExtras = field(default_factory=DeclaredExtras)
    fixed: ClassVar[bool] = False  # as of `Machine`

    @classmethod
    def load(cls, name_or_path: str | Path, feet: Mapping[str, str] | None = None) -> "Robot":
        """Load the robot of a known name, or from an MJCF or URDF file. Raises SurefootError in one
        line.

        feet: name of each leg, and of the body or site that is its foot, where the shapes at the
        ends of the chains do not identify them.
        """
        file = robot_file(name_or_path)
        model = compiled_model(file)
        tree = find_legs(model, file.stem, feet)
        joints = tree.joint_ids
        imu = _imu_site(model, tree.base_body)
        return cls(
            name=str(name_or_path) if file.stem == str(name_or_path) else file.stem,
            file=file,
            mass=float(model.body_subtreemass[tree.base_body]),
            imu=model.site(imu).name if imu >= 0 else None,
            p_BI=np.zeros(3) if imu < 0 else model.site_pos[imu].copy(),
            R_BI=np.eye(3) if imu < 0 else matrix_from_quaternion(model.site_quat[imu]),
            foot_radius=tree.foot_radius,
            foot_reach=np.array([foot.reach for foot in tree.feet]),
            sole=np.array([foot.sole for foot in tree.feet]),
            joint_range=joint_ranges(model, joints),
            torque_limit=_torque_limits(model, joints),
            q_home=home_pose(model, tree),
            limbs=tree.limbs,
            legs=tree.constants,
            drawn=tree.constants,
            base_name=model.body(tree.base_body).name,
            joint_names=tuple(model.joint(j).name for j in joints),
            foot_bodies=tuple(model.body(foot.body).name for foot in tree.feet),
            foot_places=np.array([foot.place for foot in tree.feet]),
        )

    @classmethod
    def for_log(cls, log: Log, name: str | Path | None = None) -> "Robot":
        """The robot `name`, or else the one the log names, with the values of the log's map.

        Raises SurefootError where neither says which robot.
        """
        chosen = name or robot_of_log(log)
        if not chosen:
            feet = "; its foot positions suffice for estimate, compare, align and trace"
            raise SurefootError(f"{log.name}: {NO_ROBOT}{feet if log.has('foot') else ''}")
        return cls.load(chosen, log.meta.model.get("feet")).in_log(log)

    def in_log(self, log: Log) -> "Robot":
        """The robot with the joints and legs of a log, and the values of its map.

        Raises SurefootError as `in_order_of`.
        """
        mapped, robot = log.meta.model, self.in_order_of(log)
        given: dict[str, np.ndarray] = {}
        if "p_BI" in mapped:
            given["p_BI"] = np.array(mapped["p_BI"], dtype=float)
        if "q_BI" in mapped:
            given["R_BI"] = matrix_from_quaternion(np.array(mapped["q_BI"], dtype=float))
        if "foot_radius" in mapped:
            radius = np.broadcast_to(mapped["foot_radius"], len(robot.foot_radius))
            given["foot_radius"] = radius.astype(float)
        return replace(robot, **given) if given else robot

    def in_order_of(self, log: Log) -> "Robot":
        """The robot with the joints and legs of a log, in its order.

        Joints of no leg that the log lacks keep their position in the model. Raises SurefootError
        where the log lacks a joint of a leg, or has a joint or leg that the robot does not.
        """
        limbs, joints = self.limbs, log.joints if log.has("q") else self.limbs.joints
        legs = log.legs or limbs.legs
        refuse_foreign(joints, limbs.joints, f"{log.name}: joint", self.name)
        refuse_foreign(legs, limbs.legs, f"{log.name}: leg", self.name)
        needed = [limbs.joints[joint] for chain in limbs.chains for joint in chain]
        lacking = [f"q_{n}" for n in needed if n not in joints] or [
            f"contact_{leg}" for leg in limbs.legs if leg not in legs
        ]
        if lacking:
            raise SurefootError(f"{log.name}: the log of {self.name} lacks {', '.join(lacking)}")
        if joints == limbs.joints and legs == limbs.legs:
            return self
        at = {limbs.joints.index(name): place for place, name in enumerate(joints)}
        kept, order = list(at), [limbs.legs.index(leg) for leg in legs]
        chains = tuple(tuple(at[joint] for joint in limbs.chains[leg]) for leg in order)
        constants, drawn = (Legs(*(x[order] for x in one)) for one in (self.legs, self.drawn))
        for leg, chain in enumerate(chains):
            constants.joints[leg, : len(chain)] = drawn.joints[leg, : len(chain)] = chain
        return replace(
            self,
            limbs=Limbs(legs, joints, chains, limbs.links),
            legs=constants,
            drawn=drawn,
            joint_names=tuple(self.joint_names[j] for j in kept),
            foot_bodies=tuple(self.foot_bodies[leg] for leg in order),
            **{n: getattr(self, n)[kept] for n in _OF_JOINTS},
            **{n: getattr(self, n)[order] for n in _OF_LEGS},
        )

    def feet_I(self, q: np.ndarray) -> np.ndarray:
        """Foot centres, or middles of flat soles, (N, L, 3) in I [m] for angles q (N, J) [rad]."""
        return self._places_and_jacobians(q)[0]

    def feet_jacobian_I(self, q: np.ndarray) -> np.ndarray:
        """Jacobian of each foot by its own leg's joints (N, L, 3, P) in I [m/rad], for q (N, J)
        [rad].

        P is the number of joints of the longest leg; columns beyond a leg's own are zero.
        """
        return self._places_and_jacobians(q)[1]

    @property
    def feet(self) -> LegFeet:
        """As of `Machine`: by the kinematics of its legs."""
        return LegFeet(self.legs, self.foot_radius, self.R_BI, self.p_BI)

    @property
    def dynamics(self) -> Dynamics:
        """As of `Machine`: of its file, with the declared geometry and links."""
        changes = BodyChanges((self.drawn, self.legs), self.extras.links)
        return dynamics_of(self.file, self.joint_names, changes)

    @property
    def legged(self) -> "Robot":
        """The robot itself, as its legs are known (see `Machine`)."""
        return self

    def spec(self) -> mujoco.MjSpec:
        """A new MjSpec of the file, for composition with a scene."""
        return read_model(self.file)[0]

    @cached_property
    def home_feet_B(self) -> np.ndarray:
        """Feet (L, 3) in the home pose, in B [m]."""
        return self.feet_I(self.q_home[None])[0] @ self.R_BI.T + self.p_BI

    def at_home(self, model: mujoco.MjModel) -> mujoco.MjData:
        """The home pose of a compiled model that has the robot's joints."""
        data = mujoco.MjData(model)
        for name, angle in zip(self.joint_names, self.q_home, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = angle
        mujoco.mj_kinematics(model, data)
        return data

    @cached_property
    def leg_length(self) -> float:
        """Length [m] of the first leg when straight, from its second hinge to the foot's centre;
        from its first where it has no more than two.
        """
        legs, count = self.legs, int(self.legs.joint_count[0])
        links = legs.offset[0, 2 if count > 2 else 1 : count]
        return float(np.linalg.norm(links, axis=1).sum() + np.linalg.norm(legs.foot[0]))

    @cached_property
    def inertial(self) -> tuple[float, np.ndarray, np.ndarray, float]:
        """Inertia in the home pose: mass [kg], centre of mass (3,) in B [m], diagonal of the
        inertia (3,) about it along B's axes [kg m^2], and the effective mass of one leg at its foot
        [kg].
        """
        model = self.spec().compile()
        data, base = self.at_home(model), model.body(self.base_name).id
        data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
        mujoco.mj_forward(model, data)
        M = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, M)
        com = data.subtree_com[base]
        about_origin = np.diag(M[3:6, 3:6])
        shift = self.mass * (com @ com - com**2)
        joints = [model.joint(name).dofadr[0] for name in self.joint_names[:3]]
        J_inv = np.linalg.inv(self.feet_jacobian_I(self.q_home[None])[0, 0])
        felt = J_inv.T @ M[np.ix_(joints, joints)] @ J_inv
        return self.mass, com.copy(), about_origin - shift, float(np.trace(felt) / 3)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the model: its file, with includes as MuJoCo compiles them, and the declared
        mounting and feet.
        """
        model = compiled_model(self.file)
        compiled = np.empty(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, compiled)
        digest = hashlib.sha256(self.file.read_bytes())
        for values in (compiled, self.p_BI, self.R_BI, self.foot_radius):
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()

    def _places_and_jacobians(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q = np.ascontiguousarray(q, dtype=float)
        if q.ndim != 2 or q.shape[1] != len(self.limbs.joints):
            raise ValueError(f"q must be (N, {len(self.limbs.joints)}), is {q.shape}")
        return feet(self.legs, q, self.R_BI, self.p_BI)[:2]


def _imu_site(model: mujoco.MjModel, base: int) -> int:
    """The base's site with a gyro or accelerometer, or one named so; -1 without one."""
    inertial = np.isin(
        model.sensor_type, (mujoco.mjtSensor.mjSENS_GYRO, mujoco.mjtSensor.mjSENS_ACCELEROMETER)
    )
    named = (mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) for name in IMU_SITES)
    for site in (*model.sensor_objid[inertial], *named):
        if site >= 0 and model.site_bodyid[site] == base:
            return int(site)
    return -1


def _torque_limits(model: mujoco.MjModel, joints: np.ndarray) -> np.ndarray:
    """Lower of the motor's and the joint's limit; infinite where neither states one.

    The control range of a plain motor is a torque; that of a servo is an angle or rate.
    """
    limits = np.full(len(joints), np.inf)
    for i, joint in enumerate(joints):
        driven = (model.actuator_trnid[:, 0] == joint) & (
            model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
        )
        for actuator in np.flatnonzero(driven):
            gear = abs(model.actuator_gear[actuator, 0])
            gain = abs(model.actuator_gainprm[actuator, 0])
            plain = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
            ranges = [(model.actuator_forcelimited, model.actuator_forcerange, gear)]
            ranges += [(model.actuator_ctrllimited, model.actuator_ctrlrange, gear * gain)] * plain
            for limited, allowed, factor in ranges:
                if limited[actuator]:
                    limits[i] = min(limits[i], factor * np.abs(allowed[actuator]).max())
        if model.jnt_actfrclimited[joint]:
            limits[i] = min(limits[i], np.abs(model.jnt_actfrcrange[joint]).max())
    return limits
