"""Is a reference what it seems? Miscounted frames, jumps, held samples and gaps, by itself
alone."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.importing.reference import MAX_GAP
from surefoot.sim.log.reference import Poses

_MISCOUNTED = (1 / 2, 2 / 3, 3 / 2, 2.0)
"""Speed of a step over its neighbours', where its stamps count one frame too many or too few: one
for two, two for three, three for two, two for one."""
_NEAR = 0.12
"""Share by which a ratio may differ from one of these: less than half of what lies between them."""
_AROUND = 3
"""Steps on either side whose median is the speed around a step: a step of gait is much longer."""
_STEADY = 0.1
"""Share by which speeds around may spread (median deviation) for a step to be judged by them."""
_SLOWEST = 0.1
"""m/s below which millimetres of noise change a speed by as much as a frame does."""
_JUMP_ACCEL = 150.0
"""m/s^2 from the speed around to that of a step: a body on legs is pushed by less than a third, a
jump of 15 mm between samples at 100 Hz has as much."""
_JUMP_TURN = 500.0
"""rad/s^2, the same of the rate of turning: 3 degrees between samples at 100 Hz."""
_LEAST_JUMP, _LEAST_TURN = 0.005, 0.02
"""m and rad of a jump, at any rate: a shin that strikes a stair's edge changes a body's speed by
1 m/s, or 5 rad/s, from one millisecond to the next."""
_FEW_DOUBTFUL = 0.03
"""Share of doubtful stamps below which chance, and gait, explain them."""
_SHOWN_DOUBTFUL = 5e-4
"""Share below which they would be 0.0 %, of which nothing is said."""
_OUTLYING = 8.0
"""Times its usual change by which a speed must change in a jump: a noisy reference has no more."""


@dataclass(frozen=True)
class Jump:
    """A jump of a reference, with the sample before and the one after, over which trackers often
    spread it: `after` the first sample [s], moved [m] beyond the usual speed, turned [rad], within
    so many seconds."""

    after: float
    moved: float
    turned: float
    within: float

    @property
    def words(self) -> str:
        """Size and time."""
        return (
            f"{1e3 * self.moved:.0f} mm and {np.degrees(self.turned):.1f} deg within "
            f"{1e3 * self.within:.0f} ms, {self.after:.2f} s after the first sample"
        )


@dataclass(frozen=True)
class ReferenceCheck:
    """What the samples of a reference say of themselves.

    samples: how many; rate [Hz]; judged: steps at a steady speed, by which frames can be counted;
    miscounted: those of them off by a frame; jumps, held: steps from sample to sample that jump,
    or repeat the pose to the last digit while the body moves; gaps: intervals over MAX_GAP;
    longest_gap [s]; largest: of the jumps.
    """

    samples: int
    rate: float
    judged: int
    miscounted: int
    jumps: int
    held: int
    gaps: int
    longest_gap: float
    largest: Jump | None = None

    @property
    def doubtful(self) -> float:
        """Share of the judged steps whose stamps are off by a frame."""
        return self.miscounted / self.judged if self.judged else 0.0

    @property
    def lines(self) -> tuple[str, ...]:
        """In words, what there is and then what is wrong."""
        said = [
            f"reference: {self.samples} samples, {self.rate:.3g} Hz; longest gap "
            f"{1e3 * self.longest_gap:.0f} ms, {self.gaps} over {1e3 * MAX_GAP:.0f} ms"
        ]
        return (*said, *self._counted(_SHOWN_DOUBTFUL), *self._events)

    @property
    def faults(self) -> tuple[str, ...]:
        """In words, only what is wrong."""
        return (*self._counted(_FEW_DOUBTFUL), *self._events)

    def _counted(self, least: float) -> tuple[str, ...]:
        said = []
        if self.judged and self.doubtful >= least:
            said.append(
                f"reference: {100 * self.doubtful:.1f} % of stamps doubtful: so many of the "
                f"{self.judged} steps at a steady speed have 1/2, 2/3, 3/2 or 2 times their "
                "neighbours' (frames miscounted)"
            )
        return tuple(said)

    @property
    def _events(self) -> tuple[str, ...]:
        said = []
        if self.largest:
            said.append(
                f"reference: {self.jumps} jumps of position or attitude, the largest by "
                f"{self.largest.words}"
            )
        if self.held:
            said.append(
                f"reference: {self.held} samples repeat the one before while the body moves"
            )
        return tuple(said)


def check_reference(poses: Poses) -> ReferenceCheck:
    """Check the samples of a reference, K of them, by themselves."""
    step = np.diff(poses.t)
    if len(step) < 2 * _AROUND + 1:
        return ReferenceCheck(len(poses.t), 0.0, 0, 0, 0, 0, 0, float(step.max(initial=0.0)))
    miscounted, judged = miscounts(poses)
    _, around = _speeds(poses)
    same = np.all(np.diff(poses.p, axis=0) == 0, axis=1) & np.all(
        np.diff(poses.q, axis=0) == 0, axis=1
    )
    jumped = np.flatnonzero(jumps(poses))
    return ReferenceCheck(
        samples=len(poses.t),
        rate=float(1.0 / np.median(step)),
        judged=int(judged.sum()),
        miscounted=int(miscounted.sum()),
        jumps=len(jumped),
        held=int((same & (around > _SLOWEST)).sum()),
        gaps=int((step > MAX_GAP).sum()),
        longest_gap=float(step.max()),
        largest=max((_jump(poses, int(k)) for k in jumped), key=_times_least, default=None),
    )


def _jump(poses: Poses, step: int) -> Jump:
    """The jump over a step, with the steps beside it."""
    a, b = max(step - 1, 0), min(step + 2, len(poses.t) - 1)
    around = slice(max(a - _AROUND, 0), b + _AROUND + 1)
    t, p = poses.t[around], poses.p[around]
    beside = np.ones(len(t) - 1, dtype=bool)
    beside[a - around.start : b - around.start] = False
    usual = np.median((np.diff(p, axis=0) / np.diff(t)[:, None])[beside], axis=0)
    within = float(poses.t[b] - poses.t[a])
    R = Rotation.from_quat(poses.q[[a, b]], scalar_first=True)
    return Jump(
        after=float(poses.t[step + 1] - poses.t[0]),
        moved=float(np.linalg.norm(poses.p[b] - poses.p[a] - usual * within)),
        turned=float((R[0].inv() * R[1]).magnitude()),
        within=within,
    )


def _times_least(jump: Jump) -> float:
    return max(jump.moved / _LEAST_JUMP, jump.turned / _LEAST_TURN)


def miscounts(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Steps (K - 1,) between samples that are off by a frame, and those that can be judged."""
    speed, around = _speeds(poses)
    spread = _median_around(np.abs(speed - around))
    judged = (around > _SLOWEST) & (spread < _STEADY * around)
    ratio = speed / np.maximum(around, _SLOWEST)
    near = np.any([np.abs(ratio / one - 1.0) < _NEAR for one in _MISCOUNTED], axis=0)
    return near & judged, judged


def jumps(poses: Poses) -> np.ndarray:
    """Steps (K - 1,) between samples over which position or attitude jumps."""
    step = np.diff(poses.t)
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
        found |= far & (change > _OUTLYING * usual)
    return found


def without_jumps(poses: Poses, longest: float = 0.5) -> Poses:
    """The poses but for those between a jump and one back, at most `longest` [s] later: a body that
    was taken for another or turned about for some frames."""
    at = np.flatnonzero(jumps(poses))
    keep = np.ones(len(poses.t), dtype=bool)
    for first, last in pairwise(at):
        if poses.t[last] - poses.t[first] < longest:
            keep[first + 1 : last + 1] = False
    return poses.rows(keep)


def _speeds(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Speed (K - 1,) [m/s] of each step, and the median speed of the steps around it."""
    speed = np.linalg.norm(np.diff(poses.p, axis=0), axis=1) / np.diff(poses.t)
    return speed, _median_around(speed)


def _median_around(x: np.ndarray) -> np.ndarray:
    """Median (M,) of the _AROUND values on either side of each of x (M,), without itself."""
    padded = np.pad(x, _AROUND, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1)
    return np.nanmedian(np.delete(windows, _AROUND, axis=1), axis=1)
