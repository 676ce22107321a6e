"""Evidence on standing feet that lose way, which no fit of `trace` uses: stance by stance, and by
the forces on the toes.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from surefoot import Log
from surefoot.extend import JOINT_WINDOW, derivative, way_by_feet
from surefoot.sim.importing.contacts import heights_beside_others, up_in_imu

_WEIGHED = ("RL", "RR")
"""Legs whose forces are usable on all walks; the map imports them as x_toe_force_<leg>_<axis>."""
_TOUCHING = 10.0
"""Vertical force above which a swinging toe scrapes over the ground [N]; in the air it reads less.
"""
_LAGS = np.arange(-0.15, 0.15, 0.002)
"""Delays of contacts after forces on the grid [s]."""


def lost_way_table(logs: Sequence[Log]) -> pd.DataFrame:
    """One row for each walk: way by the legs, share of it lost, and turning of standing feet."""
    rows = []
    for log in logs:
        stances = pd.concat([one for _, one in _stances(log)])
        way, lost, turned = stances.sum()
        rows.append(
            {
                "walk": log.name,
                "legs go at each stance [mm]": f"{1e3 * stances['way'].mean():.0f}",
                "lost of the way [%]": f"{100.0 * lost / way:.1f}",
                **{
                    f"lost at each stance of {feet} [mm]": f"{1e3 * one['lost'].mean():.0f}"
                    for feet, one in _stances(log)
                },
                "turning of standing feet [rad/m]": f"{turned / way:.2f}",
            }
        )
    return pd.DataFrame(rows)


def single_stances_table(logs: Sequence[Log]) -> pd.DataFrame:
    """One row for each pair of feet: whether they lose more way in the stances of a walk in which
    they turn more.
    """
    pairs: dict[str, list[pd.DataFrame]] = {}
    for log in logs:
        for feet, one in _stances(log):
            pairs.setdefault(feet, []).append(one - one.mean())
    rows = []
    for feet, walks in pairs.items():
        _, lost, turned = pd.concat(walks).to_numpy().T
        slope = turned @ lost / (turned @ turned)
        left = lost - slope * turned
        free = len(lost) - len(walks) - 1
        half_width = 1.96 * np.sqrt(left @ left / free / (turned @ turned))
        rows.append(
            {
                "standing": feet,
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


def _stances(log: Log) -> Iterator[tuple[str, pd.DataFrame]]:
    """Each group of feet that stand together: their way [m] by the legs, what of it the body does
    not go [m], and the angle [rad] by which they turn, in each stance but the first and last.
    """
    way = way_by_feet(log)
    moved_G = np.diff(log.ref_p, axis=0, prepend=log.ref_p[:1])
    moved_I = np.einsum("nji,nj->ni", log.ref_R_GI, moved_G)
    legs, body = np.zeros((2, len(way.length), 3))
    np.add.at(legs, way.stance, way.step_I)
    np.add.at(body, way.stance[way.shown], moved_I[way.shown])
    along = np.sum(legs * body, axis=1) / np.maximum(way.length, 1e-9)
    feet = log.contact[np.searchsorted(way.stance, np.arange(len(way.length)))]
    inner = np.any(feet, axis=1)
    inner[[0, -1]] = False
    for group in np.unique(feet[inner], axis=0)[::-1]:
        own = inner & np.all(feet == group, axis=1)
        columns = {"way": way.length, "lost": way.length - along, "turned": way.turned}
        table = pd.DataFrame({name: x[own] for name, x in columns.items()})
        yield ", ".join(np.array(log.legs)[group]), table


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
