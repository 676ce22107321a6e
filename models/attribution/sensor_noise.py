"""Noise of the readings, by the readings themselves, and that of a reference.

The reference in a log is interpolated between the samples of the motion capture, which
`sim.log.reference` recovers; the noise of their poses and time stamps is estimated from the IMU
(`sim.importing.reference_check`). Simulated references have one sample a row and no noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from surefoot.models.alignment.alignment import align
from surefoot.models.attribution.evidence import Key, LogUnderModel, all_keys, linearise, table_of
from surefoot.models.attribution.weights import sticks
from surefoot.models.residuals.motion import motion_under_model
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.common.series import interpolate_rows, white_noise
from surefoot.sim.effects import known_effects
from surefoot.sim.effects.base import AXES, Effect, with_columns
from surefoot.sim.importing.reference import REFERENCE_SAMPLES
from surefoot.sim.importing.reference_check import (
    FEWEST_SAMPLES,
    check_reference,
    reference_noise,
)
from surefoot.sim.log import Log
from surefoot.sim.log.reference import reference_poses
from surefoot.sim.sensors.streams import Sensors

_SEED = 20_012
"""Seed of the noise added to readings where their own noise is the floor."""
_MOST_LATE = 0.25
"""Largest remaining clock offset of a logged reference [s]: half a stride."""
_LATE, _FAR = 1e-3, 0.02
"""Clock offset [s] and distance of the tracked point [m] below which a trace hardly differs."""
CONSTANT_STEPS = 1.5
"""Quantisation steps: a signal that changes by less over a bin may keep its error throughout."""


def reading_noise(cases: Sequence[LogUnderModel], effects: Sequence[Effect] = ()) -> np.ndarray:
    """Standard deviation (W,) of a bin's residual from the noise of the readings.

    As much noise again is added to the readings, and its effect on the residual measured, with the
    effects compensated.
    """
    rng = np.random.default_rng(_SEED)
    change = [
        table_of(_with_more_noise(case, rng), effects) - table_of(case, effects) for case in cases
    ]
    square = np.concatenate(change) ** 2
    count = np.maximum(np.isfinite(square).sum(axis=0), 1)
    return np.maximum(np.sqrt(np.nansum(square, axis=0) / count), 1e-9)


def apparent_sizes(cases: Sequence[LogUnderModel], sigma: np.ndarray) -> Mapping[Key, float]:
    """Size [its unit] that the readings' noise alone gives candidates, on a fixed base those that
    take loads; without those that it gives none.

    The noise of a torque is in the residual and, through the load, in the candidate's regressor. A
    fit of one to the other then finds a spring where there is none; so does the noise of a
    reference a low-pass of the IMU. As much noise again adds as much again to the product of the
    two, which is measured here, in the entries that fits use.

    Args:
        cases: the logs under the declared model.
        sigma: noise of each column (W,), by `reading_noise`.
    """
    kinds = known_effects()
    keys = tuple(
        dict.fromkeys(
            key
            for case in cases
            for key in all_keys(case)
            if kinds[key[0]].traced.uses_loads or not case.fixed
        )
    )
    rng = np.random.default_rng(_SEED)
    noisy = [_with_more_noise(case, rng) for case in cases]
    before, after = (linearise(one, (), keys, nuisance=False) for one in (cases, noisy))
    change = np.where(sticks(cases, (), before.layout), np.nan, after.table - before.table)
    used, change = np.isfinite(change), np.nan_to_num(change) / sigma
    sizes = {}
    for key, old, new in zip(keys, before.X, after.X, strict=True):
        was, now = (one.values * used[:, one.columns] / sigma[one.columns] for one in (old, new))
        both = np.sum(change[:, new.columns] * now) - np.sum(change[:, old.columns] * was)
        if both and was.any():
            sizes[key] = float(both / np.sum(was**2))
    return sizes


def _with_more_noise(case: LogUnderModel, rng: np.random.Generator) -> LogUnderModel:
    """The case with noise of the same level added to the log's readings.

    The quantisation error may persist for a whole bin in which the signal hardly changes.
    """
    if not case.fixed:
        return _walk_with_more_noise(case, rng)
    log, noisy = case.log, {}
    count, first = case.motion.count, case.motion.first
    for group in ("q", "dq", "tau"):
        for joint in log.joints if log.has(group) else ():
            values = log.frame[f"{group}_{joint}"].to_numpy()
            # The smallest change of a reading.
            steps = np.abs(np.diff(values))
            step = np.min(steps, where=steps > 0, initial=np.inf) if steps.any() else 0.0
            stays = np.abs(np.diff(values[first], append=values[-1])) < CONSTANT_STEPS * step
            rounding = np.repeat(rng.uniform(-0.5, 0.5, len(count)) * stays, count) * step
            noisy[f"{group}_{joint}"] = (
                values + rng.normal(0.0, white_noise(values), len(values)) + rounding
            )
    return replace(case, log=with_columns(log, noisy))


def _walk_with_more_noise(case: LogUnderModel, rng: np.random.Generator) -> LogUnderModel:
    """The same for a walk: for its IMU, its feet where the log gives them, and its reference.

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
        for axis in AXES if case.by_feet else ():
            feet = log.columns[f"foot_{leg}_{axis}"]
            bends = np.diff(feet, n=2)[stands[1:-1]]
            level = np.sqrt(np.mean(bends**2) / 6.0) if len(bends) else 0.0
            noisy[f"foot_{leg}_{axis}"] = feet + rng.normal(0.0, level, len(feet))
    log = with_columns(log, noisy)
    if sampling := reference_sampling(case.log):
        log = resample_reference(log, sampling, rng)
    motion = motion_under_model(log, case.robot, case.fixed)
    return replace(case, log=log, motion=replace(motion, level=case.motion.level))


