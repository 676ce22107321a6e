"""A whole walk as one compiled loop of MuJoCo's step and the controller, without the GIL.

The loop does not call Python, so walks on threads do not wait for each other; a walk computes the
same bits alone or beside others. `mj_step` is called by its address in the library that the mujoco
package has loaded, on the memory of its own MjModel and MjData.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.copies import copy_row
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import kernel, mujoco_function
from surefoot.sim.common.quaternion import matrix_from_quaternion
from surefoot.sim.gait.controller import Controller, tick
from surefoot.sim.gait.course import Course
from surefoot.sim.gait.irregular import estimated_base
from surefoot.sim.gait.state import Gait, LegMemory, RobotState, standing
from surefoot.sim.ground.height_map import HeightMap, height
from surefoot.sim.physics.drives import Gears
from surefoot.sim.physics.scene import TIMESTEP, World
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import BaseMotion
from surefoot.sim.sensors.streams import Motion, SpringDeflection

STEPS_PER_TICK = 2  # the controller runs at 250 Hz
TICK = TIMESTEP * STEPS_PER_TICK  # s
UPRIGHT = 0.5  # cosine of the tilt from which a robot has fallen
TICKS_AT_ONCE = 250  # between looks at the clock, the progress bar and Ctrl-C


class Fallen(SurefootError):
    """The robot fell at `time` [s] of the simulation.

    `how` describes where and why; `motion` is the motion until then.
    """

    def __init__(
        self, message: str, time: float = 0.0, how: str = "", motion: Motion | None = None
    ):
        super().__init__(message)
        self.time, self.how, self.motion = time, how, motion


_mj_step = mujoco_function("mj_step")


class MjViews(NamedTuple):
    """A robot in MuJoCo's memory: addresses of MjModel and MjData, and views of their arrays."""

    model: int
    data: int
    qpos: np.ndarray  # (nq,)
    qvel: np.ndarray  # (nv,)
    ctrl: np.ndarray  # (12,) N m
    sensordata: np.ndarray
    actuator_force: np.ndarray  # (12,) N m
    qpos_adr: np.ndarray  # (12,)
    dof_adr: np.ndarray  # (12,)
    touch_adr: np.ndarray  # (4,)
    friction: np.ndarray  # (nv,) N m, dry
    gears: Gears
    unstable: np.ndarray  # counts of MuJoCo's warnings


class Recording(NamedTuple):
    """Record of a walk: states at successive time steps, and the inputs between them."""

    qpos: np.ndarray  # (N + 1, nq)
    qvel: np.ndarray  # (N + 1, nv)
    tau: np.ndarray  # (N, 12) N m, as the motors gave it
    command: np.ndarray  # (N, 12) N m, as the controller asked for it
    force: np.ndarray  # (N, 4) N, as the touch sensors feel it


def mj_views(world: World, data: mujoco.MjData) -> MjViews:
    """Views of `data`, which must outlive them."""
    return MjViews(
        model=world.model._address,
        data=data._address,
        qpos=data.qpos,
        qvel=data.qvel,
        ctrl=data.ctrl,
        sensordata=data.sensordata,
        actuator_force=data.actuator_force,
        qpos_adr=world.qpos_adr,
        dof_adr=world.dof_adr,
        touch_adr=world.touch_adr,
        friction=world.model.dof_frictionloss,
        gears=world.gears,
        unstable=data.warning.number,
    )


def recording_of(world: World, steps: int) -> Recording:
    """An empty recording of `steps` steps."""
    nq, nv = world.model.nq, world.model.nv
    return Recording(
        qpos=np.empty((steps + 1, nq)),
        qvel=np.empty((steps + 1, nv)),
        tau=np.empty((steps, len(world.dof_adr))),
        command=np.empty((steps, len(world.dof_adr))),
        force=np.empty((steps, len(world.touch_adr))),
    )


def first_steps(trace: Recording, steps: int) -> Recording:
    """The first steps of a recording."""
    states = (part[: steps + 1] for part in (trace.qpos, trace.qvel))
    return Recording(*states, *(part[:steps] for part in trace[2:]))


class Walker(NamedTuple):
    """A robot under the trot controller, in a world.

    Attributes:
        world: compiled model of robot and ground.
        robot: its declared description.
        gait: of the controller.
        data: state of the simulation.
        memory: of the controller between ticks.
        load: normal forces on the feet (4,) at the last tick [N].
    """

    world: World
    robot: Robot
    gait: Gait
    data: mujoco.MjData
    memory: LegMemory
    load: np.ndarray


