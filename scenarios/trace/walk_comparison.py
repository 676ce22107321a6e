"""A measured walk with simulated ones, and the drift of the leg filter on both, to compare their
difficulty.

The drift only evaluates a simulated robot. Its effects and gait are chosen by `trace` and the
realism card, never by this comparison.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student_t

from surefoot.models.realism.card import Card
from surefoot.models.realism.walk_view import WalkView
from surefoot.scenarios.estimate.run import run_filter
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

FILTER = "leg"
WITHIN = 0.15
"""Largest difference of the simulated from the measured drift, as a share of it; set beforehand."""


@dataclass(frozen=True)
class WalkComparison:
    """A measured walk, simulated walks in its style, and the realism card that compares them.

    Attributes:
        words: name of the simulated robot, such as "as drawn".
        measured: the measured walk.
        simulated: the simulated walks.
        card: the comparison.
        pace: speed of the simulated walks relative to the measured one.
    """

    words: str
    measured: WalkView
    simulated: tuple[WalkView, ...]
    card: Card
    pace: float


@dataclass(frozen=True)
class Drift:
    """RPE of the leg filter over 1 m [m/m] with one model of the feet; NaN where it diverged."""

    feet: str  # whose radius the model has, and the radius
    measured: float
    simulated: tuple[float, ...]  # of each walk

    @property
    def ratio(self) -> float:
        """Mean of the simulated walks over the measured one."""
        return float(np.mean(self.simulated)) / self.measured

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the ratio over the walks' seeds (Student's t); NaN for one walk."""
        n = len(self.simulated)
        if n < 2:
            return np.nan, np.nan
        half = student_t.ppf(0.975, n - 1) * np.std(self.simulated, ddof=1) / np.sqrt(n)
        half = float(half) / self.measured
        return self.ratio - half, self.ratio + half

    @property
    def alike(self) -> bool:
        return abs(self.ratio - 1.0) <= WITHIN


def leg_drifts(found: WalkComparison) -> tuple[Drift, ...]:
    """The drift with feet as in the measured log's model and, if different, with the foot radius of
    the robot's file.
    """
    views = (found.measured, *found.simulated)
    drifts = []
    for feet in ("as declared", "as in the robot's file"):
        robots = [v.robot if feet == "as declared" else with_own_feet(v.robot) for v in views]
        rpe = [_drift(v.log, robot) for v, robot in zip(views, robots, strict=True)]
        radii = 1e3 * robots[0].foot_radius.mean(), 1e3 * robots[1].foot_radius.mean()
        words = f"{feet}: {radii[0]:.0f} mm" + (
            "" if radii[0] == radii[1] else f", {radii[1]:.0f} mm in simulation"
        )
        drifts.append(Drift(words, rpe[0], tuple(rpe[1:])))
        if np.allclose(with_own_feet(robots[0]).foot_radius, robots[0].foot_radius):
            break
    return tuple(drifts)


def with_own_feet(robot: Robot) -> Robot:
    """The robot with the foot radius of its file."""
    return replace(robot, foot_radius=Robot.load(robot.file).foot_radius)


def drift_table(found: Sequence[WalkComparison]) -> list[dict[str, str | float]]:
    """One row per simulated robot and model of the feet."""
    return [
        {
            "simulated robot": one.words,
            "model of the feet": drift.feet,
            "measured": drift.measured,
            "simulated": float(np.mean(drift.simulated)),
            "each walk": ", ".join(f"{x:.3f}" for x in drift.simulated),
            "ratio": drift.ratio,
            "over seeds, 95 %": "{:.2f} to {:.2f}".format(*drift.interval),
            f"within {100 * WITHIN:.0f} %": "yes" if drift.alike else "no",
        }
        for one in found
        for drift in leg_drifts(one)
    ]


def _drift(log: Log, robot: Robot) -> float:
    metrics = run_filter(FILTER, log, robot).metrics
    return metrics.rpe_trans if metrics else np.nan
