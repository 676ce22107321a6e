"""Checks of a reference by itself: miscounted frames, jumps, held samples and gaps."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.importing.clock import seconds, set_forward
from surefoot.sim.importing.reference import MAX_GAP
from surefoot.sim.log.reference import Poses

_MISCOUNTED = {1: (2.0,), 2: (1 / 2, 3 / 2), 3: (2 / 3,)}
"""Number of frames of a step by its stamps -> its speeds relative to the surrounding ones if that
number is off by one. Other ratios, and steps of more frames, also occur in a jerky gait with
correct stamps.
"""
_RATIO_TOLERANCE = 0.12
"""Relative tolerance of such a ratio, less than half of the distance between two of them."""
_NEIGHBOURS = 3
"""Number of steps on either side whose median is the surrounding speed; a step of the gait lasts
much longer.
"""
_STEADY = 0.1
"""Relative spread (median deviation) of the surrounding speeds up to which a step can be judged."""
_SLOWEST = 0.1
"""Speed below which noise of millimetres changes a step's speed as much as a frame does [m/s]."""
_JUMP_ACCEL = 150.0
"""Acceleration from the surrounding speed that is a jump [m/s^2]: legs cause less than a third of
it; a jump of 15 mm between samples at 100 Hz has as much.
"""
_JUMP_TURN = 500.0
"""The same for the angular rate [rad/s^2]: 3 degrees between samples at 100 Hz."""
_LEAST_JUMP, _LEAST_TURN = 0.005, 0.02
"""Least size of a jump, m and rad, at any rate: a shin that hits a stair's edge changes a body's
velocity by 1 m/s, or 5 rad/s, within a millisecond.
"""
_FEW_DOUBTFUL = 0.03
"""Share of doubtful stamps up to which chance and gait explain them."""
_SHOWN_DOUBTFUL = 5e-4
"""Share below which doubtful stamps are not reported, as it would print as 0.0 %."""
_JUMP_RATIO = 8.0
"""Ratio of a jump to the usual change of speed; noise of a reference stays below it."""


@dataclass(frozen=True)
class ReferenceCheck:
    """Result of the checks of a reference.

    Attributes:
        samples: number, rate and gaps of its samples, in words.
        others: faults other than doubtful stamps, in words.
        judged: number of steps at a steady speed, whose frames can be counted.
        miscounted: number of these that are off by a frame.
    """

    samples: str
    others: tuple[str, ...] = ()
    judged: int = 0
    miscounted: int = 0

    @property
    def doubtful(self) -> float:
        """Share of the judged steps whose stamps are off by a frame."""
        return self.miscounted / self.judged if self.judged else 0.0

    @property
    def lines(self) -> tuple[str, ...]:
        """Description in words, followed by the faults."""
        return (self.samples, *self._faults(_SHOWN_DOUBTFUL))

    @property
    def faults(self) -> tuple[str, ...]:
        """The faults only, in words."""
        return self._faults(_FEW_DOUBTFUL)

    def _faults(self, least: float) -> tuple[str, ...]:
        if self.doubtful < least:
            return self.others
        return (
            f"reference: {100 * self.doubtful:.1f} % of stamps doubtful: so many of the "
            f"{self.judged} steps at a steady speed have 1/2, 2/3, 3/2 or 2 times their "
            "neighbours' (frames miscounted)",
            *self.others,
        )


def check_reference(poses: Poses) -> ReferenceCheck:
    """Check the K samples of a reference by themselves."""
    t, step = poses.t, np.diff(poses.t)
    rate = 1.0 / np.median(step) if len(step) else 0.0
    longest, gaps = 1e3 * step.max(initial=0.0), np.sum(step > MAX_GAP)
    samples = f"reference: {len(t)} samples, {rate:.3g} Hz; longest gap {longest:.0f} ms, "
    samples += f"{gaps} over {1e3 * MAX_GAP:.0f} ms"
    if len(step) < 2 * _NEIGHBOURS + 1:
        return ReferenceCheck(samples)
    pose = np.column_stack([poses.p, poses.q])
    said = [
        f"stamps leap from {seconds(t[row - 1])} to {seconds(t[row])} s while it goes on: a clock"
        " that was set; import what is before and the rest separately"
        for row in set_forward(t, pose)
    ]
    if np.all(step == 1.0):
        said.append("stamps are whole numbers: of frames? Give [reference] rate, and no t")
    if (jumped := np.flatnonzero(jumps(poses))).size:
        _, largest = max(_jump(poses, int(k)) for k in jumped)
        said.append(f"{len(jumped)} jumps of position or attitude, the largest by {largest}")
    same = ~np.diff(pose, axis=0).any(axis=1)
    if held := np.sum(same & (_speeds(poses)[1] > _SLOWEST)):
        said.append(f"{held} samples repeat the one before while the body moves")
    miscounted, judged = (int(one.sum()) for one in miscounts(poses))
    return ReferenceCheck(samples, tuple(f"reference: {one}" for one in said), judged, miscounted)