@dataclass(frozen=True)
class ReferenceSampling:
    """Sampling and noise of a reference.

    Attributes:
        intervals: times from the first row to the first sample, and between samples (K,) [s], empty
            where there is one in every row. What of their noise is in a bin depends on where in it
            they lie.
        position: standard deviation of a sample's position [m].
        angle: standard deviation of a sample's attitude [rad].
        stamp: standard deviation of a sample's time stamp [s].
    """

    intervals: tuple[float, ...]
    position: float
    angle: float
    stamp: float = 0.0


def reference_sampling(log: Log) -> ReferenceSampling | None:
    """Estimate the sampling and noise of a log's reference.

    None where it has too few samples, or one in every row and a velocity of its own, as simulated
    references have.
    """
    if not log.has("reference"):
        return None
    uses = ("ref_ok", "imu", "reference", "ref_v")
    return log.once("sampling of the reference", uses, lambda: _sampling(log))


def _sampling(log: Log) -> ReferenceSampling | None:
    poses = reference_poses(log)
    every_row = len(poses.t) == np.count_nonzero(log.ref_ok)
    if len(poses.t) < FEWEST_SAMPLES or (every_row and log.has("ref_v")):
        return None
    intervals = () if every_row else tuple(np.round(np.diff(poses.t, prepend=log.t[0]), 6))
    # Rows that are interpolated between unknown samples share noise with the next one.
    apart = poses.rows(slice(None, None, 2)) if every_row else poses
    noise = reference_noise(log.t, log.gyro, log.accel, apart) if log.has("imu") else None
    if noise is None:
        return None if every_row else ReferenceSampling(intervals, 0.0, 0.0)
    found = ReferenceSampling(intervals, noise.position, noise.angle, noise.stamp)
    start, step = log.meta.model.get(REFERENCE_SAMPLES, (0.0, 0.0))
    # Samples further apart than two rows would have been told from rows in between.
    if not (every_row and 1.0 + 1e-3 <= step * log.rate <= 2.0):
        return found
    then = np.arange((start - log.t[0]) % step, log.t[-1] - log.t[0], step)
    between = tuple(np.round(np.diff(then, prepend=0.0), 6))
    # The mean square of a row between two samples is two thirds of theirs.
    more = np.sqrt(1.5)
    return ReferenceSampling(between, more * found.position, more * found.angle, found.stamp)


def resample_reference(log: Log, sampling: ReferenceSampling, rng: np.random.Generator) -> Log:
    """Resample the reference of a log, with noise and interpolation as in `sampling`."""
    t = then = log.t
    if sampling.intervals:
        repeats = int(np.ceil((t[-1] - t[0]) / sum(sampling.intervals)))
        then = t[0] + np.cumsum(np.tile(sampling.intervals, repeats))
        then = np.concatenate([t[:1], then[(then > t[0]) & (then < t[-1])], t[-1:]])
    seen = np.clip(then + rng.normal(0.0, sampling.stamp, len(then)), t[0], t[-1])
    p_GI = interpolate_rows(seen, t, log.ref_p)
    p_GI += rng.normal(0.0, sampling.position, p_GI.shape)
    turned = Rotation.from_rotvec(rng.normal(0.0, sampling.angle, p_GI.shape))
    R_GI = Slerp(t, Rotation.from_matrix(log.ref_R_GI))(seen) * turned
    q_GI = quaternion_from_matrix(Slerp(then, R_GI)(t).as_matrix())
    path = interpolate_rows(t, then, p_GI)
    columns = {f"ref_p_{a}": path[:, i] for i, a in enumerate("xyz")}
    columns |= {f"ref_q_{a}": q_GI[:, i] for i, a in enumerate("wxyz")}
    return with_columns(log, columns)


def reference_notes(log: Log) -> tuple[str, ...]:
    """Notes on a measured reference: wrong samples, their noise, and any error of its clock or
    tracked point that the IMU alone reveals.
    """
    sampling = reference_sampling(log)
    if sampling is None:
        return ()
    notes = list(check_reference(reference_poses(log)).faults)
    if not log.has("imu"):
        return tuple(notes)
    notes.append(
        f"reference: noise of {1e3 * sampling.position:.2g} mm, "
        f"{np.degrees(sampling.angle):.2g} deg and {1e3 * sampling.stamp:.2g} ms, "
        "included in the noise floor"
    )
    found = align(log, most=_MOST_LATE)
    late, far = abs(found.offset), float(np.linalg.norm(found.p_IM))
    if late > max(_LATE, found.offset_half_width):
        notes.append(
            f"reference: by the IMU, {1e3 * found.offset:.1f} ms (+-"
            f"{1e3 * found.offset_half_width:.1f}) must be added to its stamps: run surefoot align"
        )
    if far > max(_FAR, float(np.linalg.norm(found.p_IM_half_width))):
        notes.append(
            f"reference: the tracked point is {1e3 * far:.0f} mm from the IMU: run surefoot align"
        )
    return (*notes, *(f"reference: {fault}" for fault in found.faults))
