"""One walk: a scenario, a robot and a seed become a Log."""

from collections.abc import Callable, Sequence
from importlib.metadata import version

import mujoco
import numpy as np
import pandas as pd

from sim.course import Course, lay_course
from sim.effects import Effect
from sim.errors import SurefootError
from sim.gait import Gait, fresh_memory, gait_for, tick
from sim.kinematics import feet
from sim.legs import JOINTS, LEGS
from sim.log import Log, Meta
from sim.quaternion import matrix_from_quaternion, quaternion_from_matrix
from sim.relief import Relief, height, surfaces
from sim.robot import Robot
from sim.scenario import Scenario, drawn
from sim.sensors import Motion, Sensors, Streams, corrupt, ideal_streams, imu_motion
from sim.terrain import Ground
from sim.world import TIMESTEP, World, add_payload, build_world, robot_spec

STEPS_PER_TICK = 2  # the controller runs at 250 Hz
SETTLE = 3.0  # s of standing before the log begins: a robot is switched on at rest


class Fallen(SurefootError):
    """The robot fell; the walk is not a dataset."""


def walk(
    scenario: Scenario,
    robot: Robot,
    seed: int,
    effects: Sequence[Effect] = (),
    declared: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Log:
    """Walk the scenario and record what the robot's sensors say, at 500 Hz.

    Effects act on the simulated world (its MjSpec) or on the sensor streams; with `declared` false
    the log does not mention them. `progress` is told the share that is done. The same seed
    gives the same log, bit for bit. Raises Fallen, saying when, if the robot falls.
    """
    course_rng, sensor_rng = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2)
    )
    draw = drawn(scenario, course_rng)
    ground = draw.scenario.ground
    spec = robot_spec(robot)
    if draw.payload:
        add_payload(spec, robot, draw.payload)
    for effect in effects:
        effect.edit_spec(spec, robot)
    world = build_world(robot, ground, spec)
    course = lay_course(
        draw.scenario.segments,
        TIMESTEP * STEPS_PER_TICK,
        scenario.stand,
        scenario.laps,
        lead=SETTLE,
    )
    if np.abs(course.pose[:, :2]).max() > ground.half_size - robot.leg_length:
        raise SurefootError(
            f"scenario {scenario.name}: the course leaves the floor; "
            "give [ground] a larger half_size"
        )
    gait = gait_for(robot, SETTLE + scenario.stand, draw.period, draw.clearance, draw.gain)
    motion = simulate(world, robot, gait, course, progress).after(SETTLE)
    streams = ideal_streams(motion, robot)
    for effect in effects:
        streams = effect.alter_streams(streams, robot)
    streams = corrupt(streams, scenario.sensors, sensor_rng)
    return Log(
        frame=_frame(streams, motion, robot, scenario.sensors, ground),
        meta=Meta(
            rate=1.0 / TIMESTEP,
            robot=robot.name,
            scenario=scenario.name,
            seed=seed,
            effects=tuple(e.as_dict() for e in effects) if declared else (),
            versions={name: version(name) for name in ("surefoot", "mujoco", "numpy")},
        ),
    )


def simulate(
    world: World,
    robot: Robot,
    gait: Gait,
    course: Course,
    progress: Callable[[float], None] | None = None,
) -> Motion:
    """Step the world under the trot controller through the whole course."""
    model, data = world.model, mujoco.MjData(world.model)
    data.qpos[:] = world.start
    steps = len(course.t) * STEPS_PER_TICK
    qpos, qvel = np.empty((steps + 1, model.nq)), np.empty((steps + 1, model.nv))
    tau, force = np.empty((steps, 12)), np.empty((steps, 4))
    relief, memory = world.relief, fresh_memory()
    torque, load = np.zeros(12), np.full(4, gait.mass * 9.81 / 4)
    target = np.column_stack([course.pose, course.velocity])
    for k in range(steps):
        qpos[k], qvel[k] = data.qpos, data.qvel
        if k % STEPS_PER_TICK == 0:
            i = k // STEPS_PER_TICK
            R = matrix_of(data.qpos[3:7])
            tick(
                robot.legs, gait, relief, memory, course.t[i], data.qpos[:3].copy(), R,
                data.qvel[:3].copy(), data.qvel[3:6].copy(), data.qpos[world.qpos_adr],
                data.qvel[world.dof_adr], load, target[i], torque,
            )  # fmt: skip
            data.ctrl[:] = torque
            if has_fallen(gait, relief, data.qpos[:3], R):
                raise Fallen(
                    f"robot {robot.name} fell at {course.t[i]:.2f} s of {course.t[-1]:.0f} s"
                )
            if progress and i % 250 == 0:
                progress(k / steps)
        mujoco.mj_step(model, data)
        load = data.sensordata[world.touch_adr]
        tau[k], force[k] = data.actuator_force, load
    qpos[steps], qvel[steps] = data.qpos, data.qvel
    if progress:
        progress(1.0)
    R_GB = matrix_from_quaternion(qpos[:, 3:7])
    return Motion(
        t=np.arange(steps + 1) * TIMESTEP,
        p_GB=qpos[:, :3],
        R_GB=R_GB,
        v_GB=qvel[:, :3],
        w_B=qvel[:, 3:6],
        q=qpos[:, world.qpos_adr],
        dq=qvel[:, world.dof_adr],
        tau=tau,
        force=force,
    )


