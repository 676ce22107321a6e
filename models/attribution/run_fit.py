"""Fit the effects of a single run, such as zeros and clock, beside those shared by all runs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from surefoot.models.attribution.evidence import (
    Evidence,
    Key,
    LogUnderModel,
    linearise,
    log_under_model,
)
from surefoot.models.attribution.fit import design, fit, normal_equations
from surefoot.models.attribution.found import Found
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.attribution.refinement import RefinementData, with_clipped_size
from surefoot.models.attribution.split import FIT, SELECT
from surefoot.sim.effects import Effect, compensate_all, effect

OFFSET_ITERATIONS = 3
"""Gauss-Newton iterations: the residual is slightly nonlinear in a clock offset of milliseconds."""
IMU_BIASES = tuple((f"{sensor}_bias", axis) for sensor in ("gyro", "accel") for axis in "xyz")


@dataclass(frozen=True)
class FittedRun:
    """Effects of one run's own.

    Attributes:
        case: the run's log with `compensated` compensated.
        zeros: all of them, with 95 % intervals.
        compensated: those compensated; the others are turn-on biases, which every fit and filter
            estimates.
    """

    case: LogUnderModel
    zeros: tuple[Found, ...]
    compensated: tuple[Effect, ...]


def fit_run(
    case: LogUnderModel,
    effects: Sequence[Effect],
    start: Sequence[Effect],
    floor: NoiseFloor,
    weight: np.ndarray,
    sigma: np.ndarray,
) -> FittedRun:
    """Fit a run's own effects beside the shared ones, and compensate those in `start`.

    Args:
        case: the log under the declared model.
        effects: shared by all runs.
        start: per-run effects found, with their initial sizes.
        floor: noise floor of the model with the effects.
        weight: (M, W) of the log's bins, zero where they must not be used.
        sigma: (W,) noise of each column.
    """
    compensated = list(start)
    legged = case.log.has("imu") and not case.fixed
    own = [(e.name, e.target) for e in start]
    keys = [*own, *(key for key in IMU_BIASES if legged and key not in own)]
    zeros: tuple[Found, ...] = ()
    for _ in range(OFFSET_ITERATIONS if start else 1):
        known = linearise([case], [*effects, *compensated], keys)
        zeros = _fitted_sizes(known, keys, compensated, floor, weight, sigma)
        compensated = [one.effect for one in zeros if (one.effect.name, one.effect.target) in own]
    if not compensated:
        return FittedRun(case, zeros, ())
    without = compensate_all(compensated, case.log, case.robot)
    return FittedRun(log_under_model(*without, case.settings), zeros, tuple(compensated))


def fit_runs(
    known: RefinementData, effects: Sequence[Effect], own: Sequence[Effect]
) -> tuple[FittedRun, ...]:
    """Fit each log's own effects on all but the part that only reports.

    Args:
        known: the logs, and the evidence with what was found.
        effects: found, shared by the logs.
        own: found, with a size of its own in each log.
    """
    weights, log = known.robust_weights, known.evidence.log
    weight = np.where(np.isin(known.part, (FIT, SELECT))[:, None], weights.weight, 0.0)
    return tuple(
        fit_run(case, effects, own, known.floor, weight[log == i], weights.sigma)
        for i, case in enumerate(known.cases)
    )


def _fitted_sizes(
    known: Evidence,
    keys: Sequence[Key],
    about: Sequence[Effect],
    floor: NoiseFloor,
    weight: np.ndarray,
    sigma: np.ndarray,
) -> tuple[Found, ...]:
    """Sizes of the keys with intervals, as steps from those in `about`.

    Args:
        known: evidence of the log, linearised at `about`.
        keys: candidates to size.
        about: effects that the evidence has compensated already.
        floor: noise floor, for the apparent sizes on walks without the effects.
        weight: (M, W).
        sigma: (W,).
    """
    sums = normal_equations(design(known), floor.effective_noise(sigma), weight)
    # A run's bias is a constant to be estimated, not a draw from the data sheet's distribution.
    sums = replace(sums, limits=np.where([k in keys for k in sums.described_by], 0.0, sums.limits))
    fitted = fit(sums, keys)
    at = {(e.name, e.target): e.value for e in about}
    found = []
    for i, key in enumerate(keys):
        offset, spread = floor.sizes([k for k in keys if k != key], key)
        one = with_clipped_size(
            effect(*key, 0.0), at.get(key, 0.0) + fitted.sizes[i] - offset, known.layout.limbs
        )
        many = len(floor.walks)
        chance = stdtrit(many - 1, 0.975) * spread if many > 1 else 0.0
        faked = 1.96 * floor.size_uncertainty(key, offset)
        error = 1.96 * np.sqrt(fitted.covariance[i, i])
        half = float(np.sqrt(error**2 + chance**2 + faked**2))
        found.append(Found(one, (one.value - half, one.value + half)))
    return tuple(found)
