"""A 12-joint quadruped read from its MJCF: legs, feet, IMU and limits, in canonical order."""

import hashlib
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.quaternion import matrix_from_quaternion
from surefoot.sim.log import Log
from surefoot.sim.physics.inertia import LinkChange
from surefoot.sim.robot.catalog import robot_file
from surefoot.sim.robot.home_pose import standing_joints, stands
from surefoot.sim.robot.kinematics import Legs, feet
from surefoot.sim.robot.legs import JOINTS, find_legs
from surefoot.sim.robot.limbs import QUADRUPED, Limbs

IMU_SITES = ("imu", "imu_site", "IMU", "trunk_imu")


@dataclass(frozen=True)
class DeclaredExtras:
    """What a model knows of its robot beyond the MJCF: effects that were added to it."""

    payload: float = 0.0  # kg at the base's origin
    com_shift: np.ndarray = field(default_factory=lambda: np.zeros(3))  # m, of the base's own, in B
    imu_lowpass: float = 0.0  # s, time constant
    softness: float = 0.0  # s, what the ground takes longer to push back than hard ground
    touchdown_late: float = 0.0  # s, of a contact's delay what whole rows of a log cannot undo
    liftoff_late: float = 0.0  # s, the same where it ends
    links: tuple[LinkChange, ...] = ()  # masses and inertias of links
    command_late: float = 0.0  # s, of torques behind their commands


@dataclass(frozen=True)
class Robot:
    """A quadruped's declared model. Legs FL, FR, RL, RR; joints hip, thigh, calf.

    The base frame B is that of the body with the free joint, the IMU frame I that of the site that
    carries a gyro or is named "imu" (the base frame where the model has none). `foot_radius` is
    what the declared model says of rolling feet: zero means feet are points.
    """

    name: str
    file: Path
    mass: float  # kg
    imu: str | None  # its site; None: the model has none, and the base frame stands for it
    p_BI: np.ndarray  # (3,) m, the IMU's origin in B
    R_BI: np.ndarray  # (3, 3), maps I to B
    foot_radius: np.ndarray  # (4,) m
    joint_range: np.ndarray  # (12, 2) rad
    torque_limit: np.ndarray  # (12,) N m
    q_home: np.ndarray  # (12,) rad, standing
    legs: Legs
    base_name: str
    joint_names: tuple[str, ...]  # the model's own names, in canonical order
    foot_bodies: tuple[str, ...]  # name of the body that carries each foot's sphere
    foot_places: np.ndarray  # (4, 3) m, the sphere's centre in that body
    extras: DeclaredExtras = field(default_factory=DeclaredExtras)

    @classmethod
    def load(cls, name_or_path: str | Path) -> "Robot":
        """The robot of a known name or an MJCF file. Raises SurefootError in one clear line."""
        file = robot_file(name_or_path)
        model = _compile(file)
        tree = find_legs(model, file.stem)
        joints = tree.joint_ids.ravel()
        imu = _imu_site(model, tree.base_body)
        p_BI, R_BI = _imu_mounting(model, imu)
        return cls(
            name=str(name_or_path) if file.stem == str(name_or_path) else file.stem,
            file=file,
            mass=float(model.body_subtreemass[tree.base_body]),
            imu=model.site(imu).name if imu >= 0 else None,
            p_BI=p_BI,
            R_BI=R_BI,
            foot_radius=tree.foot_radius,
            joint_range=_ranges(model, joints),
            torque_limit=_torque_limits(model, joints, file.stem),
            q_home=_home(model, joints, tree.constants),
            legs=tree.constants,
            base_name=model.body(tree.base_body).name,
            joint_names=tuple(model.joint(j).name for j in joints),
            foot_bodies=tuple(model.body(b).name for b in model.geom_bodyid[tree.foot_geoms]),
            foot_places=model.geom_pos[tree.foot_geoms].copy(),
        )

    @classmethod
    def for_log(cls, log: Log, name: str | Path | None = None) -> "Robot":
        """The robot `name`, or else the one the log names, with what the log's map says of it."""
        chosen = name or log.meta.robot
        if not chosen:
            raise SurefootError("the log names no robot: say which with --robot")
        robot = cls.load(chosen)
        if log.has("q") and log.joints != JOINTS:
            raise SurefootError(
                f"{log.name}: its joints are not a quadruped's twelve ({JOINTS[0]} to {JOINTS[-1]})"
            )
        mapped = log.meta.model
        if "p_BI" in mapped:
            robot = replace(robot, p_BI=np.array(mapped["p_BI"], dtype=float))
        if "q_BI" in mapped:
            robot = replace(
                robot, R_BI=matrix_from_quaternion(np.array(mapped["q_BI"], dtype=float))
            )
        if "foot_radius" in mapped:
            radius = np.broadcast_to(mapped["foot_radius"], (4,)).astype(float)
            robot = replace(robot, foot_radius=radius)
        return robot

    @property
    def limbs(self) -> Limbs:
        """Names of its legs and joints."""
        return QUADRUPED

    def feet_I(self, q: np.ndarray) -> np.ndarray:
        """Foot centres (N, 4, 3) in I [m] of joint angles q (N, 12) [rad]."""
        return self._feet(q)[0]

    def feet_jacobian_I(self, q: np.ndarray) -> np.ndarray:
        """d foot / d (own leg's joints), (N, 4, 3, 3) in I [m/rad], of q (N, 12) [rad]."""
        return self._feet(q)[1]

    def foot_rates_I(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Angular velocity (N, 4, 3) of each foot's link relative to the base, in I [rad/s]."""
        axes = self._feet(q)[2]
        return np.einsum("nlij,nlj->nli", axes, np.asarray(dq, dtype=float).reshape(-1, 4, 3))

    def spec(self) -> mujoco.MjSpec:
        """A fresh MjSpec of the file, for composing with a scene."""
        return mujoco.MjSpec.from_file(str(self.file))

    @cached_property
    def leg_length(self) -> float:
        """Length [m] of the straight leg from the thigh joint to the foot's centre."""
        legs = self.legs
        return float(np.linalg.norm(legs.offset[0, 2]) + np.linalg.norm(legs.foot[0]))

    @cached_property
    def inertial(self) -> tuple[float, np.ndarray, np.ndarray, float]:
        """At home: mass [kg], centre of mass (3,) in B [m], principal-axis inertia (3,) about it
        [kg m^2], and the mass of one leg as felt at its foot [kg]."""
        return _inertial(self)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the model: its file, what that includes as MuJoCo compiles it, and the
        mounting and feet that are declared."""
        model = _compile(self.file)
        compiled = np.empty(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, compiled)
        digest = hashlib.sha256(self.file.read_bytes())
        for values in (compiled, self.p_BI, self.R_BI, self.foot_radius):
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()

    def _feet(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        q = np.ascontiguousarray(q, dtype=float)
        if q.ndim != 2 or q.shape[1] != 12:
            raise ValueError(f"q must be (N, 12), is {q.shape}")
        return feet(self.legs, q, self.R_BI, self.p_BI)


def _inertial(robot: Robot) -> tuple[float, np.ndarray, np.ndarray, float]:
    model = robot.spec().compile()
    data = mujoco.MjData(model)
    base = model.body(robot.base_name).id
    data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
    for name, angle in zip(robot.joint_names, robot.q_home, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    com = data.subtree_com[base]
    about_origin = np.diag(M[3:6, 3:6])
    shift = robot.mass * (com @ com - com**2)
    joints = [model.joint(name).dofadr[0] for name in robot.joint_names[:3]]
    J = robot.feet_jacobian_I(robot.q_home[None])[0, 0]
    J_inv = np.linalg.inv(J)
    felt = J_inv.T @ M[np.ix_(joints, joints)] @ J_inv
    return robot.mass, com.copy(), about_origin - shift, float(np.trace(felt) / 3)


def _compile(file: Path) -> mujoco.MjModel:
    try:
        return mujoco.MjModel.from_xml_path(str(file))
    except ValueError as error:
        reason = str(error).strip().splitlines()[0]
        raise SurefootError(f"robot {file}: MuJoCo cannot read it: {reason}") from None


def _imu_site(model: mujoco.MjModel, base: int) -> int:
    """The base's site that a gyro or an accelerometer sits on, or one named so; -1 without one."""
    inertial = np.isin(
        model.sensor_type, (mujoco.mjtSensor.mjSENS_GYRO, mujoco.mjtSensor.mjSENS_ACCELEROMETER)
    )
    named = (mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) for name in IMU_SITES)
    for site in (*model.sensor_objid[inertial], *named):
        if site >= 0 and model.site_bodyid[site] == base:
            return int(site)
    return -1


