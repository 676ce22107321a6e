"""Simulation of one walk: from a scenario, a robot and a seed to a Log."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib.metadata import version

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.limits import check_limit
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.effects import Effect
from surefoot.sim.gait.controller import gait_for
from surefoot.sim.gait.course import Course, Stretch, course_pieces, integrate_course, stretches
from surefoot.sim.gait.irregular import irregular
from surefoot.sim.gait.state import Gait
from surefoot.sim.ground.ground_metadata import ground_metadata
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log, Meta
from surefoot.sim.log.schema import group_columns
from surefoot.sim.physics.drives import share_moved_at_once
from surefoot.sim.physics.foot_truth import foot_truth
from surefoot.sim.physics.scene import TIMESTEP, World, add_payload, build_world, robot_spec
from surefoot.sim.physics.stepper import STEPS_PER_TICK, TICK, Fallen, simulate_motion
from surefoot.sim.robot import Robot
from surefoot.sim.robot.catalog import model_metadata
from surefoot.sim.robot.legs import JOINTS, LEGS, find_legs
from surefoot.sim.scenario import DrawnScenario, Scenario, drawn
from surefoot.sim.sensors.streams import (
    Motion,
    Reference,
    SensorErrors,
    Streams,
    ideal_streams,
    reference_of,
    sampled,
)
from surefoot.sim.similar_course import course_for

__all__ = ["STEPS_PER_TICK", "Fallen", "Plan", "plan", "record", "simulate_motion", "walk"]

SETTLING_TIME = 3.0  # s of standing before the log begins: a robot is switched on at rest
BYTES_A_STEP = 3e3
"""Memory per time step [bytes]: states, readings and truth of a walk, and their copies."""
PIECE_TICKS = 1 << 13
"""Controller ticks in a piece of a long walk: half a minute, 50 MB."""
SHORTEST_WALK = 0.1
"""Shortest log that is kept of a fall [s]."""
SLIDE_MARGIN = 2.0
"""Factor by which the damping of a sliding foot may exceed that for a rigid leg, because of the
inertia that the motor moves at once. A damper of rate r, updated each tick T, is stable for
r T < 1; for rigid legs it is 0.3.
"""


@dataclass(frozen=True)
class Plan:
    """Everything that scenario, robot, seed and effects determine before the first step."""

    scenario: Scenario  # as written, at the size of the robot; `draw` holds it as drawn
    robot: Robot
    seed: int
    effects: tuple[Effect, ...]
    declared: bool
    draw: DrawnScenario
    commands: Sequence[Stretch]  # from settling to the end
    ground: Ground  # as drawn, under the effects
    world: World
    gait: Gait
    sensor_seed: np.random.SeedSequence

    @cached_property
    def course(self) -> Course:
        """The whole course, one row per tick.

        Raises SurefootError if a walk along it does not fit into memory.
        """
        what = f"scenario {self.scenario.name}: bytes of a walk of {self.seconds:.0f} s"
        check_limit("memory", BYTES_A_STEP * self.seconds / TIMESTEP, what)
        return integrate_course(self.commands, TICK)

    @property
    def ticks(self) -> int:
        """Number of controller ticks, from settling to the end."""
        return sum(count for count, _ in self.commands)

    @property
    def seconds(self) -> float:
        """Duration of the walk, settling included [s]."""
        return self.ticks * TICK


def walk(
    scenario: Scenario,
    robot: Robot,
    seed: int,
    effects: Sequence[Effect] = (),
    declared: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Log:
    """Simulate a walk and record the robot's sensors at 500 Hz.

    Args:
        scenario: course, ground and sensors; one for another robot is scaled to this one's legs
            (`surefoot.sim.similar_course`).
        robot: that walks.
        seed: of all random draws; the same seed gives the same log, bit for bit.
        effects: injected into the simulated world (its MjSpec) or the sensor streams.
        declared: whether the log's metadata list the effects.
        progress: called with the share done.

    Raises Fallen, with time, place and reason, if the robot falls; `fallen_log` is the walk until
    then.
    """
    return walk_planned(plan(scenario, robot, seed, effects, declared), progress)


def walk_planned(made: Plan, progress: Callable[[float], None] | None = None) -> Log:
    """Simulate and record a walk along its plan, as `walk` does."""
    motion = simulate_motion(made.world, made.robot, made.gait, made.course, progress)
    return record(made, motion)


def plan(
    scenario: Scenario,
    robot: Robot,
    seed: int,
    effects: Sequence[Effect] = (),
    declared: bool = True,
) -> Plan:
    """Make the seed's random draws, compile the world and compute the course.

    Args:
        scenario: ground, segments and ranges.
        robot: its declared description.
        seed: of all random draws.
        effects: changes of robot, ground and sensors.
        declared: whether the log's metadata list the effects.
    """
    if scenario.sensors.rate > 1.0 / TIMESTEP:
        raise SurefootError(
            f"scenario {scenario.name}: [sensors] rate must not exceed {1.0 / TIMESTEP:g} Hz, the "
            f"simulation's own, is {scenario.sensors.rate:g}"
        )
    course_seed, sensor_seed, gait_seed = np.random.SeedSequence(seed).spawn(3)
    scenario = course_for(scenario, robot)
    draw = drawn(scenario, np.random.default_rng(course_seed))
    ground = draw.scenario.ground
    spec = robot_spec(robot)
    if draw.payload:
        add_payload(spec, robot, draw.payload)
    for effect in effects:
        effect.members(robot.limbs)  # refuses a target that the robot does not have
        effect.edit_spec(spec, robot)
        ground = effect.alter_ground(ground)
    segments = draw.scenario.segments
    commands = stretches(segments, TICK, scenario.stand, scenario.laps, SETTLING_TIME)
    ticks = sum(count for count, _ in commands)
    for piece in course_pieces(commands, TICK, min(ticks, PIECE_TICKS)):
        if np.abs(piece.pose[:, :2]).max() > ground.half_size - robot.leg_length:
            raise SurefootError(
                f"scenario {scenario.name}: the course leaves the floor; "
                "give [ground] a larger half_size"
            )
    world = build_world(robot, ground, spec)
    start = SETTLING_TIME + scenario.stand
    # The controller places feet with their actual radius, since it senses the ground below them.
    radius = find_legs(world.model, robot.name).foot_radius
    same = np.array_equal(radius, robot.foot_radius)  # keeps the inertia that it has computed
    standing_on = robot if same else replace(robot, foot_radius=radius)
    gait = gait_for(standing_on, start, draw.period, draw.clearance, draw.gain, scenario.gait)
    at_once = share_moved_at_once(world.model, world.springs, world.start, world.dof_adr)
    gait = gait._replace(slide_damping=min(SLIDE_MARGIN * at_once, 1.0) * gait.slide_damping)
    gait = irregular(gait, scenario.gait, ticks, TICK, np.random.default_rng(gait_seed))
    return Plan(
        scenario=scenario,
        robot=robot,
        seed=seed,
        effects=tuple(effects),
        declared=declared,
        draw=draw,
        commands=commands,
        ground=ground,
        world=world,
        gait=gait,
        sensor_seed=sensor_seed,
    )


def record(made: Plan, motion: Motion) -> Log:
    """Record the sensors along a motion in the planned world, from the end of settling on."""
    motion = motion.after(SETTLING_TIME)
    frame = Sensing(made, len(motion.tau)).of(motion)
    meta, sensors = meta_of(made), made.scenario.sensors
    if meta.rate < 1.0 / TIMESTEP:
        frame = sampled(frame, meta.rate, averages=not sensors.imu_bandwidth)
    return Log(frame=frame, meta=meta)


class Sensing:
    """The sensors of a planned walk, whose motion may come in pieces.

    The readings do not depend on the pieces, except with effects that alter streams, which need the
    whole walk at once.
    """

    def __init__(self, made: Plan, rows: int):
        """`rows`: of the whole log, before resampling."""
        self._made, robot = made, made.robot
        self._mounted = robot
        for effect in made.effects:
            self._mounted = effect.alter_mounting(self._mounted)
        self._sensors, rng = made.scenario.sensors, np.random.default_rng(made.sensor_seed)
        shape, weight = (rows, len(JOINTS), len(LEGS)), robot.mass * GRAVITY
        rate = 1.0 / TIMESTEP
        self._errors = SensorErrors(self._sensors, rng, shape, rate, weight)
        # With the legs and soles of the simulated world, effects included, for the truth.
        tree = find_legs(made.world.model, robot.name)
        self._as_simulated = replace(robot, legs=tree.constants, foot_radius=tree.foot_radius)

    def of(self, motion: Motion) -> pd.DataFrame:
        """The next rows, for the steps between the states of a motion."""
        robot, effects = self._made.robot, self._made.effects
        reference = reference_of(motion, robot)
        for effect in effects:
            reference = effect.alter_reference(reference)
        streams = ideal_streams(motion, self._mounted)
        streams = replace(streams, contact_threshold=self._sensors.contact_threshold)
        for effect in effects:
            streams = effect.alter_streams(streams, robot)
        streams, contact = self._errors.apply(streams)
        truth = foot_truth(motion, self._as_simulated, self._made.ground)
        return _frame(streams, contact, reference, *truth)


def meta_of(made: Plan) -> Meta:
    """Metadata of the log of a planned walk."""
    robot = made.robot
    return Meta(
        rate=made.scenario.sensors.rate or 1.0 / TIMESTEP,
        robot=robot.name,
        scenario=made.scenario.name,
        seed=made.seed,
        effects=tuple(e.as_dict() for e in made.effects) if made.declared else (),
        versions=dict(_versions()),
        model=model_metadata(robot.name, robot.file) | ground_metadata(made.ground),
    )


def fallen_log(made: Plan, fall: Fallen) -> Log | None:
    """The log of a walk until its fall; None if it fell before its log began."""
    motion = fall.motion
    enough = motion is not None and len(motion.t) and motion.t[-1] > SETTLING_TIME + SHORTEST_WALK
    return record(made, motion) if motion is not None and enough else None


@cache
def _versions() -> dict[str, str]:
    return {name: version(name) for name in ("surefoot", "mujoco", "numpy")}


def _frame(
    streams: Streams, contact: np.ndarray, reference: Reference, slip: np.ndarray, mu: np.ndarray
) -> pd.DataFrame:
    """The columns of a simulated log.

    Args:
        streams: sensor readings of N rows.
        contact: (N, L) bool.
        reference: motion of the IMU in G.
        slip: speed of loaded feet over the ground (N, L) [m/s].
        mu: friction under each foot (N, L).
    """
    groups = {
        "imu": (streams.gyro, streams.accel),
        "q": (streams.q,),
        "dq": (streams.dq,),
        "tau": (streams.tau,),
        "tau_ff": (streams.tau_ff,),
        "contact": (contact.astype(float),),
        "force": (streams.force,),
        "reference": (reference.p_GI, quaternion_from_matrix(reference.R_GI)),
        "ref_v": (reference.v_GI,),
        "truth": (slip, mu),
    }
    columns = {"t": streams.t}
    for group, parts in groups.items():
        names = group_columns(group, JOINTS, LEGS)
        columns |= zip(names, np.hstack(parts).T, strict=True)
    return pd.DataFrame(columns)
