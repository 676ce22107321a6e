"""Creep of standing feet: displacement by leg odometry beyond that of the body, per stance.

A toe that slides in one direction has less grip in all others, since dry friction opposes the whole
velocity. If the body twists the standing feet against each other, the lost displacement should thus
be proportional to the angle by which they rotate over the ground. Gyro and legs measure that angle;
only the loss per radian is fitted to a reference.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from surefoot import Log
from surefoot.extend import JOINT_WINDOW, derivative
from surefoot.sim.importing.contacts import heights_beside_others, up_in_imu

DISPLACED_OVER = 1.0
"""Time over which displacements by legs and by the reference are compared [s]: some strides, whose
ripple averages out.
"""
_WEIGHED = ("RL", "RR")
"""Legs whose forces are usable on all walks; the map imports them as x_toe_force_<leg>_<axis>."""
_TOUCHING = 10.0
"""Vertical force above which a swinging toe scrapes over the ground [N]; in the air it reads less.
"""
_LAGS = np.arange(-0.15, 0.15, 0.002)
"""Delays of contacts after forces on the grid [s]."""


@dataclass(frozen=True)
class StanceTravel:
    """Displacements while the same feet stand, one row for each stance.

    The rows at which the standing feet change belong to no stance; a filter bridges them by its
    IMU.

    Attributes:
        start: touchdown (S,) [s].
        feet: which feet stand (S, L) bool.
        legs: horizontal displacement of the body by these feet (S, 2) [m], in G.
        body: by the reference (S, 2) [m].
    """

    start: np.ndarray
    feet: np.ndarray
    legs: np.ndarray
    body: np.ndarray

    @property
    def lost(self) -> np.ndarray:
        """Displacement by the legs beyond the body's, along the former (S,) [m]."""
        gone = np.linalg.norm(self.legs, axis=1)
        ahead = self.legs / np.where(gone > 0.0, gone, 1.0)[:, None]
        return gone - np.sum(self.body * ahead, axis=1)


def stance_travel(log: Log) -> StanceTravel:
    """StanceTravel of a log with positions of the feet and a reference."""
    feet_G = np.einsum("nij,nkj->nki", log.ref_R_GI, log.foot_I)[..., :2]
    p_GI = log.ref_p[:, :2]
    rows = [
        (log.t[a], stand, (feet_G[a, stand] - feet_G[b, stand]).mean(axis=0), p_GI[b] - p_GI[a])
        for a, b, stand in _stance_rows(log)
    ]
    start, feet, legs, body = (np.array(column) for column in zip(*rows, strict=True))
    return StanceTravel(start, feet, legs, body)


def turning_of_feet(log: Log) -> float:
    """Total rotation of standing feet over the ground per metre of displacement by the legs
    [rad/m], from the first change of the standing feet to the last; from gyro and feet alone.
    """
    way = [
        np.linalg.norm((log.foot_I[b, stand, :2] - log.foot_I[a, stand, :2]).mean(axis=0))
        for a, b, stand in _stance_rows(log)
    ]
    return float(np.sum(_turned(log)[1:-1]) / np.sum(way[1:-1]))


def travel_share(logs: Sequence[Log]) -> float:
    """Share by which the displacement by standing legs exceeds the body's: least squares of
    horizontal displacements over DISPLACED_OVER seconds.
    """
    return _size(logs, np.ones(len(logs)))


def lost_by_turning(logs: Sequence[Log]) -> float:
    """Displacement lost per radian of rotation of the standing feet [m/rad]: one size for all logs,
    fitted like the share.
    """
    return _size(logs, [turning_of_feet(log) for log in logs])


def with_share(log: Log, share: float) -> Log:
    """The log with horizontal positions of the feet scaled down by a share, about their medians."""
    middle = np.median(log.foot_I, axis=0)
    feet_I = log.foot_I.copy()
    feet_I[..., :2] = middle[:, :2] + (1.0 - share) * (feet_I - middle)[..., :2]
    columns = {
        f"foot_{leg}_{axis}": feet_I[:, k, i]
        for k, leg in enumerate(log.legs)
        for i, axis in enumerate("xyz")
    }
    return log.with_columns(columns)


