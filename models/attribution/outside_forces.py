"""Stretches in which something else than the ground pushed the robot: a hand, a cable, a wall.

The feet's forces then miss what the base's motion takes (`base_wrench`), for a while and not at
every stride: what the robot itself lacks comes back with its gait or its motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surefoot.models.attribution.evidence import Evidence, LogUnderModel
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.robot import Robot


@dataclass(frozen=True)
class Push:
    """An outside force on the log of this number (from 0), from `begin` to `end` [s since its first
    row], of `force` at most [N]."""

    log: int
    begin: float
    end: float
    force: float

    def in_words(self) -> str:
        """Such as 'outside forces of up to 21 N from 4.0 to 5.1 s of run 1'."""
        when = f"from {self.begin:.1f} to {self.end:.1f} s of run {self.log + 1}"
        return f"outside forces of up to {self.force:.2g} N {when}"


def outside_forces(
    cases: Sequence[LogUnderModel], left: np.ndarray, known: Evidence
) -> tuple[Push, ...]:
    """The pushes in what is left (M, W) of the logs' residual; none of logs that have them at every
    turn, which is no outside force.

    Args:
        cases: the logs under the model.
        left: what no effect that was found explains; NaN where there is nothing.
        known: evidence whose columns and bins these are.
    """
    s = known.settings
    pushes: list[Push] = []
    if "base_wrench" not in known.layout:
        return ()
    columns, feet = known.layout.of("base_wrench")[:3], known.layout.by_leg("leg_velocity")
    for number, case in enumerate(cases):
        own = known.log == number
        force = np.linalg.norm(left[own][:, columns], axis=1)
        # A robot that stands on all its feet loads them in another way than one that walks.
        stands = np.isfinite(known.table[own][:, feet]).all(axis=(1, 2))
        walks = ~stands if stands.mean() < 0.5 else stands
        there = np.flatnonzero(np.isfinite(force) & walks)
        if not isinstance(case.robot, Robot) or len(there) == 0:
            continue
        t, force = known.t[own][there] - case.log.t[0], force[there]
        middle = np.median(force)
        spread = 1.4826 * np.median(np.abs(force - middle))
        least = s.push_share * case.robot.mass * GRAVITY
        rows = np.flatnonzero(force > max(middle + s.push_outlier * spread, least))
        apart = np.flatnonzero(np.diff(t[rows]) > s.push_gap) + 1
        found = [
            Push(number, float(t[one[0]]), float(t[one[-1]]), float(force[one].max()))
            for one in (np.split(rows, apart) if len(rows) else ())
            if t[one[-1]] - t[one[0]] >= s.shortest_push
        ]
        if sum(one.end - one.begin for one in found) < s.pushed_share * np.ptp(t):
            pushes += found
    return tuple(pushes)


def pushed_bins(
    cases: Sequence[LogUnderModel], known: Evidence, pushes: Sequence[Push]
) -> np.ndarray:
    """The bins (M,) in or near a push: what it does to the motion takes a while to end."""
    pushed = np.zeros(len(known.t), dtype=bool)
    for one in pushes:
        t = known.t - cases[one.log].log.t[0]
        near = (t > one.begin - known.settings.push_gap) & (t < one.end + known.settings.push_gap)
        pushed |= near & (known.log == one.log)
    return pushed
