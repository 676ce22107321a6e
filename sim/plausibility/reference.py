"""Checks of a reference's positions: unit, samples, velocity, tracked point, scale and heading by
the accelerometer, and whether they were derived from the legs.
"""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.importing.advice import entries
from surefoot.sim.importing.reference_check import check_reference
from surefoot.sim.log.reference import reference_poses
from surefoot.sim.plausibility.comparison import in_another_unit, match_axes, number_words
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.limits import FEWEST, MENDED, SCALED, SURELY
from surefoot.sim.plausibility.stance import feet_at
from surefoot.sim.plausibility.view import REF_P, REF_Q, REF_V, STEP, LogView

FASTEST_LEGS = 12.0
"""Speed that no legged robot has reached [m/s] (WildCat, 8.9 m/s, Boston Dynamics 2013)."""
FARTHEST_POINT = 0.2
"""Distance between the IMU and the reference's tracked point [m]: 0.05 in clean walks, 0.02 on a
measured Go1, 0.15 where nothing is consistent.
"""
SPEEDING = 0.3
"""Interval of the changes of velocity [s]: a stance, in which tilts hardly matter and impacts
end.
"""
POSITIONS_TURNED = 10.0
"""Heading difference between a reference's positions and attitudes [deg]: 1 in clean walks."""
MADE_OF_LEGS = 0.01
"""Median difference between leg odometry and reference, relative to the speed: 0.0003 to 0.002 from
a reference derived from it; 0.07 in clean walks, whose feet roll, and 0.15 on a measured Go1.
"""
_WALKS = 0.05
"""Speed below which there is nothing to compare [m/s]."""


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


@plausibility_rule("reference's samples", "t ref", is_note=True)
def even_samples(view: LogView) -> Iterator[Finding]:
    """Check that a reference's samples are evenly spaced and continuous.

    Compares: each step of a reference with those around it.
    Threshold: jumps, repeated samples, and stamps that are off by a frame (3 % of the steps).
    Reason: a body on legs is pushed by less than 150 m/s² and 500 rad/s²; cameras count
        frames.
    Remedy: stamps of the tracker itself; frames in which it lost the body are to be left out.
    """
    faults = check_reference(reference_poses(view.log)).faults
    if faults:
        seen = "; ".join(fault.removeprefix("reference: ") for fault in faults)
        cause = "the tracker lost the body, or its stamps are not its own"
        yield Finding((*REF_P, *REF_Q), seen, cause)


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
    logged, moved = view.means(view.log.ref_v)[view.ok], view.ref_v[view.ok]
    size, moves, missed = (float(np.sum(x**2)) for x in (logged, moved, logged - moved))
    rests = moves < len(moved) * _WALKS**2 and np.abs(logged).max() < 1.0
    if rests or missed < SCALED * moves:
        return
    ratio = float(np.sqrt(max(size, 1e-18) / max(moves, 1e-12)))
    seen = f"{100 * missed / moves:.0f} % of its mean square is not the change of positions"
    cause, changes = "another clock, another body, or a filter that lags", {}
    match = match_axes(logged, moved)
    if abs(np.log(ratio)) > np.log1p(SCALED):
        seen = f"{ratio:.3g} times the change of positions"
        cause, changes = in_another_unit("ref_v", REF_V, ratio, "scaled, or ref_p is")
    elif np.sum((logged - view.v_I[view.ok]) ** 2) < 0.3 * missed:
        cause = "in the body's axes, not the world's"
    elif match.wrong:
        yield match.finding("ref_v", "the change of positions")
        return
    yield Finding(REF_V, seen, cause, changes)


@plausibility_rule("reference's point", "t accel gyro ref", when="trusts_reference")
def point(view: LogView) -> Iterator[Finding]:
    """Check that the reference tracks the IMU: other points accelerate as the body rotates.

    Compares: what the accelerometer differs by from the acceleration of ref_p, with that of
        another point of the body.
    Threshold: {FARTHEST_POINT:g} m from the IMU, and {MENDED:.0%} unexplained or less.
    Reason: ref_p is the IMU's own; markers are where there is room.
    Remedy: [reference] p_IM; surefoot align.
    """
    found = other_point(view)
    if found is not None:
        p_IM, explained = found
        seen = f"{100 * explained:.0f} % of what the accelerometer differs by"
        where = number_words(p_IM)
        cause = f"of a point at ({where}) m in the IMU's axes, not of the IMU; try surefoot align"
        yield Finding(REF_P, seen, cause, {"reference": {"p_IM": tuple(p_IM.tolist())}})