def at_rest(world: World, robot: Robot, gait: Gait, data: mujoco.MjData) -> Walker:
    """A robot that stands at the origin of its world, in the memory `data`, which is reset."""
    mujoco.mj_resetData(world.model, data)
    data.qpos[:] = world.start
    return Walker(world, robot, gait, data, standing(), np.full(4, gait.mass * GRAVITY / 4))


def simulate_motion(
    world: World,
    robot: Robot,
    gait: Gait,
    course: Course,
    progress: Callable[[float], None] | None = None,
) -> Motion:
    """Step the world under the trot controller through the whole course.

    Raises Fallen, saying when, if the robot falls.

    Args:
        world: compiled model of robot and ground.
        robot: its declared description.
        gait: of the trot controller.
        course: commanded poses and velocities, one row per tick.
        progress: called with the share done.
    """
    trace = recording_of(world, len(course.t) * STEPS_PER_TICK)
    walker = at_rest(world, robot, gait, mujoco.MjData(world.model))
    trot(walker, course, trace, progress=progress)
    return motion_of(world, trace)


def simulate_in_pieces(
    world: World, robot: Robot, gait: Gait, pieces: Iterable[Course], seconds: float
) -> Iterator[Motion]:
    """`simulate_motion` along a course that comes in pieces.

    Yields the motion of each piece, whose first state is the last one of the piece before. The
    motion until a fall is yielded before the error. Raises Fallen, without a motion, if the robot
    falls.

    Args:
        world, robot, gait: as for `simulate_motion`; the gait may not have errors of its estimate,
            which are drawn for a whole walk.
        pieces: of the course.
        seconds: until its end.
    """
    walker, first = at_rest(world, robot, gait, mujoco.MjData(world.model)), 0
    for course in pieces:
        trace = recording_of(world, len(course.t) * STEPS_PER_TICK)
        try:
            trot(walker, course, trace, seconds)
        except Fallen as fall:
            walked = len(fall.motion.tau) if fall.motion else 0
            yield motion_of(world, first_steps(trace, walked), first)
            raise Fallen(str(fall), fall.time, fall.how) from None
        yield motion_of(world, trace, first)
        first += len(trace.tau)


