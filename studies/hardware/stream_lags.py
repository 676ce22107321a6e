"""Lag of each stream of a log relative to its reference, if they were not stamped together."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from studies.hardware.drives import BLOCK
from surefoot import Log, Robot
from surefoot.extend import (
    GRAVITY_G,
    ReferenceMotion,
    block_bootstrap_counts,
    joint_velocity,
    reference_velocity,
    stance_phase,
)
from surefoot.models.attribution.evidence import log_under_model

LAGS = np.arange(-0.030, 0.0301, 0.001)
"""Lags on the grid, relative to the reference [s]."""
WALKING = 0.15
"""Speed of the base from which a row counts as walking [m/s]."""
MID_STANCE = (0.25, 0.6)
"""Part of a stance in which the foot certainly stands."""
LAG_SPAN = 0.1  # s, over which turns and changes of velocity are compared


@dataclass(frozen=True)
class Lag:
    """Lag of a stream relative to the reference [s], with its 95 % interval."""

    stream: str
    late: float
    interval: tuple[float, float]


def lags(log: Log, robot: Robot, seed: int = 0) -> tuple[Lag, ...]:
    """Lags of the streams relative to the motion capture, each from another part of its motion."""
    frame, rng = log_under_model(log, robot).motion, np.random.default_rng(seed)
    walks = np.linalg.norm(frame.v_I, axis=1) > WALKING
    block = np.floor((log.t - log.t[0]) / BLOCK).astype(int)
    costs = {
        "gyro, against the turns of the reference": _turn_costs(log, frame),
        "accelerometer, against its changes of velocity": _velocity_costs(log),
        "joints at mid-stance, against its velocity": _leg_costs(log, robot, frame, MID_STANCE),
        "joints over whole stances, against its velocity": _leg_costs(
            log, robot, frame, (0.0, 1.0)
        ),
    }
    return tuple(
        Lag(name, *_least(cost, walks & np.isfinite(cost).all(axis=0), block, rng))
        for name, cost in costs.items()
    )


def _least(
    cost: np.ndarray, rows: np.ndarray, block: np.ndarray, rng: np.random.Generator
) -> tuple[float, tuple[float, float]]:
    """The lag with the smallest cost (S, N), summed over these rows, with a bootstrap interval."""
    numbers = np.unique(block[rows])
    sums = np.array([cost[:, rows & (block == b)].sum(axis=1) for b in numbers])
    counts = block_bootstrap_counts(len(sums), rng)
    found = [_valley(c) for c in counts @ sums]
    low, high = np.percentile(found, [2.5, 97.5])
    return _valley(sums.sum(axis=0)), (float(low), float(high))


def _valley(cost: np.ndarray) -> float:
    k = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
    a, b, c = cost[k - 1 : k + 2]
    return float(LAGS[k] + 0.5 * (a - c) / max(a - 2 * b + c, 1e-300) * (LAGS[1] - LAGS[0]))


def _turn_costs(log: Log, frame: ReferenceMotion) -> np.ndarray:
    step = max(1, round(LAG_SPAN * log.rate))
    R = log.ref_R_GI
    there = Rotation.from_matrix(np.swapaxes(R[:-step], 1, 2) @ R[step:]).as_rotvec()
    angle = CubicSpline(log.t, cumulative_trapezoid(log.gyro, log.t, axis=0, initial=0.0))
    known = _measured_throughout(log, step)
    return _costs(log, step, known, lambda d: angle(log.t + d), there)


def _velocity_costs(log: Log) -> np.ndarray:
    step = max(1, round(LAG_SPAN * log.rate))
    v = reference_velocity(log)
    attitude = log.ref_R_GI
    there = v[step:] - v[:-step]
    known = _measured_throughout(log, step)
    felt = CubicSpline(log.t, log.accel)

    def gained(d: float) -> np.ndarray:
        a = np.einsum("nij,nj->ni", attitude, felt(log.t + d)) + GRAVITY_G
        return cumulative_trapezoid(a, log.t, axis=0, initial=0.0)

    return _costs(log, step, known, gained, there)


def _leg_costs(
    log: Log, robot: Robot, frame: ReferenceMotion, part: tuple[float, float]
) -> np.ndarray:
    robot = replace(robot, foot_radius=np.maximum(robot.foot_radius, 0.0))
    q, dq = CubicSpline(log.t, log.q), CubicSpline(log.t, joint_velocity(log))
    phase = np.column_stack([stance_phase(contact) for contact in log.contact.T])
    standing = frame.standing & (phase >= part[0]) & (phase <= part[1])
    costs = []
    for d in LAGS:
        then = np.clip(log.t + d, log.t[0], log.t[-1])
        v = robot.feet.imu_velocity(q(then), dq(then), log.gyro, frame.up_I, standing)
        # Wrong lengths and radii give each foot a mean error, which does not depend on the lag.
        off = v - frame.v_I[:, None]
        off = off - np.nanmedian(off, axis=0)
        costs.append(np.where(standing, np.sum(off**2, axis=2), 0.0).sum(axis=1))
    return np.array(costs)


def _costs(log: Log, step: int, known: np.ndarray, integral, there: np.ndarray) -> np.ndarray:
    """Squared difference (shifts, N) from the reference at each shift of a stream.

    Args:
        log: the measured log.
        step: rows over which the stream is integrated.
        known: (N - step,) bool, where both are known.
        integral: of the stream at a shift [s], a function to (N, 3).
        there: (N - step, 3), the reference's change over the same rows.
    """
    costs = np.full((len(LAGS), len(log.t)), np.nan)
    for i, d in enumerate(LAGS):
        whole = integral(float(d))
        off = whole[step:] - whole[:-step] - there
        off = off - np.median(off[known], axis=0)
        costs[i, :-step] = np.where(known, np.sum(off**2, axis=1), 0.0)
    costs[:, -step:] = 0.0
    return costs


def _measured_throughout(log: Log, step: int) -> np.ndarray:
    bad = np.cumsum(~log.ref_ok)
    return bad[step:] == bad[:-step]