def other_point(view: LogView) -> tuple[np.ndarray, float] | None:
    """The tracked point p_IM (3,) [m] of a trusted reference, and the share of its difference from
    the accelerometer that it explains; None for the IMU's own.

    Least squares for p_IM and a constant in a_M = a_I + (alpha x + omega x omega x) p_IM.
    """
    turning, speeding_up = _cross(view.gyro), _cross(np.gradient(view.gyro, STEP, axis=0))
    arm = (speeding_up + turning @ turning)[view.ok]
    missed = (view.felt - view.accel)[view.ok]
    missed = missed - missed.mean(axis=0)
    arm = arm - arm.mean(axis=0)
    p_IM = np.linalg.lstsq(arm.reshape(-1, 3), missed.reshape(-1), rcond=None)[0]
    explained = 1.0 - np.sum((missed - arm @ p_IM) ** 2) / max(float(np.sum(missed**2)), 1e-12)
    elsewhere = np.linalg.norm(p_IM) > FARTHEST_POINT and explained > 1.0 - MENDED
    return (p_IM.round(2) + 0.0, float(explained)) if elsewhere else None


def speed_changes(view: LogView) -> tuple[np.ndarray, np.ndarray]:
    """Changes of velocity (K, 3) [m/s] in G over SPEEDING seconds, by the accelerometer's sum over
    rows and by the reference's positions.
    """
    R_GI, steps = view.log.ref_R_GI, round(SPEEDING / STEP)
    midway = 0.5 * (R_GI + np.concatenate([R_GI[:1], R_GI[:-1]]))
    force = np.einsum("nij,nj->ni", midway, view.log.accel) + GRAVITY_G
    summed = np.cumsum(force * np.diff(view.t, prepend=view.t[0])[:, None], axis=0)
    throughout = view.ok[steps:] & view.ok[:-steps]
    both = (view.means(summed), view.ref_v)
    by_imu, by_reference = ((x[steps:] - x[:-steps])[throughout] for x in both)
    return by_imu, by_reference


@plausibility_rule("reference's motion", "t accel gyro ref", when="trusts_reference")
def motion(view: LogView) -> Iterator[Finding]:
    """Check that the reference's horizontal changes of velocity agree with the accelerometer.

    Compares: changes of speed in the plane over {SPEEDING:g} s, of ref_p and of the
        accelerometer, where they go together.
    Threshold: {SCALED:.0%} in size, {POSITIONS_TURNED:g}° in direction.
    Reason: accelerometers are true to 3 %, and to 1° (MPU-6050): 2 % on a measured Go1.
    Remedy: the calibration of the tracker; ref_p and ref_q in one world.
    """
    by_imu, by_reference = (x[:, :2] @ [1.0, 1.0j] for x in speed_changes(view))
    if len(by_imu) < FEWEST:
        return
    by_imu, by_reference = by_imu - by_imu.mean(), by_reference - by_reference.mean()
    both, sizes = np.vdot(by_imu, by_reference), [by_imu.std(), by_reference.std()]
    if abs(both) < SURELY * len(by_imu) * sizes[0] * sizes[1] or not sizes[0]:
        return
    turned, size = float(np.degrees(np.angle(both))), float(sizes[1] / sizes[0])
    if abs(turned) > POSITIONS_TURNED:
        seen = f"its acceleration is {turned:.0f} deg about z from that of accelerometer and ref_q"
        yield Finding(REF_P, seen, "positions and attitudes are in different worlds")
    elif abs(np.log(size)) > np.log1p(SCALED):
        seen = f"its acceleration is {size:.3g} times that of the accelerometer"
        yield Finding(REF_P, seen, "scaled: the tracker's calibration, or another unit")


@plausibility_rule("reference from legs", "t gyro contact ref", beside="q foot", when="comparable")
def from_legs(view: LogView) -> Iterator[Finding]:
    """Check that the reference is not leg odometry; real feet roll and slip.

    Compares: the velocity of ref_p with that by feet in contact.
    Threshold: alike to {MADE_OF_LEGS:.0%}.
    Reason: feet roll and slip: 7 % in simulated walks, 15 % on a measured Go1.
    Remedy: a reference that was measured; errors against this one only say how far estimates agree.
    """
    few = view.middle
    log, feet_of = few.log, feet_at(few.log, few.robot)
    if feet_of is None or not few.comparable:
        return
    feet = feet_of(np.arange(len(few.t)))
    by_leg = -(np.gradient(feet, few.t, axis=0) + np.cross(log.gyro[:, None], feet))
    count = log.contact.sum(axis=1, keepdims=True)
    weights = log.contact / np.maximum(count, 1)
    odometry = few.means(np.einsum("nl,nli->ni", weights, by_leg))
    throughout = (few.means((count > 0).astype(float))[:, 0] > 0.999) & few.ok
    if throughout.sum() < FEWEST:
        return
    speed = float(np.median(np.linalg.norm(few.v_I[throughout], axis=1)))
    missed = np.median(np.linalg.norm((odometry - few.v_I)[throughout], axis=1))
    if speed > _WALKS and missed < MADE_OF_LEGS * speed:
        seen = f"the velocity by standing feet to {100 * missed / speed:.1g} %"
        cause = "computed from the legs, not measured: they cannot be compared with it"
        yield Finding(REF_P, seen, cause)


def _cross(w: np.ndarray) -> np.ndarray:
    """Cross product matrices (M, 3, 3) of w (M, 3)."""
    return np.cross(w[:, None], np.eye(3)).swapaxes(1, 2)
