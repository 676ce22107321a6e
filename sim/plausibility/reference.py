"""Checks of a reference against itself and the IMU: attitude, position, velocity, clock."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.importing.reference_check import check_reference
from surefoot.sim.log.reference import reference_poses
from surefoot.sim.plausibility.axes import AXIS_NAMES, match_axes
from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.plausibility.view import LogView

FASTEST_LEGS = 12.0
"""Speed that no legged robot has reached [m/s] (WildCat, 8.9 m/s, Boston Dynamics 2013)."""
VELOCITY_OFF = 0.15
"""Relative difference of velocities from the derivative of positions, or of accelerations from the
accelerometer: averaging over a stride and a lever arm cause several percent.
"""
_UNITS = {1e3: "mm", 1e2: "cm", 1.0 / 0.3048: "feet"}
_P = tuple(f"ref_p_{a}" for a in AXIS_NAMES)
_V = tuple(f"ref_v_{a}" for a in AXIS_NAMES)
_Q = tuple(f"ref_q_{a}" for a in "wxyz")


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
    columns = (*_P, *_Q) if fault.late else _Q
    yield Finding(columns, fault.evidence, fault.cause, fault.map_line)


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
    size = float(np.sqrt(np.sum(logged**2) / max(np.sum(moved**2), 1e-12)))
    missed = float(np.sum((logged - moved) ** 2) / max(np.sum(moved**2), 1e-12))
    if missed < VELOCITY_OFF:
        return
    told = f"{size:.3g} times the change of positions"
    if abs(np.log(max(size, 1e-9))) > np.log1p(VELOCITY_OFF):
        unit = _unit(size)
        cause = f"in {unit}/s, not m/s" if unit else "scaled, or positions are"
        line = _unit_line(_V, f"{unit}/s" if unit else "")
        yield Finding(_V, told, cause, line)
        return
    told = f"{100 * missed:.0f} % of its mean square is not the change of positions"
    if np.sum((logged - view.v_I[view.ok]) ** 2) < 0.3 * np.sum((logged - moved) ** 2):
        yield Finding(_V, told, "in the body's axes, not the world's")
        return
    match = match_axes(logged, moved)
    columns = tuple(_V[i] for i in match.wrong) or _V
    words = match.words or "another clock, another body, or a filter that lags"
    yield Finding(columns, told, words)


def _unit(factor: float) -> str:
    """Unit of lengths that are about `factor` times those in metres; "" for none."""
    return next((u for f, u in _UNITS.items() if abs(np.log(max(factor, 1e-9) / f)) < 0.1), "") or (
        # For a speed: walks have 0.1 to 3 m/s.
        ("mm" if factor > 90.0 else "cm") if factor > FASTEST_LEGS else ""
    )


def _unit_line(columns: tuple[str, ...], unit: str) -> str:
    known = unit.removesuffix("/s") in ("mm", "cm")
    return f'{", ".join(columns)} = {{ ..., unit = "{unit}" }}' if known else ""
