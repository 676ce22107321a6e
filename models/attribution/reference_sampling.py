"""Sampling interval and noise of a measured reference, and their simulation.

The reference in a log is interpolated between the samples of the motion capture, which
`sim.log.reference` recovers; the noise of their poses and time stamps is estimated from the IMU
(`sim.importing.reference_noise`). Simulated references have one sample a row and no noise.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from surefoot.models.alignment.alignment import align
from surefoot.models.attribution.settings import DEFAULT, TraceSettings
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.effects.base import with_columns
from surefoot.sim.importing.reference_check import check_reference
from surefoot.sim.importing.reference_noise import reference_noise
from surefoot.sim.log import Log
from surefoot.sim.log.reference import reference_poses


@dataclass(frozen=True)
class ReferenceSampling:
    """Sampling and noise of a reference.

    Attributes:
        intervals: times between samples (K,) [s], empty where there is one in every row.
        position: standard deviation of a sample's position [m].
        angle: standard deviation of a sample's attitude [rad].
        stamp: standard deviation of a sample's time stamp [s].
    """

    intervals: tuple[float, ...]
    position: float
    angle: float
    stamp: float = 0.0


def reference_sampling(log: Log, settings: TraceSettings = DEFAULT) -> ReferenceSampling | None:
    """Estimate the sampling and noise of a log's reference.

    None where it has too few samples, or one in every row and a velocity of its own, as simulated
    references have.
    """
    if not log.has("reference"):
        return None
    uses = ("ref_ok", "imu", "reference", "ref_v")
    return log.once("sampling of the reference", uses, lambda: _sampling(log, settings))


def _sampling(log: Log, settings: TraceSettings) -> ReferenceSampling | None:
    poses = reference_poses(log)
    every_row = len(poses.t) > settings.coarse_share * len(log.t)
    if len(poses.t) < settings.coarse_samples or (every_row and log.has("ref_v")):
        return None
    intervals = () if every_row else tuple(np.round(np.diff(poses.t), 6))
    noise = reference_noise(log.t, log.gyro, log.accel, poses) if log.has("imu") else None
    if noise is None:
        return None if every_row else ReferenceSampling(intervals, 0.0, 0.0)
    return ReferenceSampling(intervals, noise.position, noise.angle, noise.stamp)


def resample_reference(log: Log, sampling: ReferenceSampling, rng: np.random.Generator) -> Log:
    """Resample the reference of a log, with noise and interpolation as in `sampling`."""
    t = then = log.t
    if sampling.intervals:
        repeats = int(np.ceil((t[-1] - t[0]) / sum(sampling.intervals)))
        then = t[0] + np.cumsum(np.tile(sampling.intervals, repeats))
        then = np.concatenate([t[:1], then[then < t[-1]], t[-1:]])
    seen = np.clip(then + rng.normal(0.0, sampling.stamp, len(then)), t[0], t[-1])
    p_GI = _at(seen, t, log.ref_p)
    p_GI += rng.normal(0.0, sampling.position, p_GI.shape)
    turned = Rotation.from_rotvec(rng.normal(0.0, sampling.angle, p_GI.shape))
    R_GI = Slerp(t, Rotation.from_matrix(log.ref_R_GI))(seen) * turned
    q_GI = quaternion_from_matrix(Slerp(then, R_GI)(t).as_matrix())
    path = _at(t, then, p_GI)
    columns = {f"ref_p_{a}": path[:, i] for i, a in enumerate("xyz")}
    columns |= {f"ref_q_{a}": q_GI[:, i] for i, a in enumerate("wxyz")}
    return with_columns(log, columns)


def reference_notes(log: Log, sampling: ReferenceSampling | None) -> tuple[str, ...]:
    """Notes on a measured reference: wrong samples, their noise, and any error of its clock or
    tracked point that the IMU alone reveals.
    """
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
    found = align(log, most=_MOST)
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


_MOST = 0.25
"""Largest remaining clock offset of a logged reference [s]: half a stride."""
_LATE, _FAR = 1e-3, 0.02
"""Clock offset [s] and distance of the tracked point [m] below which a trace hardly differs."""


def _at(then: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate values (N, 3), given at times t (N,), at the times `then` (K,)."""
    return np.column_stack([np.interp(then, t, x) for x in values.T])