def trot(
    walker: Walker,
    course: Course,
    trace: Recording,
    seconds: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Walk along the course.

    Raises Fallen, saying when, if the robot falls.

    Args:
        walker: whose state and memory are changed.
        course: the reference motion of the base.
        trace: written, from its first row on.
        seconds: until the end of the whole course, if this is a piece of it.
        progress: called with the share done.
    """
    world, robot, gait, data, memory, load = walker
    ticks, target = len(course.t), np.column_stack([course.pose, course.velocity])
    controller = Controller(gait, world.height_map, memory)
    body = mj_views(world, data)
    for first in range(0, ticks, TICKS_AT_ONCE):
        last = min(first + TICKS_AT_ONCE, ticks)
        fell = _stepper(body, robot.legs, controller, load, course.t, target, trace, (first, last))
        if fell >= 0:
            t, how = float(course.t[fell]), _how_it_fell(body, gait, world.height_map)
            end = course.t[-1] if seconds is None else seconds
            words = f"robot {robot.name} fell at {t:.2f} s of {end:.0f} s, {how}"
            walked = first_steps(trace, fell * STEPS_PER_TICK)
            raise Fallen(words, t, how, motion_of(world, walked))
        if progress:
            progress(last / ticks)


@kernel(nogil=True)
def _stepper(body, legs, controller, load, t, target, trace, ticks):
    """Run some control ticks; returns the one at which the robot fell, or -1.

    Args:
        body: MjViews.
        legs: the robot's Legs.
        controller: a Controller.
        load: (4,) N, normal foot forces, kept between ticks.
        t, target: (N,) s and (N, 6) of the course, as for `tick`.
        trace: a Recording, written.
        ticks: first, and the one after the last.
    """
    first, last = ticks
    qpos, qvel = body.qpos, body.qvel
    q, dq, torque = np.empty(12), np.empty(12), np.zeros(12)
    k = first * STEPS_PER_TICK
    for i in range(first, last):
        R = rotation(qpos[3], qpos[4], qpos[5], qpos[6])
        for j in range(12):
            q[j], dq[j] = qpos[body.qpos_adr[j]], qvel[body.dof_adr[j]]
        if has_fallen(controller.gait, controller.height_map, qpos, R) or body.unstable.any():
            return i
        base = BaseMotion(qpos[:3].copy(), R, qvel[:3].copy(), qvel[3:6].copy())
        base = estimated_base(controller.gait, base, i)
        tick(legs, controller, RobotState(t[i], base, q, dq, load), target[i], torque)
        copy_row(torque, body.ctrl)
        for _ in range(STEPS_PER_TICK):
            step(body, trace, k)
            k += 1
        copy_row(trace.force[k - 1], load)
    return -1


@kernel(nogil=True)
def step(body, trace, k):
    """One time step of MuJoCo, recorded as the k-th."""
    copy_row(body.qpos, trace.qpos[k])
    copy_row(body.qvel, trace.qvel[k])
    copy_row(body.ctrl, trace.command[k])
    for j in range(12):
        if body.gears.share[j] > 0.0:
            lost = body.gears.share[j] * abs(body.ctrl[j])
            body.friction[body.dof_adr[j]] = body.gears.dry[j] + lost
    _mj_step(body.model, body.data)
    copy_row(body.actuator_force, trace.tau[k])
    for leg in range(4):
        trace.force[k, leg] = body.sensordata[body.touch_adr[leg]]
    copy_row(body.qpos, trace.qpos[k + 1])
    copy_row(body.qvel, trace.qvel[k + 1])


@kernel(nogil=True)
def rotation(w, x, y, z):
    """Rotation matrix (3, 3) of a unit quaternion."""
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return R


@kernel(nogil=True)
def has_fallen(gait, height_map, p, R):
    """Whether the base at p (3,) [m] with attitude R (3, 3) is tilted by more than 60 degrees, or
    low.
    """
    return R[2, 2] < UPRIGHT or p[2] - height(height_map, p[0], p[1]) < 0.4 * gait.height


def _how_it_fell(body: MjViews, gait: Gait, height_map: HeightMap) -> str:
    """Describe where and why the robot fell."""
    x, y, z = body.qpos[:3]
    where = f"at ({x:.1f}, {y:.1f}) m: "
    if body.unstable.any():
        return where + "the simulation became unstable"
    upright, above = rotation(*body.qpos[3:7])[2, 2], z - height(height_map, x, y)
    if upright < UPRIGHT:
        tilt = np.rad2deg(np.arccos(max(upright, -1.0)))
        return where + f"the base tilted by {tilt:.0f} degrees"
    return where + f"the base sank to {above:.2f} m, of {gait.height:.2f} m when it stands"


def at_time_of_rates(qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """Positions (N, nq) of a robot with hinges and slides, half a time step before those of the
    simulation, which are qpos (N, nq) with the rates qvel (N, nv).

    MuJoCo steps positions by the rates at the end of a step (semi-implicit Euler). Taken at the
    same time, positions are half a step ahead of the rates: each change of position is then that
    of the later rate instead of the mean of both. A log with such rows has a delay between its
    reference and its accelerometer, and between angles and their rates, that no robot has.
    """
    back = -0.5 * TIMESTEP
    turn = Rotation.from_rotvec(back * qvel[:, 3:6])
    turned = Rotation.from_quat(qpos[:, 3:7], scalar_first=True) * turn
    p, joints = qpos[:, :3] + back * qvel[:, :3], qpos[:, 7:] + back * qvel[:, 6:]
    return np.column_stack([p, turned.as_quat(scalar_first=True), joints])


def motion_of(world: World, trace: Recording, first: int = 0) -> Motion:
    """Convert recorded states to a motion of the base and the joints in canonical order.

    `first` is the index of the first state in the walk.
    """
    qpos, qvel, springs = at_time_of_rates(trace.qpos, trace.qvel), trace.qvel, world.springs
    give = None
    if springs.any():
        # A free base has one more element in qpos than in qvel.
        q, dq, foot, foot_rate = (
            states[:, at + more] * (at >= 0)
            for at in (springs.joints, springs.feet)
            for states, more in ((qpos, 1), (qvel, 0))
        )
        on_link = [np.einsum("lij,nlj->nli", springs.axes, x) for x in (foot, foot_rate)]
        give = SpringDeflection(q, dq, *on_link)
    return Motion(
        t=np.arange(first, first + len(qpos)) * TIMESTEP,
        p_GB=qpos[:, :3],
        R_GB=matrix_from_quaternion(qpos[:, 3:7]),
        v_GB=qvel[:, :3],
        w_B=qvel[:, 3:6],
        q=qpos[:, world.qpos_adr],
        dq=qvel[:, world.dof_adr],
        tau=trace.tau,
        command=trace.command,
        force=trace.force,
        give=give,
    )
