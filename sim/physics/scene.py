"""Compose a robot and its ground into one MuJoCo model driven by joint torques."""

from dataclasses import dataclass

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.ground.height_map import HeightMap, surface
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.ground.tiles import add_ground
from surefoot.sim.physics.drives import Gears, Springs, gears_of, springs_of
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import JOINTS, LEGS
from surefoot.sim.robot.limbs import QUADRUPED

TIMESTEP = 0.002  # s
FELT, LEAST_FELT = 1.3, 1e-3
"""Radius of a foot's touch sensor, as a share of its reach, and at least [m]."""
WHEEL = 0.05
"""Least distance of a foot from the axis of its leg's last hinge, as a share of the leg."""


@dataclass(frozen=True)
class World:
    """A compiled scene, and the indices of the robot's parts in its arrays, in canonical order."""

    model: mujoco.MjModel
    qpos_adr: np.ndarray  # (12,)
    dof_adr: np.ndarray  # (12,)
    touch_adr: np.ndarray  # (4,) into sensordata
    start: np.ndarray  # (nq,) standing at the origin
    height_map: HeightMap  # of the ground
    springs: Springs  # of an elastic robot
    gears: Gears  # of its joints


def refuse_other_legs(robot: Robot) -> None:
    """Raise SurefootError for a robot that is no quadruped of three hinges a leg."""
    if robot.limbs != QUADRUPED:
        raise SurefootError(
            f"robot {robot.name}: only quadrupeds of three hinges a leg walk in simulation, this "
            f"one has legs of {', '.join(str(len(chain)) for chain in robot.limbs.chains)} hinges "
            f"and {len(robot.limbs.joints)} joints in all"
        )


def robot_spec(robot: Robot) -> mujoco.MjSpec:
    """The robot with a torque motor on each joint and a touch sensor on each foot, replacing the
    file's.
    """
    refuse_other_legs(robot)
    for joint, limit in zip(robot.joint_names, robot.torque_limit, strict=True):
        if not np.isfinite(limit):
            raise SurefootError(
                f"robot {robot.name}: no torque limit for joint {joint}; give its "
                f"{'limit an effort' if robot.file.suffix == '.urdf' else 'actuator a forcerange'}"
            )
    lever = np.linalg.norm(robot.feet_jacobian_I(robot.q_home[None])[0, ..., 2], axis=1)
    for leg, chain in enumerate(robot.limbs.chains):
        if lever[leg] < WHEEL * robot.leg_length:
            raise SurefootError(
                f"robot {robot.name}: joint {robot.joint_names[chain[2]]} does not move foot "
                f"{LEGS[leg]}, like the axle of a wheel; the last of three hinges must bend the leg"
            )
    spec = robot.spec()
    floor = spec.worldbody.geoms  # of a file that brings a whole scene
    for part in (*spec.sensors, *spec.actuators, *spec.keys, *floor):
        spec.delete(part)
    # With a margin, a sole would float above the ground and roll on too large a radius.
    for geom in spec.geoms:
        geom.margin = geom.gap = 0.0
    for name, joint, limit in zip(JOINTS, robot.joint_names, robot.torque_limit, strict=True):
        motor = spec.add_actuator(
            name=f"torque_{name}",
            target=joint,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            ctrllimited=True,
            ctrlrange=[-limit, limit],
        )
        motor.set_to_motor()
    felt = np.maximum(FELT * robot.foot_reach, LEAST_FELT)
    for leg, body, place, radius in zip(
        LEGS, robot.foot_bodies, robot.foot_places, felt, strict=True
    ):
        site = spec.body(body).add_site(
            name=f"sole_{leg}",
            pos=place,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[radius, 0, 0],
            group=5,
        )
        spec.add_sensor(
            name=f"touch_{leg}",
            type=mujoco.mjtSensor.mjSENS_TOUCH,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=site.name,
        )
    return spec


def add_payload(spec: mujoco.MjSpec, robot: Robot, mass: float) -> None:
    """Put `mass` [kg] on the base, as a small ball at its origin without collisions."""
    # A separate body: if the base's inertia is explicit, its geoms' masses do not count. It is
    # unnamed, so that there may be two.
    spec.body(robot.base_name).add_body().add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[0.05, 0, 0],
        mass=mass,
        contype=0,
        conaffinity=0,
        group=2,
    )


def build_world(robot: Robot, ground: Ground, spec: mujoco.MjSpec | None = None) -> World:
    """Compile the robot (or an edited spec of it), standing on `ground`."""
    scene: mujoco.MjSpec = robot_spec(robot) if spec is None else spec
    # Feet creep on dry ground unless friction is stiff and exact: elliptic cone, high impratio.
    scene.option.gravity = GRAVITY_G
    scene.option.disableflags = scene.option.enableflags = 0
    scene.memory = -1  # what MuJoCo thinks fit: running out of it ends the whole process
    scene.option.timestep = TIMESTEP
    scene.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    scene.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    scene.option.impratio = 100.0
    scene.option.noslip_iterations = 0
    # Models for parallel simulation allow a single iteration, with which robots fall.
    usual = mujoco.MjSpec().option
    for name in ("solver", "iterations", "ls_iterations", "tolerance", "ls_tolerance"):
        setattr(scene.option, name, getattr(usual, name))
    add_ground(scene, ground)
    try:
        model = scene.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = str(error).strip().splitlines()[0]
        raise SurefootError(
            f"robot {robot.name}: MuJoCo cannot build its world: {reason}"
        ) from None
    _refuse_untouching_feet(model, robot)
    joints = [model.joint(name) for name in robot.joint_names]
    qpos_adr = np.array([joint.qposadr[0] for joint in joints])
    start = model.qpos0.copy()
    height_map = ground.height_map
    stand = float(np.max(robot.foot_radius - robot.home_feet_B[:, 2]))
    start[:7] = _standing_pose(height_map, stand)
    start[qpos_adr] = robot.q_home
    return World(
        model=model,
        qpos_adr=qpos_adr,
        dof_adr=np.array([joint.dofadr[0] for joint in joints]),
        touch_adr=np.array([model.sensor(f"touch_{leg}").adr[0] for leg in LEGS]),
        start=start,
        height_map=height_map,
        springs=springs_of(model, robot.joint_names),
        gears=gears_of(model, robot.joint_names),
    )


def _refuse_untouching_feet(model: mujoco.MjModel, robot: Robot) -> None:
    """Raise SurefootError for a foot that would fall through the ground, for example because its
    contacts are only declared as pairs of a scene.
    """
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    touching = set(model.body_weldid[model.geom_bodyid[collides]].tolist())
    for leg, body in zip(LEGS, robot.foot_bodies, strict=True):
        if int(model.body(body).weldid[0]) not in touching:
            raise SurefootError(
                f"robot {robot.name}: no shape of foot {leg} touches the ground: contype and "
                f'conaffinity are 0 on body {body}; give its foot contype="1"'
            )


def _standing_pose(height_map: HeightMap, stand: float) -> np.ndarray:
    """Position and attitude (7,) of a base that stands `stand` [m] above the slope at the
    origin.
    """
    z, slope_x, slope_y = surface(height_map, 0.0, 0.0)
    turn = np.array([-slope_y, slope_x, 0.0])
    steep = np.hypot(slope_x, slope_y)
    half = 0.5 * np.arctan(steep)
    axis = turn / steep if steep else turn
    lifted = z + stand * np.hypot(1.0, steep)
    return np.array([0.0, 0.0, lifted, np.cos(half), *(-np.sin(half) * axis)])