def lost_way_table(logs: Sequence[Log]) -> pd.DataFrame:
    """One row for each walk: displacement lost as a share, per stance, and per radian of rotation
    of the standing feet, each fitted to that walk alone.
    """
    rows = []
    for log in logs:
        gone = np.linalg.norm(stance_travel(log).legs[1:-1], axis=1)
        row = {
            "walk": log.name,
            "legs go at each stance [mm]": f"{1e3 * gone.mean():.0f}",
            "lost of the way [%]": f"{100 * travel_share([log]):.1f}",
        }
        for legs, lost, _ in _by_feet(log):
            row[f"lost at each stance of {legs} [mm]"] = f"{1e3 * lost.mean():.0f}"
        row["turning of standing feet [rad/m]"] = f"{turning_of_feet(log):.2f}"
        row["lost for each radian [mm]"] = f"{1e3 * lost_by_turning([log]):.0f}"
        rows.append(row)
    return pd.DataFrame(rows)


def single_stances_table(logs: Sequence[Log]) -> pd.DataFrame:
    """One row for each pair of feet: whether they lose more displacement in the stances of a walk
    with more rotation. The fit, which uses the total rotation of each walk, does not use this.
    """
    pairs: dict[str, list[np.ndarray]] = {}
    for log in logs:
        for legs, lost, turned in _by_feet(log):
            apart = np.column_stack([turned - turned.mean(), lost - lost.mean()])
            pairs.setdefault(legs, []).append(apart)
    rows = []
    for legs, walks in pairs.items():
        turned, lost = np.concatenate(walks).T
        slope = turned @ lost / (turned @ turned)
        left = lost - slope * turned
        free = len(lost) - len(walks) - 1
        half_width = 1.96 * np.sqrt(left @ left / free / (turned @ turned))
        rows.append(
            {
                "standing": legs,
                "stances": f"{len(lost)}",
                "lost for each radian [mm]": f"{1e3 * slope:.0f} ± {1e3 * half_width:.0f}",
                "correlation": f"{np.corrcoef(turned, lost)[0, 1]:.2f}",
            }
        )
    return pd.DataFrame(rows)


def forces_table(logs: Sequence[Log]) -> pd.DataFrame:
    """One row for each walk: evidence from the forces on the toes of _WEIGHED, which no fit uses.

    The delay of contacts, the friction of toes that scrape over the ground while they swing, and
    how the velocity of standing toes over the ground correlates with the force on them (friction)
    and with its rate (a spring).
    """
    rows = []
    for log in logs:
        force_I = np.stack(
            [log.frame[[f"x_toe_force_{leg}_{axis}" for axis in "xyz"]] for leg in _WEIGHED], axis=1
        )
        index = [log.legs.index(leg) for leg in _WEIGHED]
        stands = log.contact[:, index]
        exchanges = np.flatnonzero(np.any(stands[1:] != stands[:-1], axis=1)) + 1
        walks = slice(exchanges[0], exchanges[-1])
        force_I, stands = force_I[walks], stands[walks]
        slip_I = _over_ground(log)[walks][:, index]
        up = up_in_imu(log.t, log.gyro, log.accel)
        tilted = heights_beside_others(log.t, log.foot_I, up)[walks][:, index] <= 0
        t = log.t[walks]
        scrapes = ~stands & (force_I[..., 2] > _TOUCHING)
        ahead = np.sign(slip_I[..., 0])
        friction = -np.sum((force_I[..., 0] * ahead)[scrapes]) / np.sum(force_I[scrapes, 2])
        rate_I = np.gradient(force_I, t, axis=0)
        rows.append(
            {
                "walk": log.name,
                "contacts after load, level by accelerometer [ms]": _after(
                    t, tilted, force_I[..., 2]
                ),
                "contacts after load, level by feet [ms]": _after(t, stands, force_I[..., 2]),
                "friction of scraping toes": f"{friction:.2f}",
                "force against slip, fore-aft": _alike(force_I, -slip_I, stands, 0),
                "force against slip, sideways": _alike(force_I, -slip_I, stands, 1),
                "its rate against slip, fore-aft": _alike(rate_I, -slip_I, stands, 0),
                "its rate against slip, sideways": _alike(rate_I, -slip_I, stands, 1),
            }
        )
    return pd.DataFrame(rows)


