"""Random irregularity of a gait: stride periods, footholds, and the controller's estimate."""

import numpy as np

from surefoot.sim.common.kernels import kernel
from surefoot.sim.common.series import GaussMarkov
from surefoot.sim.gait.options import GaitOptions
from surefoot.sim.gait.state import Gait
from surefoot.sim.robot.kinematics import BaseMotion

FARTHEST_DRAW = 2.5
"""Standard deviations at which drawn periods and footholds are truncated, as legs have limited
reach.
"""


def irregular(
    gait: Gait, options: GaitOptions, ticks: int, dt: float, rng: np.random.Generator
) -> Gait:
    """Draw the irregularity that `options` specify.

    Args:
        gait: a regular one.
        options: what is irregular, and by how much.
        ticks: control ticks of the walk.
        dt: between them [s].
        rng: random generator.
    """
    strides = int(((ticks - 1) * dt - gait.start) / gait.period * 1.5) + 4

    def cut(size: float, shape: int | tuple[int, ...]) -> np.ndarray:
        return size * np.clip(rng.standard_normal(shape), -FARTHEST_DRAW, FARTHEST_DRAW)

    drawn: dict[str, np.ndarray] = {}
    if options.period_jitter:
        periods = gait.period * (1.0 + cut(options.period_jitter, strides))
        drawn["beats"] = gait.start + np.concatenate([[0.0], np.cumsum(periods)])
    if options.foothold_jitter:
        size = options.foothold_jitter * gait.leg_length
        drawn["footholds"] = cut(size, (strides + 1, len(gait.phase), 2))
    for name in ("velocity", "attitude"):
        size = getattr(options, f"{name}_noise")
        if size:
            rate = 1.0 / float(np.median(np.diff(np.arange(ticks) * dt)))
            process = GaussMarkov(rng, ticks, size, options.noise_time, rate)
            drawn[f"{name}_error"] = process.next(ticks)
    return gait._replace(**drawn)


@kernel(inline="always")
def estimated_base(gait, base, tick):
    """The controller's estimate of the base's motion at a tick (its index).

    The true BaseMotion, with the drawn errors of velocity and attitude, if any, in B.
    """
    p, R, v, w = base
    if len(gait.velocity_error):
        moved = R @ gait.velocity_error[tick]
        for k in range(3):
            moved[k] = v[k] + moved[k]
        v = moved
    if len(gait.attitude_error):
        a, b = gait.attitude_error[tick, 0], gait.attitude_error[tick, 1]
        # A small rotation about the base's x and y, normalised column by column.
        size = np.sqrt(1.0 + b * b)
        x0, x2 = 1.0 / size, -b / size
        along = a * x2
        y0, y1, y2 = -along * x0, 1.0, a - along * x2
        size = np.sqrt(y0 * y0 + y1 * y1 + y2 * y2)
        y0, y1, y2 = y0 / size, y1 / size, y2 / size
        turned = np.empty((3, 3))
        turned[0, 0], turned[0, 1], turned[0, 2] = x0, y0, -x2 * y1
        turned[1, 0], turned[1, 1], turned[1, 2] = 0.0, y1, x2 * y0 - x0 * y2
        turned[2, 0], turned[2, 1], turned[2, 2] = x2, y2, x0 * y1
        R = R @ turned
    return BaseMotion(p, R, v, w)


@kernel(inline="always")
def stride_at(gait, t, leg):
    """Index of the stride that a leg is in at time t [s], counted from its touchdown, and the share
    of it that has passed.
    """
    if len(gait.beats):
        k = min(max(np.searchsorted(gait.beats, t, "right") - 1, 0), len(gait.beats) - 2)
        length = gait.beats[k + 1] - gait.beats[k]
        strides = k + (t - gait.beats[k]) / length + gait.phase[leg]
    else:
        strides = (t - gait.start) / gait.period + gait.phase[leg]
    return int(np.floor(strides)), strides % 1.0
