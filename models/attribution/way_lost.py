"""Way that standing feet lose: by how much the body goes less far than its legs say.

The displacement by the legs within about a second less that of the reference is proportional to the
former (`foot_creep`), or to the angle by which the standing feet turn over the ground
(`foot_scrub`). Either size is a least-squares fit. Parts of the logs, whole runs where there are
enough, are left out in turn to tell how well each law predicts them, and how sure its size is; the
law is chosen by this and by the prior of its size.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from surefoot.models.attribution.effect_sizes import Found
from surefoot.models.attribution.evidence import LogUnderModel
from surefoot.sim.effects import effect, known_effects
from surefoot.sim.effects.creep import way_by_feet

LAWS = ("foot_creep", "foot_scrub")
WINDOW = 1.0
"""Time over which displacements are compared [s]: some strides, whose ripple averages out."""
LIKELIER = 3.0
"""Difference in ln(odds) from which one law is said to be likelier than the other: 20 to 1."""
SHORTEST_WAY = 1.0
"""Way of all logs from which the feet show what they lose [m]; at rest there is noise alone."""
_EXACT = 1e-12
"""Squared way [m^2] below which there is rounding alone."""
FEWEST_RUNS = 4
"""Runs from which each is a part; the quarters of fewer ones are."""


@dataclass(frozen=True)
class WayLost:
    """What is known of the way that standing feet lose.

    Attributes:
        found: the effect; empty if the feet lose none that is significant.
        notes: for the reader.
    """

    found: tuple[Found, ...] = ()
    notes: tuple[str, ...] = ()


def way_lost(cases: Sequence[LogUnderModel], held_out: Sequence[LogUnderModel] = ()) -> WayLost:
    """The law by which standing feet lose way, and its size.

    Args:
        cases: logs under the model.
        held_out: logs of the same machine; an effect that makes their way worse is not found.
    """
    runs = [_stances(case) for case in cases if _shows_way(case)]
    if sum(run.length.sum() for run in runs) < SHORTEST_WAY:
        return WayLost()
    if len(runs) < FEWEST_RUNS:
        runs = [quarter for run in runs for quarter in run.quarters()]
    n = len(runs)
    others = [[*runs[:k], *runs[k + 1 :]] for k in range(n)]
    without = np.array([[_size(rest, law) for rest in others] for law in LAWS])
    sizes = [_size(runs, law) for law in LAWS]
    plain = sum(run.missed(LAWS[0], 0.0) for run in runs)
    left = [
        sum(run.missed(law, size) for run, size in zip(runs, by_others, strict=True))
        for law, by_others in zip(LAWS, without, strict=True)
    ]
    # Of the displacements along two axes, normal with an unknown variance, and of the size.
    free = sum(len(np.unique(run.window)) for run in runs)
    within = [known_effects()[law].size_prior().within / 1.96 for law in LAWS]
    against = free * np.log(np.maximum(left, _EXACT)) + 0.5 * (np.array(sizes) / within) ** 2
    best = int(np.argmin(against))
    law, size = LAWS[best], sizes[best]
    spread = np.sum((without[best] - without[best].mean()) ** 2)
    half = float(student.ppf(0.975, n - 1) * np.sqrt((n - 1) / n * spread))
    if against[best] >= free * np.log(max(plain, _EXACT)) or abs(size) <= half:
        return WayLost()
    unseen = [_stances(case) for case in held_out if _shows_way(case)]
    worse = [run for run in unseen if run.missed(law, size) > run.missed(law, 0.0)]
    if worse:
        many = f"{len(worse)} of {len(unseen)} held-out runs"
        return WayLost((), (f"{law}: not found, {many} are worse with it",))
    note = (
        f"{law}: predicts {100.0 * (1.0 - left[best] / plain):.0f} % of the squared way lost in "
        "parts that it was not fitted to"
    )
    if against[1 - best] - against[best] < LIKELIER:
        motion = known_effects()[law].traced.motion
        note += f"; {LAWS[1 - best]} does nearly as well; to tell them apart, {motion}"
    return WayLost((Found(effect(law, "all", size), (size - half, size + half)),), (note,))


def _shows_way(case: LogUnderModel) -> bool:
    """Whether a log gives feet, contacts, an IMU and a reference."""
    groups = ("imu", "foot", "contact", "reference")
    there = case.by_feet and all(case.log.has(group) for group in groups)
    return bool(there and case.log.contact.any())


@dataclass(frozen=True)
class _Stances:
    """Horizontal displacements of a log in its S stances.

    Attributes:
        legs: by the standing feet (S, 2) [m], in the world.
        body: by the reference (S, 2) [m].
        length: of the former (S,) [m].
        turned: angle by which the standing feet turn (S,) [rad].
        window: of WINDOW to which it belongs (S,).
    """

    legs: np.ndarray
    body: np.ndarray
    length: np.ndarray
    turned: np.ndarray
    window: np.ndarray

    def missed(self, law: str, size: float) -> float:
        """Squared error [m^2] of the body's displacements in all windows by a law of this size."""
        share = known_effects()[law].share_lost(size, self.length, self.turned)
        off = (1.0 - share)[:, None] * self.legs - self.body
        return float(sum(np.sum(np.bincount(self.window, x) ** 2) for x in off.T))

    def quarters(self) -> "list[_Stances]":
        """Four parts of the log, one after the other."""
        parts = np.array_split(np.arange(len(self.window)), 4)
        return [_Stances(*(getattr(self, f.name)[p] for f in fields(self))) for p in parts]


def _stances(case: LogUnderModel) -> _Stances:
    """The stances of a log."""
    log = case.log
    way = way_by_feet(log)
    steps = np.einsum("nij,nj->ni", log.ref_R_GI, way.step_I)[:, :2]
    moved = np.diff(log.ref_p[:, :2], axis=0, prepend=log.ref_p[:1, :2])
    used = way.shown & log.ref_ok & np.append(False, log.ref_ok[:-1])
    legs, body = np.zeros((2, len(way.length), 2))
    np.add.at(legs, way.stance[used], steps[used])
    np.add.at(body, way.stance[used], moved[used])
    begin = np.searchsorted(way.stance, np.arange(len(way.length)))
    window = ((log.t[begin] - log.t[0]) / WINDOW).astype(int)
    return _Stances(legs, body, way.length, way.turned, window)


def _size(runs: Sequence[_Stances], law: str) -> float:
    """The size with which a law misses the body's displacements least."""
    bounds = known_effects()[law].bounds

    def missed(size: float) -> float:
        return sum(run.missed(law, size) for run in runs)

    return float(minimize_scalar(missed, bounds=bounds, method="bounded").x)
