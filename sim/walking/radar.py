"""A simulated 4-D radar on a walk: rays into the scenario's ground, a Doppler for each return.

A log has no columns for returns, which vary in number and are hidden from proprioceptive filters.
They are computed on demand from a simulated log's reference motion, its scenario and its seed, with
the same result each time. Only the ground of the course reflects, with its steps and slopes; a real
radar also sees walls, furniture and people. A frame is a snapshot at a row of the log, and the
robot's own legs are not in view.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError, check_within, errors_in
from surefoot.sim.common.series import rows_every
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.ground.tiles import add_ground
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, drawn
from surefoot.sim.similar_course import course_for


@dataclass(frozen=True)
class RadarSensor:
    """A single-chip radar, in SI units and radians.

    Frame period, range and Doppler: TI, People Tracking and Counting Reference Design Using mmWave
    Radar Sensor (IWR6843), TIDUE71D, table 2: 8.1 m, 8.4 cm, 16.2 km/h, 0.324 km/h, 55 ms. Field of
    view and resolution of angles: TI Radar Toolbox 2.0, reference designs overview, the design
    with two-dimensional angles: +-60 and +-60 degrees, 19 and 58 degrees. The following were
    chosen: angle errors of a tenth of the resolution, the Doppler noise beyond quantisation, the
    rays of a frame (tens of returns are usual), the share detected, the share of ghosts and their
    Dopplers, and the mounting, between the front hips and tilted down by 15 degrees towards the
    floor.
    """

    period: float = 0.055  # s
    azimuth: float = np.radians(60.0)  # half the field of view
    elevation: float = np.radians(60.0)
    shortest: float = 0.25  # m
    longest: float = 8.1  # m
    range_step: float = 0.084  # m
    doppler_step: float = 0.09  # m/s
    doppler_range: float = 4.5  # m/s, beyond which it wraps
    doppler_noise: float = 0.02  # m/s
    azimuth_noise: float = np.radians(1.9)
    elevation_noise: float = np.radians(5.8)
    rays: int = 64  # a frame
    detected: float = 0.7  # share of rays that hit something
    ghosts: float = 0.2  # share of returns
    ghost_doppler: float = 2.0  # m/s, largest
    tilt: float = np.radians(15.0)  # downwards

    def __post_init__(self):
        with errors_in("radar"):
            check_within(vars(self), {})


@dataclass(frozen=True)
class Radar:
    """Returns of F frames, n in all.

    rows (F,): row of the log at which each frame was taken; frame (n,): index of a return's frame,
    ascending; direction_R (n, 3) unit, in the radar's axes (x along the beam, y left, z up); range
    (n,) [m]; doppler (n,) [m/s], the range's rate; p_IR (3,) [m] and R_IR (3, 3) the sensor in I.
    """

    rows: np.ndarray
    frame: np.ndarray
    direction_R: np.ndarray
    range: np.ndarray
    doppler: np.ndarray
    p_IR: np.ndarray
    R_IR: np.ndarray


def radar(log: Log, scenario: Scenario, robot: Robot, sensor: RadarSensor | None = None) -> Radar:
    """Returns of a radar on the robot during a simulated log.

    The ground is the scenario's as the log's seed drew it; the radar's own noise comes from the
    same seed. Raises SurefootError where the log has no seed, its reference is missing or valid
    nowhere, or it is of another scenario.
    """
    sensor = sensor or RadarSensor()
    log.require("reference")
    if log.meta.seed is None or log.meta.scenario != scenario.name:
        raise SurefootError(
            f"radar: the log is of scenario {log.meta.scenario} and seed {log.meta.seed}, "
            f"not of {scenario.name}"
        )
    seed = log.meta.seed
    course_seed = np.random.SeedSequence(seed).spawn(1)[0]
    ground = drawn(course_for(scenario, robot), np.random.default_rng(course_seed)).scenario.ground
    return radar_over(log, ground, robot, sensor, np.random.default_rng([seed, 77]))


def radar_over(
    log: Log, ground: Ground, robot: Robot, sensor: RadarSensor, rng: np.random.Generator
) -> Radar:
    """The returns over a given ground. Raises SurefootError where the reference is valid nowhere.

    Args:
        log: with its reference.
        ground: below it.
        robot: that carries the sensor.
        sensor: mounting, field of view and noise.
        rng: draws rays and noise.
    """
    spec = mujoco.MjSpec()
    add_ground(spec, ground)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    p_IR, R_IR = mounting(robot, sensor)
    rows = rows_every(log.t, sensor.period)
    rows = rows[log.ref_ok[rows] > 0]
    if not len(rows):
        raise SurefootError(f"{log.name}: ref_ok is 0 at every frame of the simulated radar")
    R_GI = log.ref_R_GI
    place = log.ref_p + R_GI @ p_IR
    v_G = log.ref_v + np.gradient(R_GI @ p_IR, log.t, axis=0)
    parts = []
    for k, row in enumerate(rows):
        azimuth = rng.uniform(-sensor.azimuth, sensor.azimuth, sensor.rays)
        elevation = rng.uniform(-sensor.elevation, sensor.elevation, sensor.rays)
        R_GR = R_GI[row] @ R_IR
        u_G = _unit(azimuth, elevation) @ R_GR.T
        distance = _distances(model, data, place[row], u_G, sensor.longest)
        hit = (distance >= sensor.shortest) & (distance <= sensor.longest)
        hit &= rng.random(sensor.rays) < sensor.detected
        count = int(hit.sum())
        doppler = -u_G[hit] @ v_G[row] + sensor.doppler_noise * rng.standard_normal(count)
        ghost = rng.random(count) < sensor.ghosts
        doppler[ghost] = rng.uniform(-sensor.ghost_doppler, sensor.ghost_doppler, ghost.sum())
        seen = _unit(
            azimuth[hit] + sensor.azimuth_noise * rng.standard_normal(count),
            elevation[hit] + sensor.elevation_noise * rng.standard_normal(count),
        )
        parts.append((np.full(count, k), seen, distance[hit], doppler))
    frame, direction, distance, doppler = (np.concatenate(p) for p in zip(*parts, strict=True))
    wrap = 2.0 * sensor.doppler_range
    doppler = (doppler + sensor.doppler_range) % wrap - sensor.doppler_range
    distance = _stepped(distance, sensor.range_step)
    doppler = _stepped(doppler, sensor.doppler_step)
    return Radar(rows, frame, direction, distance, doppler, p_IR, R_IR)


def mounting(robot: Robot, sensor: RadarSensor) -> tuple[np.ndarray, np.ndarray]:
    """p_IR (3,) [m] and R_IR (3, 3) of the radar: x along its beam, y left, z up."""
    p_BR = np.array([robot.home_feet_B[:2, 0].mean(), 0.0, 0.0])
    c, s = np.cos(sensor.tilt), np.sin(sensor.tilt)
    R_BR = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return robot.R_BI.T @ (p_BR - robot.p_BI), robot.R_BI.T @ R_BR


def _unit(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Directions (n, 3) in the radar's axes."""
    flat = np.cos(elevation)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def _distances(model, data, place, directions, longest: float) -> np.ndarray:
    """Distance (n,) [m] to the ground along each direction, inf where there is none.

    Args:
        model: MuJoCo's model of the ground.
        data: its data.
        place: (3,) [m], the sensor in G.
        directions: (n, 3), unit vectors in G.
        longest: range [m].
    """
    n = len(directions)
    distance, geom = np.empty(n), np.empty(n, dtype=np.int32)
    mujoco.mj_multiRay(
        m=model,
        d=data,
        pnt=place,
        vec=directions.ravel(),
        geomgroup=None,
        flg_static=True,
        bodyexclude=-1,
        geomid=geom,
        dist=distance,
        normal=None,
        nray=n,
        cutoff=longest + 1.0,
    )
    return np.where(geom >= 0, distance, np.inf)


def _stepped(x: np.ndarray, step: float) -> np.ndarray:
    return np.round(x / step) * step if step > 0 else x
