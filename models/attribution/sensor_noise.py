"""Residual caused by sensor noise alone, from data sheets or from the readings."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from surefoot.models.attribution.evidence import Key, LogUnderModel, all_keys, linearise, table_of
from surefoot.models.attribution.reference_sampling import reference_sampling, resample_reference
from surefoot.models.residuals.channels import channels
from surefoot.models.residuals.layout import Layout
from surefoot.models.residuals.motion import motion_under_model
from surefoot.sim.common.series import white_noise
from surefoot.sim.effects import known_effects
from surefoot.sim.effects.base import AXES, Effect, with_columns
from surefoot.sim.sensors.streams import Sensors

CONSTANT_STEPS = 1.5
"""Quantisation steps: a signal that changes by less over a bin may keep its error throughout."""


def data_sheet_noise(rate: float, layout: Layout, evenness: float = 0.0) -> np.ndarray:
    """Standard deviation (W,) of a bin's residual from the sensors' noise and uneven ground."""
    sigma = np.zeros(layout.width)
    for name, columns in layout.channels.items():
        sigma[columns] = channels()[name].noise(Sensors(), rate, evenness)
    return sigma


def reading_noise(cases: Sequence[LogUnderModel], effects: Sequence[Effect] = ()) -> np.ndarray:
    """Standard deviation (W,) of a bin's residual from the noise of the readings.

    As much noise again is added to the readings, and its effect on the residual measured, with the
    effects compensated.
    """
    rng = np.random.default_rng(cases[0].settings.reading_seed)
    change = [
        table_of(_with_more_noise(case, rng), effects) - table_of(case, effects) for case in cases
    ]
    square = np.concatenate(change) ** 2
    count = np.maximum(np.isfinite(square).sum(axis=0), 1)
    return np.maximum(np.sqrt(np.nansum(square, axis=0) / count), 1e-9)


def apparent_sizes(cases: Sequence[LogUnderModel], sigma: np.ndarray) -> Mapping[Key, float]:
    """Size [its unit] that the readings' noise alone gives each candidate that takes loads.

    The noise of a torque is in the residual and, through the load, in the candidate's regressor. A
    fit of one to the other then finds a spring where there is none. As much noise again adds as
    much again to the product of the two, which is measured here.

    Args:
        cases: the logs under the declared model.
        sigma: noise of each column (W,), by `reading_noise`.
    """
    by_load = {name for name, kind in known_effects().items() if kind.uses_loads}
    keys = tuple(dict.fromkeys(key for c in cases for key in all_keys(c) if key[0] in by_load))
    if not keys:
        return {}
    rng = np.random.default_rng(cases[0].settings.reading_seed)
    noisy = [_with_more_noise(case, rng) for case in cases]
    before, after = linearise(cases, (), keys), linearise(noisy, (), keys)
    change = np.nan_to_num(after.table - before.table) / sigma
    sizes = {}
    for key, old, new in zip(keys, before.X, after.X, strict=True):
        was, now = (one.values / sigma[one.columns] for one in (old, new))
        both = np.sum(change[:, new.columns] * now) - np.sum(change[:, old.columns] * was)
        square = np.sum(was**2)
        sizes[key] = float(both / square) if square else 0.0
    return sizes


def _with_more_noise(case: LogUnderModel, rng: np.random.Generator) -> LogUnderModel:
    """The case with noise of the same level added to the log's readings.

    The quantisation error may persist for a whole bin in which the signal hardly changes.
    """
    if case.by_feet:
        return _walk_with_more_noise(case, rng)
    log, noisy = case.log, {}
    count, first = case.motion.count, case.motion.first
    for group in ("q", "dq", "tau"):
        for joint in log.joints if log.has(group) else ():
            values = log.frame[f"{group}_{joint}"].to_numpy()
            step = _resolution(values)
            stays = np.abs(np.diff(values[first], append=values[-1])) < CONSTANT_STEPS * step
            rounding = np.repeat(rng.uniform(-0.5, 0.5, len(count)) * stays, count) * step
            noisy[f"{group}_{joint}"] = (
                values + rng.normal(0.0, white_noise(values), len(values)) + rounding
            )
    return replace(case, log=with_columns(log, noisy))


def _walk_with_more_noise(case: LogUnderModel, rng: np.random.Generator) -> LogUnderModel:
    """The same for a walk of a machine that is known by its feet alone.

    Impacts of the feet shake a body more than an IMU's noise does, so that is taken from data
    sheets. The noise of the feet is that in stance, and that of a measured reference its own.
    """
    log, noisy, sensors = case.log, {}, Sensors()
    if log.has("imu"):
        for kind, density in (("gyro", sensors.gyro_noise), ("accel", sensors.accel_noise)):
            for axis in AXES:
                noise = rng.normal(0.0, density * np.sqrt(log.rate), len(log.t))
                noisy[f"{kind}_{axis}"] = log.columns[f"{kind}_{axis}"] + noise
    for leg, stands in zip(log.legs, case.motion.standing.T, strict=True):
        for axis in AXES:
            feet = log.columns[f"foot_{leg}_{axis}"]
            bends = np.diff(feet, n=2)[stands[1:-1]]
            level = np.sqrt(np.mean(bends**2) / 6.0) if len(bends) else 0.0
            noisy[f"foot_{leg}_{axis}"] = feet + rng.normal(0.0, level, len(feet))
    log = with_columns(log, noisy)
    if sampling := reference_sampling(case.log, case.settings):
        log = resample_reference(log, sampling, rng)
    motion = motion_under_model(log, case.robot, case.fixed)
    return replace(case, log=log, motion=replace(motion, level=case.motion.level))


def _resolution(values: np.ndarray) -> float:
    """Smallest non-zero change of a reading (N,) between rows."""
    steps = np.abs(np.diff(values))
    return float(np.min(steps, where=steps > 0, initial=np.inf)) if steps.any() else 0.0