def _stance_rows(log: Log) -> Iterator[tuple[int, int, np.ndarray]]:
    """First and last row of each stance of two rows or more, and which feet stand (L,)."""
    contact = log.contact
    changes = np.flatnonzero(np.any(contact[1:] != contact[:-1], axis=1)) + 1
    for a, b in pairwise([0, *changes.tolist(), len(contact)]):
        if b - a > 1 and contact[a].any():
            yield a, b - 1, contact[a]


def _by_feet(log: Log) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Each group of feet that stand together, with displacement lost [m] and rotation [rad] in
    each of its stances; without the first and last of a walk, in which it starts and stops.
    """
    found, turned = stance_travel(log), _turned(log)
    inner = np.zeros(len(turned), dtype=bool)
    inner[1:-1] = True
    for group in np.unique(found.feet[inner], axis=0)[::-1]:
        own = inner & np.all(found.feet == group, axis=1)
        yield ", ".join(np.array(log.legs)[group]), found.lost[own], turned[own]


def _turned(log: Log) -> np.ndarray:
    """Total rotation over the ground of the feet of each stance (S,) [rad].

    The line between two feet that stick keeps its direction, so its rotation in I and that of the
    body cancel. A single foot shows no rotation.
    """
    turned = []
    for a, b, stand in _stance_rows(log):
        if stand.sum() < 2:
            turned.append(0.0)
            continue
        t, feet_I = log.t[a : b + 1], log.foot_I[a : b + 1, stand, :2]
        arm = feet_I - feet_I.mean(axis=1, keepdims=True)
        v = np.gradient(arm, t, axis=0)
        across = np.sum(arm[..., 0] * v[..., 1] - arm[..., 1] * v[..., 0], axis=1)
        rate = log.gyro[a : b + 1, 2] + across / np.sum(arm**2, axis=(1, 2))
        turned.append(np.trapezoid(np.abs(rate), t))
    return np.array(turned)


def _size(logs: Sequence[Log], measured: Sequence[float] | np.ndarray) -> float:
    """The size s for which legs (1 - s measured) is closest to the body, over all logs."""
    both = [_displacements(log) for log in logs]
    change = [x * legs for x, (legs, _) in zip(measured, both, strict=True)]
    missed = [legs - body for legs, body in both]
    change, missed = np.concatenate(change), np.concatenate(missed)
    return float(np.sum(change * missed) / np.sum(change**2))


def _displacements(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal displacements (K, 2) [m] of the stances that begin in the same DISPLACED_OVER
    seconds, by standing legs and by the reference.
    """
    found = stance_travel(log)
    window = ((found.start - found.start[0]) / DISPLACED_OVER).astype(int)
    sums = np.zeros((2, window[-1] + 1, 2))
    np.add.at(sums[0], window, found.legs)
    np.add.at(sums[1], window, found.body)
    return sums[0], sums[1]


def _over_ground(log: Log) -> np.ndarray:
    """Velocity of the feet over the ground, by the reference (N, L, 3) [m/s], in I."""
    t, feet_I = log.t, log.foot_I
    v_GI = derivative(t, log.ref_p, JOINT_WINDOW, causal=False)
    v_I = np.einsum("nji,nj->ni", log.ref_R_GI, v_GI)
    dfeet_I = derivative(t, feet_I.reshape(len(t), -1), JOINT_WINDOW, causal=False)
    turning = np.cross(log.gyro[:, None], feet_I)
    return v_I[:, None] + dfeet_I.reshape(feet_I.shape) + turning


def _after(t: np.ndarray, stands: np.ndarray, load: np.ndarray) -> str:
    """Delay of contacts (N, 2) after the load (N, 2) of the same feet, in words [ms]."""
    stands, load = (np.diff(x.astype(float), axis=1)[:, 0] for x in (stands, load))
    inside = (t > t[0] + _LAGS[-1]) & (t < t[-1] + _LAGS[0])
    alike = [np.corrcoef(stands[inside], np.interp(t[inside] - s, t, load))[0, 1] for s in _LAGS]
    return f"{1e3 * _LAGS[int(np.argmax(alike))]:.0f}"


def _alike(a: np.ndarray, b: np.ndarray, rows: np.ndarray, axis: int) -> str:
    """Correlation, about zero, of two quantities (N, L, 3) along an axis, in words."""
    a, b = a[rows, axis], b[rows, axis]
    return f"{np.sum(a * b) / np.sqrt(np.sum(a**2) * np.sum(b**2)):.2f}"
