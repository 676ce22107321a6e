"""A short made-up walk with known errors, for everything that draws."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from reference_columns import reference_columns
from scipy.spatial.transform import Rotation

from surefoot.estimator.evaluation.trajectory import Trajectory, UpdateRecord
from surefoot.models.calibration.bounds import Bounds
from surefoot.models.observer.predict import Prediction
from surefoot.sim.ground.ground_metadata import ground_metadata
from surefoot.sim.ground.terrain import Ground, Patch
from surefoot.sim.log import Log, Meta
from surefoot.sim.log.schema import named_columns
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import JOINTS, LEGS

RATE = 500.0
DRIFT = np.array([0.10, -0.05, 0.02])  # m/s, of the estimate "leg"


class Walk(NamedTuple):
    log: Log
    robot: Robot
    trajectories: dict[str, Trajectory]
    prediction: Prediction
    bounds: Bounds


def make_walk(seconds: float) -> Walk:
    """A robot that walks an arc of 0.5 m/s; "coverage" is right, "leg" drifts by DRIFT."""
    rng = np.random.default_rng(0)
    robot = Robot.load("spot_class")
    t = np.arange(1, round(seconds * RATE) + 1) / RATE
    yaw = 0.4 * t
    R_GI = Rotation.from_euler("z", yaw[:, None]).as_matrix()
    v_GI = 0.5 * R_GI[:, :, 0]
    p_GI = np.cumsum(v_GI, axis=0) / RATE + [1.0, 2.0, 0.5]
    phase = 2 * np.pi * 2.0 * t
    swing = np.stack([np.sin(phase + s) for s in (0.0, np.pi, np.pi, 0.0)], axis=1)
    q = np.tile(robot.q_home, (len(t), 1)).reshape(-1, 4, 3)
    q[:, :, 1] += 0.2 * swing
    contact = swing < 0.3
    slip = np.where(contact & (t[:, None] > seconds / 2), 0.3, 0.0)
    columns = {"t": t} | reference_columns(R_GI, p_GI, v_GI)
    columns |= named_columns("q", q.reshape(-1, 12), JOINTS)
    of_legs = {"contact": contact.astype(float), "slip": slip, "mu": np.full_like(slip, 0.6)}
    for name, values in of_legs.items():
        columns |= named_columns(name, values, LEGS)
    x, y = p_GI[len(t) // 2, :2]
    ground = ground_metadata(Ground(0.8, (Patch(x, y, 1.0, 1.5, 0.2),)))
    meta = Meta(rate=RATE, robot="spot_class", scenario="arc", model=ground)
    log = Log(pd.DataFrame(columns), meta)
    rows = np.arange(4, len(t), 5)
    error = rng.normal(0.0, 0.03, (len(rows), 3))
    v_I = np.einsum("nji,nj->ni", R_GI, v_GI)[rows] + error
    prediction = Prediction(rows, v_I, None, np.full(len(rows), np.nan))
    bounds = Bounds(
        epsilon=np.array([0.05, 0.06, 0.07]), gamma=0.8, level_per_axis=0.8 ** (1 / 3),
        method="conformal", K=20, n=100, observer="0" * 64, R_BI=robot.R_BI, log="none",
    )  # fmt: skip
    covariance = np.tile(
        np.diag([0.01] * 3 + [0.05] * 3 + [0.1] * 3 + [0.01] * 6) ** 2, (len(rows), 1, 1)
    )
    zeros = np.zeros((len(rows), 3))
    pi = np.linspace(0.5, 1.0, len(rows))
    record = UpdateRecord(t[rows], v_I, np.tile(bounds.epsilon, (len(rows), 1)), pi, pi < 0.8)
    right = (t[rows], R_GI[rows], v_GI[rows], p_GI[rows], zeros, zeros, covariance)
    drift = p_GI[rows] + (t[rows] - t[rows[0]])[:, None] * DRIFT
    trajectories = {
        "coverage": Trajectory(*right, record),
        "leg": Trajectory(t[rows], R_GI[rows], v_GI[rows], drift, zeros, zeros, covariance),
    }
    return Walk(log, robot, trajectories, prediction, bounds)
