"""The radar of a simulated walk as velocities for a filter: what the perceptive reference sees."""

from functools import cache
from pathlib import Path

import numpy as np

from surefoot.estimator.ego_velocity import ego_velocities
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walking.radar import RadarSensor, radar

FOLDERS = ("demo", "spot", "vision60", "shift")
DOPPLER = 0.06
"""m/s, a return's error as the estimator takes it: step, noise and what a wrong direction does."""


def radar_velocity(log: Log, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """rows (M,) of the log, the IMU's velocity v_I (M, 3) [m/s] there, and covariances (M, 3, 3).

    What is left of the directions' pull lasts (about 1 % of the speed), and a filter that takes
    frames for independent would trust it: `radar` of tuned.toml multiplies the covariances.

    Raises SurefootError where there is no world for a radar to see: the log is measured, or of a
    scenario that is not among the bundled ones.
    """
    if not log.meta.scenario or log.meta.seed is None or log.meta.scenario not in _scenarios():
        raise SurefootError("needs the world of a bundled scenario for its radar (perceptive)")
    sensor = RadarSensor()
    seen = radar(log, Scenario.load(_scenarios()[log.meta.scenario]), robot, sensor)
    frames, velocity, cov = ego_velocities(
        seen.frame, seen.direction_R, seen.doppler, len(seen.rows), DOPPLER,
        (sensor.azimuth_noise, sensor.elevation_noise),
    )  # fmt: skip
    rows = seen.rows[frames]
    # The sensor's velocity is that of the IMU and of the arm between them, turning.
    v_I = velocity @ seen.R_IR.T - np.cross(log.gyro[rows], seen.p_IR)
    return rows, v_I, seen.R_IR @ cov @ seen.R_IR.T


@cache
def _scenarios() -> dict[str, Path]:
    """Every bundled scenario file by the name that it gives itself."""
    here = bundled("surefoot.scenarios", "courses")
    files = [path for folder in FOLDERS for path in sorted((here / folder).glob("*.toml"))]
    return {Scenario.load(path).name: path for path in files}