def _jump(poses: Poses, step: int) -> tuple[float, str]:
    """Size of the jump over a step, relative to the least one, and its description.

    It includes the adjacent samples, over which trackers often spread it.
    """
    a, b = max(step - 1, 0), min(step + 2, len(poses.t) - 1)
    around = slice(max(a - _NEIGHBOURS, 0), b + _NEIGHBOURS + 1)
    t, p = poses.t[around], poses.p[around]
    beside = np.ones(len(t) - 1, dtype=bool)
    beside[a - around.start : b - around.start] = False
    usual = np.median((np.diff(p, axis=0) / np.diff(t)[:, None])[beside], axis=0)
    within = float(poses.t[b] - poses.t[a])
    R = Rotation.from_quat(poses.q[[a, b]], scalar_first=True)
    moved = float(np.linalg.norm(poses.p[b] - poses.p[a] - usual * within))
    turned = float((R[0].inv() * R[1]).magnitude())
    words = (
        f"{1e3 * moved:.0f} mm and {np.degrees(turned):.1f} deg within {1e3 * within:.0f} ms, "
        f"{poses.t[step + 1] - poses.t[0]:.2f} s after the first sample"
    )
    return max(moved / _LEAST_JUMP, turned / _LEAST_TURN), words


def miscounts(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Masks (K - 1,) of the steps between samples that are off by a frame, and of those that can be
    judged.
    """
    speed, around = _speeds(poses)
    spread = _median_around(np.abs(speed - around))
    step = np.diff(poses.t)
    frame = np.median(step[step < 1.5 * np.percentile(step, 5.0)])  # the shortest usual step
    frames = np.maximum(np.rint(step / frame), 1.0)
    judged = (around > _SLOWEST) & (spread < _STEADY * around) & (frames <= max(_MISCOUNTED))
    ratio = speed / np.maximum(around, _SLOWEST)
    off = np.zeros(len(ratio), dtype=bool)
    for count, ratios in _MISCOUNTED.items():
        near = np.any([np.abs(ratio / one - 1.0) < _RATIO_TOLERANCE for one in ratios], axis=0)
        off |= near & (frames == count)
    return off & judged, judged


def jumps(poses: Poses) -> np.ndarray:
    """Mask (K - 1,) of the steps between samples over which position or attitude jumps."""
    step = np.diff(poses.t)
    if len(step) < 2:  # none has a neighbour
        return np.zeros(len(step), dtype=bool)
    R = Rotation.from_quat(poses.q, scalar_first=True)
    turning = (R[:-1].inv() * R[1:]).magnitude() / step
    found = np.zeros(len(step), dtype=bool)
    for rate, limit, least in (
        (_speeds(poses)[0], _JUMP_ACCEL, _LEAST_JUMP),
        (turning, _JUMP_TURN, _LEAST_TURN),
    ):
        change = rate - _median_around(rate)
        usual = 1.4826 * np.median(np.abs(change))
        far = (change / step > limit) & (change * step > least)
        found |= far & (change > _JUMP_RATIO * usual)
    return found


def without_jumps(poses: Poses, longest: float = 0.5) -> Poses:
    """Remove the poses between a jump and one back, at most `longest` [s] later.

    In these frames the tracker confused the body with another, or flipped its attitude.
    """
    while True:
        keep, back = np.ones(len(poses.t), dtype=bool), -1
        for first, last in pairwise(np.flatnonzero(jumps(poses))):
            # What follows a jump back is good, unless it still jumps once the poses before it are
            # removed.
            if first != back and poses.t[last] - poses.t[first] < longest:
                keep[first + 1 : last + 1], back = False, last
        if keep.all():
            return poses
        poses = poses.rows(keep)


def _speeds(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Speed (K - 1,) [m/s] of each step, and the median speed of the surrounding steps."""
    speed = np.linalg.norm(np.diff(poses.p, axis=0), axis=1) / np.diff(poses.t)
    return speed, _median_around(speed)


def _median_around(x: np.ndarray) -> np.ndarray:
    """Median (M,) of the _NEIGHBOURS values on either side of each of x (M,), without itself."""
    padded = np.pad(x, _NEIGHBOURS, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1)
    return np.nanmedian(np.delete(windows, _NEIGHBOURS, axis=1), axis=1)
