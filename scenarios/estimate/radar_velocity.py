"""Velocities from the simulated radar of a walk, for the perceptive filter."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from surefoot.estimator.ego_velocity import ego_velocities
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.scenario_catalog import bundled_scenarios
from surefoot.sim.walking.radar import RadarSensor, radar

DOPPLER = 0.06
"""Error of a return as the estimator assumes it [m/s]: quantisation, noise and direction errors."""


RADAR_COLUMNS = (
    *(f"x_radar_v_{a}" for a in "xyz"),
    *(f"x_radar_cov_{a}{b}" for a in "xyz" for b in "xyz"),
)
"""Columns of a log: a radar's velocity of the IMU in I [m/s] and its covariance; NaN between
frames.
"""


def with_radar(log: Log, robot: Robot) -> Log:
    """Add the columns of a simulated radar to a log that has none of its own.

    Raises SurefootError like `radar_velocity`.
    """
    if set(RADAR_COLUMNS) <= set(log.frame.columns):
        return log
    rows, v_I, cov = radar_velocity(log, robot)
    values = np.full((len(log.frame), len(RADAR_COLUMNS)), np.nan)
    values[rows] = np.concatenate([v_I, cov.reshape(-1, 9)], axis=1)
    return log.with_columns(dict(zip(RADAR_COLUMNS, values.T, strict=True)))


def radar_of(
    columns: Mapping[str, Any] | pd.DataFrame,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (M,) with a radar's velocity, v_I (M, 3) [m/s] there and covariances (M, 3, 3)."""
    values = np.column_stack([np.asarray(columns[name], dtype=float) for name in RADAR_COLUMNS])
    rows = np.flatnonzero(np.isfinite(values[:, 0]))
    return rows, values[rows, :3], values[rows, 3:].reshape(-1, 3, 3)


def radar_velocity(log: Log, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (M,) of the log, the IMU's velocity v_I (M, 3) [m/s] there, and covariances (M, 3, 3).

    The bias from direction errors persists (about 1 % of the speed), while the filter treats frames
    as independent, so the parameter `radar` multiplies the covariances. Raises SurefootError where
    there is no world for a radar: the log is measured, or its scenario is not a bundled one.
    """
    if not log.meta.scenario or log.meta.seed is None or log.meta.scenario not in _scenarios():
        raise SurefootError("needs a radar, which is simulated on walks of bundled scenarios only")
    sensor = RadarSensor()
    seen = radar(log, Scenario.load(_scenarios()[log.meta.scenario]), robot, sensor)
    angle_noise = sensor.azimuth_noise, sensor.elevation_noise
    frames, velocity, cov = ego_velocities(
        seen.frame, seen.direction_R, seen.doppler, len(seen.rows), DOPPLER, angle_noise
    )
    rows = seen.rows[frames]
    # The sensor's velocity is that of the IMU plus that of the rotating lever arm.
    v_I = velocity @ seen.R_IR.T - np.cross(log.gyro[rows], seen.p_IR)
    return rows, v_I, seen.R_IR @ cov @ seen.R_IR.T


@cache
def _scenarios() -> dict[str, Path]:
    """Every bundled scenario file by the name it contains."""
    return {Scenario.load(path).name: path for path in bundled_scenarios().values()}
