"""Conditions of a walk at each sample, by which coverage is split: terrain, motion, slip, phase."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from surefoot.sim.log import Log
from surefoot.sim.physics.foot_truth import SLIPPING

SLIPPERY = 0.4
"""Friction coefficient under a loaded foot."""
STEEP = 0.05
"""Slope of the reference path, over a second before and after."""
TURNING = 0.3
"""rad/s, about the vertical."""
STILL = 0.05
"""m/s, over the same two seconds."""
QUARTERS = ("first", "second", "third", "last")

ConditionRows = tuple[str, str, np.ndarray]


def walking_conditions(log: Log, rows: np.ndarray) -> Iterator[ConditionRows]:
    """Yield (split, case, mask of `rows` (M,)) for every split whose columns the log has.

    terrain: level, climbing, descending, by the reference path. motion: standing, straight,
    turning. slip and ground: by the truth columns of a simulation. stride: quarters of the time
    between touchdowns of the first leg, by its contact.
    """
    if log.has("reference"):
        yield from _path(log, rows)
    if log.has("truth"):
        slipping = log.slip[rows].max(axis=1) > SLIPPING
        yield "slip", "a foot slips", slipping
        yield "slip", "no foot slips", ~slipping
        under = np.where(log.slip[rows] > 0, log.mu[rows], np.inf)
        least = under.min(axis=1)  # no foot loaded: neither
        yield "ground", f"friction below {SLIPPERY:g}", least < SLIPPERY
        yield "ground", "dry", (least >= SLIPPERY) & np.isfinite(least)
    if log.has("contact"):
        phase = stride_phase(log.t, log.contact[:, 0])[rows]
        for k, name in enumerate(QUARTERS):
            yield "stride", f"{name} quarter", np.floor(4 * phase) == k


def _path(log: Log, rows: np.ndarray) -> Iterator[ConditionRows]:
    second = max(1, round(log.rate))
    ahead, behind = np.minimum(rows + second, len(log.t) - 1), np.maximum(rows - second, 0)
    step = log.ref_p[ahead] - log.ref_p[behind]
    run, time = np.linalg.norm(step[:, :2], axis=1), log.t[ahead] - log.t[behind]
    still = run < STILL * time
    slope = np.where(still, 0.0, step[:, 2] / np.where(still, 1.0, run))
    yield "terrain", "level", np.abs(slope) <= STEEP
    yield "terrain", "climbing", slope > STEEP
    yield "terrain", "descending", slope < -STEEP
    yaw = np.unwrap(np.arctan2(log.ref_R_GI[:, 1, 0], log.ref_R_GI[:, 0, 0]))
    turning = np.abs(yaw[ahead] - yaw[behind]) > TURNING * time
    yield "motion", "standing", still & ~turning
    yield "motion", "straight", ~still & ~turning
    yield "motion", "turning", turning


def stride_phase(t: np.ndarray, contact: np.ndarray, shortest: float = 0.2) -> np.ndarray:
    """Phase (N,) in [0, 1) from one touchdown of a foot to its next; NaN where there is none.

    contact (N,) bool. A touchdown within `shortest` seconds of the last is a bounce; strides of
    more than two seconds are rests.
    """
    touchdowns = np.flatnonzero(contact[1:] & ~contact[:-1]) + 1
    kept: list[int] = []
    for row in touchdowns.tolist():
        if not kept or t[row] - t[kept[-1]] >= shortest:
            kept.append(row)
    phase = np.full(len(t), np.nan)
    for begin, end in pairwise(kept):
        if t[end] - t[begin] <= 2.0:
            phase[begin:end] = (t[begin:end] - t[begin]) / (t[end] - t[begin])
    return phase
