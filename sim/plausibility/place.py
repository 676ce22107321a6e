"""Checks of a reference's origin: tracked point, scale and heading by the accelerometer, and
whether it was derived from the legs.
"""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.plausibility.axes import MENDED, REF_P, SCALED, SURELY
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.stance import feet_at
from surefoot.sim.plausibility.view import FEWEST, MIDDLE, STEP, LogView

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
        where = ", ".join(f"{x:.2f}" for x in p_IM.round(2) + 0.0)
        seen = f"{100 * explained:.0f} % of what the accelerometer differs by"
        cause = f"of a point at ({where}) m in the IMU's axes, not of the IMU; try surefoot align"
        changes = {"reference": {"p_IM": tuple((p_IM.round(2) + 0.0).tolist())}}
        yield Finding(REF_P, seen, cause, changes)


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
    return (p_IM, float(explained)) if elsewhere else None


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
    both = np.vdot(by_imu, by_reference)
    power = [float(np.vdot(x, x).real) for x in (by_imu, by_reference)]
    if abs(both) < SURELY * np.sqrt(power[0] * power[1]) or not power[0]:
        return
    turned = float(np.degrees(np.angle(both)))
    size = float(np.sqrt(power[1] / power[0]))
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
    begin = 0.5 * (view.t[0] + view.t[-1] - MIDDLE)
    rows = (view.t >= begin) & (view.t <= begin + MIDDLE)
    few = LogView(view.log.rows(rows), view.machine)
    log, feet_of = few.log, feet_at(few.log, few.robot)
    if feet_of is None or not few.comparable:
        return
    feet = feet_of(np.arange(len(few.t)))
    standing = log.contact[:, :, None]
    by_leg = -(np.gradient(feet, few.t, axis=0) + np.cross(log.gyro[:, None], feet))
    count = standing.sum(axis=1)
    odometry = few.means(np.sum(by_leg * standing, axis=1) / np.maximum(count, 1))
    throughout = (few.means((count > 0).astype(float))[:, 0] > 0.999) & few.ok
    if throughout.sum() < FEWEST:
        return
    speed = float(np.median(np.linalg.norm(few.v_I[throughout], axis=1)))
    missed = np.median(np.linalg.norm((odometry - few.v_I)[throughout], axis=1))
    if speed > _WALKS and missed < MADE_OF_LEGS * speed:
        seen = f"the velocity by standing feet to {100 * missed / speed:.1g} %"
        yield Finding(
            REF_P, seen, "computed from the legs, not measured: they cannot be compared with it"
        )


def _cross(w: np.ndarray) -> np.ndarray:
    """Cross product matrices (M, 3, 3) of w (M, 3)."""
    return np.cross(w[:, None], np.eye(3)).swapaxes(1, 2)
