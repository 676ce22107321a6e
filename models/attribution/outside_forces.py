"""Sections in which a hand, a cable or a wall pushed the robot.

The feet's forces then differ from what the base's motion requires (`base_wrench`), for a while and
not at every stride; an error of the robot's model recurs with its gait or motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surefoot.models.attribution.evidence import Evidence, LogUnderModel
from surefoot.sim.common.gravity import GRAVITY


@dataclass(frozen=True)
class Push:
    """An outside force on a log.

    Attributes:
        log: index of the log, from 0.
        begin: start [s since the log's first row].
        end: end [s since the log's first row].
        force: its maximum [N].
    """

    log: int
    begin: float
    end: float
    force: float

    def in_words(self) -> str:
        """A phrase such as 'outside forces of up to 21 N from 4.0 to 5.1 s of run 1'."""
        when = f"from {self.begin:.1f} to {self.end:.1f} s of run {self.log + 1}"
        return f"outside forces of up to {self.force:.2g} N {when}"


def outside_forces(
    cases: Sequence[LogUnderModel], left: np.ndarray, known: Evidence
) -> tuple[Push, ...]:
    """Find outside forces in the residual of logs.

    A log with such forces for much of its length has none: the cause is then the robot.

    Args:
        cases: the logs under the model.
        left: residual (M, W) with the effects found compensated; NaN where there is none.
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
        # In standing, the feet share the load differently; judge whichever of the two is more
        # common.
        stands = np.isfinite(known.table[own][:, feet]).all(axis=(1, 2))
        walks = ~stands if stands.mean() < 0.5 else stands
        there = np.flatnonzero(np.isfinite(force) & walks)
        if case.robot.legged is None or len(there) == 0:
            continue
        t, force = known.t[own][there] - case.log.t[0], force[there]
        middle = np.median(force)
        spread = 1.4826 * np.median(np.abs(force - middle))
        least = s.push_share * case.robot.legged.mass * GRAVITY
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
    """Mask (M,) of the bins in or near a push, whose influence on the motion takes a while to
    decay.
    """
    pushed = np.zeros(len(known.t), dtype=bool)
    for one in pushes:
        t = known.t - cases[one.log].log.t[0]
        near = (t > one.begin - known.settings.push_gap) & (t < one.end + known.settings.push_gap)
        pushed |= near & (known.log == one.log)
    return pushed
