"""A walk made of formulas: body velocity is a known function of the joints, at any rate.

Stance feet of a trot push the body forward: with legs of length l swung by q about vertical, the
body moves at -l cos(q) dq of the diagonal pair in stance. Hips move sideways in the same way. The
stride's amplitude wanders, so that speed does.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from reference_columns import reference_columns
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from surefoot.sim.log import JOINTS, Log, Meta
from surefoot.sim.log.schema import named_columns

LEG = 0.5


@dataclass(frozen=True)
class Body:
    """A robot as far as the observer is concerned."""

    name: str = "analytic"
    p_BI: np.ndarray = field(default_factory=lambda: np.zeros(3))
    R_BI: np.ndarray = field(default_factory=lambda: np.eye(3))


def synthetic_walk(
    seed: int,
    duration: float = 30.0,
    rate: float = 500.0,
    noise: float = 0.0,
    robot: str = "analytic",
    name: str = "walk",
) -> Log:
    """A log whose v_I is known; `noise` is that of the joint velocities, rad/s."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(duration * rate)) / rate
    phase = 2 * np.pi * 2.0 * t + 0.3 * _wander(rng, t)
    dphase = np.gradient(phase, t)
    stride, sway = 0.25 + 0.1 * _wander(rng, t), 0.05 * _wander(rng, t)
    legs = np.array([0.0, np.pi, np.pi, 0.0])
    q, dq = np.zeros((len(t), 4, 3)), np.zeros((len(t), 4, 3))
    for leg, offset in enumerate(legs):
        angle = phase + offset
        q[:, leg, 0] = sway * np.cos(angle)
        dq[:, leg, 0] = -sway * dphase * np.sin(angle)
        q[:, leg, 1] = stride * np.cos(angle)
        dq[:, leg, 1] = -stride * dphase * np.sin(angle)
        q[:, leg, 2] = -1.0 + 0.3 * stride * np.sin(angle)
        dq[:, leg, 2] = 0.3 * stride * dphase * np.cos(angle)
    # sin(phase) >= 0: legs 0 and 3 swing back, and carry.
    stance = np.where(np.sin(phase) >= 0, 0, 1)
    rows = np.arange(len(t))
    v_I = np.stack(
        (
            -LEG * np.cos(q[rows, stance, 1]) * dq[rows, stance, 1],
            -LEG * np.cos(q[rows, stance, 0]) * dq[rows, stance, 0],
            0.1 * dq[rows, stance, 2],
        ),
        axis=1,
    )
    yaw = 0.3 * _wander(rng, t)
    R_GI = Rotation.from_euler("z", yaw[:, None]).as_matrix()
    v_G = np.einsum("nij,nj->ni", R_GI, v_I)
    columns = {"t": t}
    columns |= named_columns("gyro", np.stack((0 * t, 0 * t, np.gradient(yaw, t)), axis=1))
    columns |= named_columns("accel", np.tile([0.0, 0.0, 9.81], (len(t), 1)))
    for group, values in (
        ("q", q),
        ("dq", dq + noise * rng.standard_normal(dq.shape)),
        ("tau", 20 * np.sin(q)),
    ):
        columns |= named_columns(group, values.reshape(len(t), 12), JOINTS)
    columns |= reference_columns(R_GI, np.cumsum(v_G, axis=0) / rate, v_G)
    return Log(pd.DataFrame(columns), Meta(rate=rate, robot=robot), name)


def resting(seconds: float, rate: float = 500.0, gravity: float = 9.81) -> Log:
    """An IMU that lies still, with white noise of 1e-3 rad/s and 1e-2 m/s^2."""
    rng = np.random.default_rng(0)
    t = np.arange(round(seconds * rate)) / rate
    columns = {"t": t} | named_columns("gyro", 1e-3 * rng.standard_normal((len(t), 3)))
    accel = 1e-2 * rng.standard_normal((len(t), 3)) + [0.0, 0.0, gravity]
    columns |= named_columns("accel", accel)
    return Log(pd.DataFrame(columns), Meta(rate=rate), "rest")


def without(log: Log, *starts: str) -> Log:
    """The log less the columns that start so."""
    kept = [name for name in log.frame if not str(name).startswith(starts)]
    return replace(log, frame=log.frame[kept])


def _wander(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A smooth random function of about unit size, periods of 3 s and more."""
    waves = rng.uniform(0.3, 2.0, size=5)
    turns = rng.uniform(0, 2 * np.pi, size=5)
    return np.sin(np.outer(t, waves) + turns).sum(axis=1) / np.sqrt(2.5)


def gauss_markov(rng: np.random.Generator, n: int, keep: float, axes: int = 3) -> np.ndarray:
    """A stationary process (n, axes) of unit variance whose neighbours correlate by `keep`."""
    steps = rng.standard_normal((n, axes))
    steps[1:] *= np.sqrt(1 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], steps, axis=0))
