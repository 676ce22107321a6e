"""Checks of a reference against itself and the IMU: attitude, position, velocity, clock."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.importing.reference import REFERENCE_OFFSET
from surefoot.sim.importing.reference_check import check_reference
from surefoot.sim.log.reference import reference_poses
from surefoot.sim.plausibility.attitude import LATE, LATEST
from surefoot.sim.plausibility.axes import AXIS_NAMES, lag_of, match_axes
from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.plausibility.view import STEP, LogView

FASTEST_LEGS = 12.0
"""Speed that no legged robot has reached [m/s] (WildCat, 8.9 m/s, Boston Dynamics 2013)."""
VELOCITY_OFF = 0.15
"""Relative difference of velocities from the derivative of positions, or of accelerations from the
accelerometer: averaging over a stride and a lever arm cause several percent.
"""
_UNITS = {"mm": 1e3, "cm": 1e2, "inches": 1.0 / 0.0254, "feet": 1.0 / 0.3048}
"""1 m in other units."""
_SURELY = 0.9
"""Correlation from which a delay is the cause."""
DEAD = 0.05
"""Standard deviation of the change of a position [m/s] from which its velocity must vary, too."""
_P = tuple(f"ref_p_{a}" for a in AXIS_NAMES)
_V = tuple(f"ref_v_{a}" for a in AXIS_NAMES)
_Q = tuple(f"ref_q_{a}" for a in "wxyz")
_GYRO = tuple(f"gyro_{a}" for a in AXIS_NAMES)


def even_samples(view: LogView) -> Iterator[Finding]:
    """Check that a reference's samples are evenly spaced and continuous."""
    if not view.log.has("reference"):
        return
    for fault in check_reference(reference_poses(view.log)).faults:
        told = fault.removeprefix("reference: ")
        yield Finding((*_P, *_Q), told, "the tracker lost the body, or its stamps are not its own")


def attitude(view: LogView) -> Iterator[Finding]:
    """Check that the reference rotates with the gyro, without a delay, and that gravity points
    down.
    """
    fault = view.attitude
    if fault is None:
        return
    if fault.late and _accelerometer_agrees(view, fault.late):
        told = f"{fault.evidence}, and the accelerometer does not"
        yield Finding(_GYRO, told, "a filter, or another clock, of the gyro alone")
        return
    if not fault.late:
        yield Finding(_Q, fault.evidence, fault.cause, fault.map_line)
        return
    offset = view.log.meta.model.get(REFERENCE_OFFSET, 0.0) - fault.late
    yield Finding((*_P, *_Q), fault.evidence, fault.cause, f"[reference] offset = {offset:.3f}")


def _accelerometer_agrees(view: LogView, late: float) -> bool:
    """Whether the accelerometer contradicts a delay [s] of the reference against the gyro."""
    late_by_force, alike = lag_of(view.accel[view.ok], view.felt[view.ok], STEP, LATEST)
    return alike > _SURELY and abs(late_by_force) < 0.5 * abs(late)


def position(view: LogView) -> Iterator[Finding]:
    """Check that positions are in metres, by the speed."""
    if not view.comparable or not view.log.has("reference") or not view.ok.any():
        return
    speed = float(np.median(np.linalg.norm(view.ref_v[view.ok], axis=1)))
    if speed > FASTEST_LEGS:
        unit = _unit(speed)
        told = f"median speed {speed:.4g} m/s"
        yield Finding(_P, told, f"in {unit}, not m", _unit_line(_P, unit))


def velocity(view: LogView) -> Iterator[Finding]:
    """Check that the reference's velocity is the derivative of its positions, in the world."""
    if not view.log.has("ref_v") or not view.comparable or not view.ok.any():
        return
    logged = view.means(view.log.ref_v)[view.ok]
    moved = view.ref_v[view.ok]
    if np.sqrt(np.mean(np.sum(moved**2, axis=1))) < 0.05 and np.abs(logged).max() < 1.0:
        return
    still = np.ptp(view.log.ref_v, axis=0) == 0.0
    dead = np.flatnonzero(still & (moved.std(axis=0) > DEAD))
    if 0 < dead.size < 3:
        told = "one value in every row while positions change"
        yield Finding(tuple(_V[i] for i in dead), told, "not measured")
    size = float(np.sqrt(np.sum(logged**2) / max(np.sum(moved**2), 1e-12)))
    missed = float(np.sum((logged - moved) ** 2) / max(np.sum(moved**2), 1e-12))
    if missed < VELOCITY_OFF:
        return
    told = f"{size:.3g} times the change of positions"
    if abs(np.log(max(size, 1e-9))) > np.log1p(VELOCITY_OFF):
        unit = "km/h" if abs(size / 3.6 - 1.0) < 0.04 else f"{_unit(size)}/s"
        cause = f"in {unit}, not m/s" if unit != "/s" else "scaled, or positions are"
        line = _unit_line(_V, unit)
        yield Finding(_V, told, cause, line)
        return
    told = f"{100 * missed:.0f} % of its mean square is not the change of positions"
    if np.sum((logged - view.v_I[view.ok]) ** 2) < 0.3 * np.sum((logged - moved) ** 2):
        yield Finding(_V, told, "in the body's axes, not the world's")
        return
    match = match_axes(logged, moved)
    late, shifted = lag_of(logged, moved, STEP, LATEST)
    if abs(late) > view.least_lag(LATE) and shifted > max(_SURELY, match.best.mean()):
        told = f"{1e3 * abs(late):.0f} ms {'late' if late > 0 else 'early'}"
        told += " against the change of ref_p"
        yield Finding(_V, told, "a filter, or stamps of another clock")
        return
    columns = tuple(_V[i] for i in match.wrong) or _V
    words = match.words or "another clock, another body, or a filter that lags"
    yield Finding(columns, told, words)


def _unit(factor: float) -> str:
    """Unit of lengths that are about `factor` times those in metres; "" for none."""
    unit, one = min(_UNITS.items(), key=lambda known: abs(np.log(max(factor, 1e-9) / known[1])))
    if abs(np.log(max(factor, 1e-9) / one)) < 0.1:
        return unit
    # For a speed: walks have 0.1 to 3 m/s.
    return ("mm" if factor > 90.0 else "cm") if factor > FASTEST_LEGS else ""


def _unit_line(columns: tuple[str, ...], unit: str) -> str:
    known = unit.removesuffix("/s") in ("mm", "cm")
    return f'{", ".join(columns)} = {{ ..., unit = "{unit}" }}' if known else ""
