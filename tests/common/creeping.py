"""A log of a trot whose standing feet lose way as they turn over the ground."""

from dataclasses import replace

import numpy as np
import pandas as pd
from pendulum import swung

from surefoot.sim.log import Log

LEG_SPEED = 0.4
LOST = 0.25


def creeping(swing: float, sticks: bool = False) -> Log:
    """A trot along x whose body yaws to and fro by a rate that grows from `swing` [rad/s] to twice
    as much, and goes LOST metres less than the legs for each radian.

    The legs do not yaw, so standing feet turn over the ground; those that stick turn the other way
    in I.
    """
    t = 0.01 * np.arange(601)
    rate = swing * (1.0 + t / t[-1]) * np.cos(4.0 * np.pi * t)
    yaw = np.concatenate([[0.0], np.cumsum(0.005 * (rate[1:] + rate[:-1]))])
    v = LEG_SPEED - LOST * np.abs(rate)
    x = np.concatenate([[0.0], np.cumsum(0.005 * (v[1:] + v[:-1]))])
    first = t % 0.5 < 0.25 - 1e-9
    ahead = 0.05 - LEG_SPEED * (t % 0.25)
    columns = {"gyro_x": 0.0, "gyro_y": 0.0, "gyro_z": rate}
    columns |= {"accel_x": 0.0, "accel_y": 0.0, "accel_z": 9.81}
    columns |= {"ref_p_x": x, "ref_p_y": 0.0, "ref_p_z": 0.3}
    columns |= {"ref_q_w": np.cos(yaw / 2), "ref_q_x": 0.0, "ref_q_y": 0.0}
    columns["ref_q_z"] = np.sin(yaw / 2)
    for leg, middle in {
        "FL": (0.25, 0.15),
        "FR": (0.25, -0.15),
        "RL": (-0.25, 0.15),
        "RR": (-0.25, -0.15),
    }.items():
        stands = first if leg in ("FL", "RR") else ~first
        foot = np.column_stack([np.where(stands, ahead, -ahead), 0.0 * t]) + middle
        if sticks:
            c, s = np.cos(yaw), np.sin(yaw)
            foot = np.column_stack(
                [c * foot[:, 0] + s * foot[:, 1], c * foot[:, 1] - s * foot[:, 0]]
            )
        columns |= {f"foot_{leg}_x": foot[:, 0], f"foot_{leg}_y": foot[:, 1]}
        columns |= {f"foot_{leg}_z": np.where(stands, -0.3, -0.27), f"contact_{leg}": 1.0 * stands}
    log = swung(seconds=0.1)
    meta = replace(log.meta, robot=None, effects=())
    return replace(log, frame=pd.DataFrame({"t": t, **columns}), meta=meta)
