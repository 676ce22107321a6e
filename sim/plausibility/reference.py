"""Checks of a reference against itself and the IMU: attitude, position, velocity, clock."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.importing.advice import entries
from surefoot.sim.importing.reference import REFERENCE_OFFSET
from surefoot.sim.importing.reference_check import check_reference
from surefoot.sim.log.reference import reference_poses
from surefoot.sim.plausibility.attitude import LATE, LATEST
from surefoot.sim.plausibility.axes import GYRO, REF_P, REF_V, SCALED, SURELY, match_axes
from surefoot.sim.plausibility.causes import in_another_unit, in_other_axes
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.view import LogView

FASTEST_LEGS = 12.0
"""Speed that no legged robot has reached [m/s] (WildCat, 8.9 m/s, Boston Dynamics 2013)."""
_Q = tuple(f"ref_q_{a}" for a in "wxyz")


@plausibility_rule("reference's unit", "t ref", when="comparable")
def position(view: LogView) -> Iterator[Finding]:
    """Check that positions are in metres, by the speed.

    Compares: the median speed of ref_p.
    Threshold: {FASTEST_LEGS:g} m/s.
    Reason: the fastest robot on legs ran at 8.9 m/s (WildCat, Boston Dynamics, 2013).
    Remedy: unit = "mm".
    """
    if not view.ok.any():
        return
    speed = float(np.median(np.linalg.norm(view.ref_v[view.ok], axis=1)))
    if speed > FASTEST_LEGS:
        unit = "mm" if speed > 90.0 else "cm"  # walks have 0.1 to 3 m/s
        seen = f"median speed {speed:.4g} m/s"
        yield Finding(REF_P, seen, f"in {unit}, not m", entries(REF_P, unit=unit))


@plausibility_rule("reference's samples", "t ref", finds="note")
def even_samples(view: LogView) -> Iterator[Finding]:
    """Check that a reference's samples are evenly spaced and continuous.

    Compares: each step of a reference with those around it.
    Threshold: jumps, repeated samples, and stamps that are off by a frame (3 % of the steps).
    Reason: a body on legs is pushed by less than 150 m/s² and 500 rad/s²; cameras count
        frames.
    Remedy: stamps of the tracker itself; frames in which it lost the body are to be left out.
    """
    for fault in check_reference(reference_poses(view.log)).faults:
        seen = fault.removeprefix("reference: ")
        cause = "the tracker lost the body, or its stamps are not its own"
        yield Finding((*REF_P, *_Q), seen, cause)


@plausibility_rule("reference's attitude", "t gyro ref")
def attitude(view: LogView) -> Iterator[Finding]:
    """Check that the reference rotates with the gyro, without a delay, and that gravity points
    down.

    Compares: the turning of ref_q with the gyro, its vertical with gravity, both as they are
        and under other readings (x, y, z, w; world to body; north-east-down; y up), and up to
        {LATEST:g} s late or early.
    Threshold: a reading that fits where ref_q as it is does not; {LATE:g} s late;
        a vertical that is far from gravity.
    Reason: clean walks correlate by 0.97 and more; at 1 m/s a body is 2 cm further after 0.02
        s.
    Remedy: the order or sign of ref_q's columns; [reference] offset; surefoot align.
    """
    fault = view.attitude
    if fault is None:
        return
    if not fault.late:
        yield Finding(_Q, fault.evidence, fault.cause, fault.changes)
        return
    by_force, alike = view.delay(view.accel[view.ok], view.felt[view.ok], LATE, LATEST)
    if not fault.changes and alike > SURELY and abs(by_force) < 0.5 * abs(fault.late):
        seen = f"{fault.evidence}, and the accelerometer does not"
        yield Finding(GYRO, seen, "a filter, or another clock, of the gyro alone")
        return
    offset = view.log.meta.model.get(REFERENCE_OFFSET, 0.0) - fault.late
    changes = {"reference": {**fault.changes.get("reference", {}), "offset": round(offset, 3)}}
    yield Finding((*REF_P, *_Q), fault.evidence, fault.cause, changes)


@plausibility_rule("reference's velocity", "t ref ref_v", when="comparable")
def velocity(view: LogView) -> Iterator[Finding]:
    """Check that the reference's velocity is the derivative of its positions, in the world.

    Compares: ref_v with the change of ref_p.
    Threshold: {SCALED:.0%} of its size, or of its mean square.
    Reason: equal by definition, in the axes of the world.
    Remedy: unit or order of the axes; leave ref_v out, it is derived then.
    """
    if not view.ok.any():
        return
    logged = view.means(view.log.ref_v)[view.ok]
    moved = view.ref_v[view.ok]
    if np.sqrt(np.mean(np.sum(moved**2, axis=1))) < 0.05 and np.abs(logged).max() < 1.0:
        return
    size = float(np.sqrt(np.sum(logged**2) / max(np.sum(moved**2), 1e-12)))
    missed = float(np.sum((logged - moved) ** 2) / max(np.sum(moved**2), 1e-12))
    if missed < SCALED:
        return
    seen = f"{size:.3g} times the change of positions"
    if abs(np.log(max(size, 1e-9))) > np.log1p(SCALED):
        yield Finding(REF_V, seen, *in_another_unit("ref_v", REF_V, size, "scaled, or ref_p is"))
        return
    seen = f"{100 * missed:.0f} % of its mean square is not the change of positions"
    if np.sum((logged - view.v_I[view.ok]) ** 2) < 0.3 * np.sum((logged - moved) ** 2):
        yield Finding(REF_V, seen, "in the body's axes, not the world's")
        return
    match = match_axes(logged, moved)
    late, shifted = view.delay(logged, moved, LATE, LATEST)
    if late and shifted > max(SURELY, match.best.mean()):
        seen = f"{1e3 * abs(late):.0f} ms {'late' if late > 0 else 'early'}"
        seen += " against the change of ref_p"
        yield Finding(REF_V, seen, "a filter, or stamps of another clock")
    elif match.wrong:
        yield in_other_axes(match, "ref_v", "the change of positions")
    else:
        yield Finding(REF_V, seen, "another clock, another body, or a filter that lags")
