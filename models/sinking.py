"""How deep a foot stands in ground that gives, and how fast it sinks.

A contact of MuJoCo is a critically damped spring: a foot that lands at speed v on ground of time
constant T is at the depth v t exp(-t / T) a time t later, whatever it carries.
"""

import numpy as np

from models.bins import Frame, frame_mean
from sim.log import Log
from sim.robot import Robot
from sim.tiles import SOLREF

BEFORE = 0.008
"""s before a foot touches, over which its speed is taken."""
SWING = 0.05
"""s in the air from which a foot has swung; after less it has only bounced."""


def sinking(log: Log, robot: Robot, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Depth [m] and its rate [m/s] of each foot (M, 4), means over bins; zero in swing."""
    T = SOLREF[0] + robot.beyond.softness
    landed = since_landing(log.t, log.contact)
    t = np.nan_to_num(landed)
    fall = landing_speed(log, robot, frame) * np.isfinite(landed) * np.exp(-t / T)
    mean = frame_mean(frame)
    return mean(fall * t), mean(fall * (1.0 - t / T))


def since_landing(t: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Time (N, 4) [s] since each foot touched; NaN in swing and where it never was seen to land."""
    since = np.full(contact.shape, np.nan)
    for leg in range(contact.shape[1]):
        touch = landings(t, contact[:, leg])
        last = np.searchsorted(touch, np.arange(len(t)), side="right") - 1
        known = contact[:, leg] & (last >= 0)
        since[known, leg] = t[known] - t[touch[last[known]]]
    return since


def landings(t: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Rows on which a foot that has swung touches: t (N,) [s], contact (N,)."""
    touch = 1 + np.flatnonzero(contact[1:] & ~contact[:-1])
    lift = 1 + np.flatnonzero(contact[:-1] & ~contact[1:])
    last = np.searchsorted(lift, touch) - 1
    known = last >= 0
    touch, last = touch[known], last[known]
    return touch[t[touch] - t[lift[last]] > SWING]


def landing_speed(log: Log, robot: Robot, frame: Frame) -> np.ndarray:
    """Median speed downwards (4,) [m/s] at which each foot lands, by the leg's kinematics."""
    rows = max(1, round(BEFORE * log.rate))
    speed = np.zeros(4)
    for leg in range(4):
        touch = landings(log.t, log.contact[:, leg])
        touch = touch[touch >= rows]
        if not len(touch):
            continue
        z = []
        for at in (touch - rows, touch):
            foot_I = robot.feet_I(log.q[at])[:, leg]
            z.append(frame.p_GI[at, 2] + np.einsum("nj,nj->n", frame.R_GI[at, 2], foot_I))
        speed[leg] = max(
            0.0, float(np.median((z[0] - z[1]) / (log.t[touch] - log.t[touch - rows])))
        )
    return speed