def has_fallen(gait: Gait, relief: Relief, p: np.ndarray, R: np.ndarray) -> bool:
    """Tilted by more than 60 degrees, or low: base at p (3,) [m] with attitude R (3, 3)."""
    return R[2, 2] < 0.5 or p[2] - height(relief, p[0], p[1]) < 0.4 * gait.height


def matrix_of(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix of one quaternion, by MuJoCo: this runs in the control loop."""
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, quaternion)
    return R.reshape(3, 3)


def _frame(
    streams: Streams, motion: Motion, robot: Robot, sensors: Sensors, ground: Ground
) -> pd.DataFrame:
    R_GI, p_GI, v_GI = imu_motion(motion, robot)
    slip, mu = foot_truth(motion, robot, ground)
    threshold = sensors.contact_threshold * robot.mass * 9.81
    groups = {
        "t": streams.t[:, None],
        "gyro": streams.gyro,
        "accel": streams.accel,
        "q": streams.q,
        "dq": streams.dq,
        "tau": streams.tau,
        "contact": (streams.force > threshold).astype(float),
        "force": streams.force,
        "ref_p": p_GI[1:],
        "ref_q": quaternion_from_matrix(R_GI[1:]),
        "ref_v": v_GI[1:],
        "slip": slip,
        "mu": mu,
    }
    suffixes = {"t": [""], "ref_q": ["_w", "_x", "_y", "_z"]}
    by_width = {
        3: ["_x", "_y", "_z"],
        12: [f"_{j}" for j in JOINTS],
        4: [f"_{leg}" for leg in LEGS],
    }
    return pd.DataFrame(
        {
            name + suffix: values[:, i]
            for name, values in groups.items()
            for i, suffix in enumerate(suffixes.get(name, by_width.get(values.shape[1], [])))
        }
    )


def foot_truth(motion: Motion, robot: Robot, ground: Ground) -> tuple[np.ndarray, np.ndarray]:
    """Per row and leg: speed of the loaded foot's contact point over the ground [m/s], and mu.

    A rolling foot does not slip: the speed is that of its contact point, not of its centre.
    """
    foot_B, jacobian, axes = feet(robot.legs, motion.q[1:], np.eye(3), np.zeros(3))
    R = motion.R_GB[1:]
    dq = motion.dq[1:].reshape(-1, 4, 3)
    w_foot_B = motion.w_B[1:, None] + np.einsum("nlij,nlj->nli", axes, dq)
    v_foot_B = np.cross(motion.w_B[1:, None], foot_B) + np.einsum("nlij,nlj->nli", jacobian, dq)
    v_centre = motion.v_GB[1:, None] + np.einsum("nij,nlj->nli", R, v_foot_B)
    place = motion.p_GB[1:, None] + np.einsum("nij,nlj->nli", R, foot_B)
    normals = surfaces(ground.relief, place[..., 0].ravel(), place[..., 1].ravel())[1]
    normals = normals.reshape(place.shape)
    # The contact point lies below the centre along the ground's normal, not along gravity.
    sole = -robot.foot_radius[:, None] * normals
    v_sole = v_centre + np.cross(np.einsum("nij,nlj->nli", R, w_foot_B), sole)
    v_sole -= np.einsum("nlj,nlj->nl", v_sole, normals)[..., None] * normals
    loaded = motion.force > 0.02 * robot.mass * 9.81
    slip = np.where(loaded, np.linalg.norm(v_sole, axis=-1), 0.0)
    touching = place + sole
    return slip, ground.friction(touching[..., 0], touching[..., 1])