def _imu_mounting(model: mujoco.MjModel, site: int) -> tuple[np.ndarray, np.ndarray]:
    if site < 0:
        return np.zeros(3), np.eye(3)
    return model.site_pos[site].copy(), matrix_from_quaternion(model.site_quat[site])


def _ranges(model: mujoco.MjModel, joints: np.ndarray) -> np.ndarray:
    limited = model.jnt_limited[joints].astype(bool)[:, None]
    return np.where(limited, model.jnt_range[joints], [-np.pi, np.pi])


def _torque_limits(model: mujoco.MjModel, joints: np.ndarray, name: str) -> np.ndarray:
    """From the joint's motor (control or force range), else from the joint itself."""
    limits = np.full(len(joints), np.inf)
    for i, joint in enumerate(joints):
        driven = (model.actuator_trnid[:, 0] == joint) & (
            model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
        )
        for actuator in np.flatnonzero(driven):
            gear = abs(model.actuator_gear[actuator, 0])
            if model.actuator_ctrllimited[actuator]:
                limits[i] = min(limits[i], gear * model.actuator_ctrlrange[actuator, 1])
            if model.actuator_forcelimited[actuator]:
                limits[i] = min(limits[i], gear * model.actuator_forcerange[actuator, 1])
        if model.jnt_actfrclimited[joint]:
            limits[i] = min(limits[i], model.jnt_actfrcrange[joint, 1])
    if not np.isfinite(limits).all():
        joint = model.joint(joints[int(np.argmax(~np.isfinite(limits)))]).name
        raise SurefootError(
            f"robot {name}: no torque limit for joint {joint}; give its motor a ctrlrange"
        )
    return limits


def _home(model: mujoco.MjModel, joints: np.ndarray, legs: Legs) -> np.ndarray:
    """The keyframe "home" if it stands, else knees bent with feet below the hips."""
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    if key >= 0:
        q_home = model.key_qpos[key, model.jnt_qposadr[joints]].copy()
        if stands(legs, q_home):
            return q_home
    return standing_joints(legs, _ranges(model, joints))
