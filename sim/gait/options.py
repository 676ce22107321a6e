"""Gaits by name, and their options: the `[gait]` table of a scenario.

A gait of your own is a class with the attributes of `Pattern`, registered by the entry point group
`surefoot.gaits`; a scenario selects it by `[gait] pattern = "NAME"`.
"""

from dataclasses import dataclass

import numpy as np

from surefoot.sim.common.errors import SurefootError, check_known, check_within
from surefoot.sim.common.plugins import Registry
from surefoot.sim.common.series import SHORTEST_TIME


@dataclass(frozen=True)
class Pattern:
    """A gait.

    Attributes:
        phase: of FL, FR, RL and RR: delay of the touchdown, as a share of the stride.
        duty: least duty factor.
        period: of the stride, relative to the trot's.
        sway: how far the centre of pressure moves from below the body to the middle of the standing
            feet, from 0 to 1; optional in a class of your own.
    """

    phase: tuple[float, float, float, float]
    duty: float
    period: float = 1.0
    sway: float = 0.0


# Alexander, "The gaits of bipedal and quadrupedal animals", IJRR 1984: relative phases and duty
# factors. A walk is a lateral sequence: each hind foot lands before the fore foot of its side.
# Without sway, the foot diagonal to the swinging one would bear no load.
_BUNDLED = {
    "trot": Pattern((0.0, 0.5, 0.5, 0.0), 0.0),
    "walk": Pattern((0.0, 0.5, 0.75, 0.25), 0.78, 1.6, 0.5),
    "pace": Pattern((0.0, 0.5, 0.0, 0.5), 0.6, 0.7),
}


def _check(pattern: Pattern) -> None:
    """Raise SurefootError for an invalid gait."""
    phase = np.asarray(pattern.phase, dtype=float)
    if phase.shape != (4,) or not ((phase >= 0.0) & (phase < 1.0)).all():
        raise SurefootError("phase must be four numbers from 0 to below 1")
    duty, period, sway = pattern.duty, pattern.period, getattr(pattern, "sway", 0.0)
    if not (0.0 <= duty <= 0.9 and 0.1 <= period <= 10.0 and 0.0 <= sway <= 1.0):
        raise SurefootError("duty must be from 0 to 0.9, period from 0.1 to 10, sway from 0 to 1")


PATTERNS = Registry("surefoot.gaits", _BUNDLED, ("phase", "duty", "period"), _check)
"""Name -> gait."""


def pattern_named(name: str) -> Pattern:
    """The gait of that name. Raises SurefootError naming the known ones."""
    check_known("pattern", name, PATTERNS)
    return PATTERNS[name]


RANGES = {
    "duty": (0.4, 0.9),
    "unloading": (0.01, 0.5),
    "slip_care": (0.0, 1.0),
    "period_jitter": (0.0, 0.2),
    "noise_time": (SHORTEST_TIME, np.inf),
}
"""Ranges of options; others are only not negative."""


@dataclass(frozen=True)
class GaitOptions:
    """Deviations of a gait from the default, a soft, strictly periodic trot with a perfect state
    estimate.

    Sizes are for any robot, scaled by its leg length and weight. Real trots vary by 3 to 4 % in
    period and 1 to 2 cm in foothold (measured, Go1); published quadruped controllers add joint PD
    to feed-forward torques: kp 20 N m/rad, kd 0.5 N m s/rad on a Go1 (Margolis and Agrawal, "Walk
    These Ways", CoRL 2022), 0.4 m g L and 25 ms.
    """

    pattern: str = "trot"  # or walk, pace, or a gait of your own (`Pattern`)
    duty: float = 0.6  # share of the stride that a foot is planned to stand
    unloading: float = 0.15  # share of the stance over which a foot's load comes, and goes
    period_jitter: float = 0.0  # standard deviation of a stride's period, as a share of it
    foothold_jitter: float = 0.0  # standard deviation of a foothold along each axis / leg length
    touchdown_speed: float = 0.0  # of the foot towards the ground / sqrt(gravity * leg length)
    liftoff_speed: float = 0.0  # upward, at which a swing begins / sqrt(gravity * leg length)
    liftoff_advance: float = 0.0  # share of the body's velocity at which it begins
    braking: float = 0.0  # share of the body's velocity that a landing foot still has
    level: float = 1.0  # factor on the gains that hold the base level, while it nearly is
    slip_care: float = 0.0  # share of the velocity that sliding feet lack which is given up
    stiffness: float = 0.0  # of the joints of standing legs / (m g L per rad); 0: no joint PD
    damping: float = 0.025  # s, rate gain of the joint PD over its stiffness
    velocity_noise: float = 0.0  # m/s, standard deviation of the velocity that feeds the controller
    attitude_noise: float = 0.0  # rad, of roll and pitch, the same
    noise_time: float = 0.1  # s, correlation time of both

    def __post_init__(self):
        pattern_named(self.pattern)
        check_within({n: x for n, x in vars(self).items() if n != "pattern"}, RANGES)


PLAIN_GAIT = GaitOptions()
"""The default trot."""
MEASURED_GAIT = GaitOptions(
    duty=0.60,
    unloading=0.05,
    period_jitter=0.03,
    foothold_jitter=0.004,
    touchdown_speed=0.15,
    liftoff_speed=0.3,
    liftoff_advance=1.0,
    braking=0.6,
    level=0.2,
    slip_care=0.5,
    stiffness=0.8,
    velocity_noise=0.05,
    attitude_noise=0.006,
    noise_time=0.02,
)
"""A trot like a measured one, by the realism card of a Unitree Go1 that trots around a square
(github mrsp/serow); kp and kd of standing legs are those of Margolis and Agrawal (as above). Legs
that yield slide a little in every stance: with all of `slip_care` the robot hardly walks, on dry
ground too, and with half of it paths have the lengths of their courses.
"""
