"""Which source of contacts suits the leg filter: flags as logged, or detected in another quantity.

The leg filter runs with the contacts of each source, all else equal. With a reference its RPE
judges. Without one, the velocity error that is to be expected from its record: the claimed standard
deviation, times the factor by which sums of innovations exceed theirs
(`surefoot.estimator.evaluation.innovation_sums`). The innovations alone would favour contacts that
leave the filter without measurements. The error alone would favour a few sure rows of each stance,
which are enough for the filter but not for `trace`: of contacts that are about as good, those in
which the feet stand longest are taken.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar, get_args

import numpy as np
import pandas as pd

from surefoot.estimator.evaluation.innovation_sums import COUNT, SUM, VARIANCE
from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.estimator.metrics import matched, relative_errors, segments
from surefoot.scenarios.estimate.run import robot_of, run_filter
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.effects.timing import log_at
from surefoot.sim.importing.advice import Changes
from surefoot.sim.importing.contacts import contact_loads, contacts_from_loads, foot_speeds
from surefoot.sim.importing.sections import ContactTable, Quantity
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.stances import stances_between_swings

T = TypeVar("T")

TRIED = 60.0
"""Part of a log, from its start, on which contacts and remedies are tried [s]."""
DELAYS = (0.01, 0.02, 0.04, 0.06)
"""Delays of a stream that are tried [s], in both directions."""
AS_LOGGED = "as logged"
SHARES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""Thresholds that are tried, as shares of the way from swing to stance."""
USUAL_SHARE = (0.7,)
"""The threshold for a first look: on simulated trots of three robots, errors with it are within
twice the least.
"""
_SWING, _STANCE = 0.05, 0.95
"""Quantiles of a leg's load that are taken for swing and stance: each lasts for more than a
twentieth of a walk.
"""
_DEBOUNCE = 0.02
"""Time that a load must last [s]: a tenth of the shortest stance, and longer than an impact."""
_BLOCKS = 10
"""Number of sections of a log over which the gain must exceed its spread."""
_CLEAR = 1.5
"""Least ratio of the errors at which one source is better than another."""
_STANDS = 0.2
"""Speed of a foot over the ground below which it stands [m/s]; swinging ones have 1 and more."""


@dataclass(frozen=True)
class LogVariant:
    """A log as another import map makes it, such as with contacts from another source: the name of
    the source, the changes of the map, and the log.
    """

    source: str
    changes: Changes
    log: Log


@dataclass(frozen=True)
class TriedContacts:
    """Contacts, the leg filter's estimate with them, and its mean squared error in each of _BLOCKS
    sections (NaN where unknown).
    """

    contacts: LogVariant
    trajectory: Trajectory
    squares: np.ndarray

    @property
    def error(self) -> float:
        """Root mean square; infinite where it is known in no section."""
        known = self.squares[np.isfinite(self.squares)]
        return float(np.sqrt(known.mean())) if len(known) else np.inf

    @property
    def by_threshold(self) -> bool:
        return "contact" in self.contacts.changes

    @property
    def standing(self) -> float:
        """Share of the time in which a foot stands, as a mean over feet."""
        return float(self.contacts.log.contact.mean())


@dataclass(frozen=True)
class ContactComparison:
    """The best contacts of each source, in the order of the error; AS_LOGGED is missing where the
    log has no flags, or the filter diverges with them.
    """

    tried: tuple[TriedContacts, ...]
    by_reference: bool

    @property
    def logged(self) -> TriedContacts | None:
        return next((one for one in self.tried if one.contacts.source == AS_LOGGED), None)

    @property
    def better(self) -> LogVariant | None:
        """The `chosen` contacts, if the least error is clearly less than with those as logged."""
        best, logged, advised = self.tried[0], self.logged, chosen(self.tried)
        if best is logged or not np.isfinite(best.error):
            return None
        if logged is None or not np.isfinite(logged.error):
            return advised.contacts
        with np.errstate(divide="ignore", invalid="ignore"):
            gains = 0.5 * np.log(logged.squares / best.squares)
        gains = gains[np.isfinite(gains)]
        clear = logged.error > _CLEAR * best.error and len(gains) > 2
        doubt = 2.0 * gains.std(ddof=1) / np.sqrt(len(gains)) if clear else np.inf
        return advised.contacts if gains.mean() > doubt else None

    @property
    def lines(self) -> tuple[str, ...]:
        """Errors by source, and what moves while it counts as standing."""
        what, unit = (
            ("RPE over 1 m", "mm")
            if self.by_reference
            else ("velocity error, expected from its innovations,", "mm/s")
        )
        each = (
            f"{_milli(one.error)} {unit} {one.contacts.source} "
            f"(feet stand {100 * one.standing:.0f} %)"
            for one in self.tried
        )
        t = self.tried[0].contacts.log.t
        first = f"leg filter on the first {min(TRIED, t[-1] - t[0]):.0f} s: {what}"
        return f"{first} {', '.join(each)}", *self._motion()

    def _motion(self) -> Iterator[str]:
        best = self.tried[0]
        if self.logged is None or self.better is None:
            return
        log = self.logged.contacts.log
        v_I = interpolate_rows(log.t, best.trajectory.t, best.trajectory.v_I)
        with suppress(SurefootError):
            begin, end = moving_in_contact(log.t, foot_speeds(log, v_I), log.contact)
            yield (
                f"feet still move for {1e3 * begin:.0f} ms after flags begin, and move "
                f"already for {1e3 * end:.0f} ms before they end (median)"
            )


def _milli(x: float) -> str:
    return f"{1e3 * x:.0f}" if x > 0.1 else f"{1e3 * x:.2g}"


def contact_lines(
    log: Log, progress: Callable[[float], None], only_better: bool = False
) -> tuple[tuple[str, ...], Changes]:
    """What to say on the contacts of a log, and changes of the import map that better ones need.

    Args:
        log: whose contacts are compared with those from other sources.
        progress: called with the share done, 0 to 1.
        only_better: whether to say nothing unless a first look finds better ones.
    """
    try:
        robot = robot_of(log)
    except SurefootError:  # its feet may be given
        robot = None
    if only_better:
        first = compare_contacts(log, robot, USUAL_SHARE)
        if first is None or first.better is None:
            return (), {}
    found = compare_contacts(log, robot, progress=progress)
    if found is None:
        return (f"contacts: not compared: {_why_it_does_not_run(log, robot)}",), {}
    changes, said = {} if found.better is None else found.better.changes, found.lines
    if found.better is None:
        said += ("none is clearly better than as logged",)
    if "contact" in changes:
        said += ("in the import map, [contact] replaces contacts of [columns]",)
    return tuple(f"contacts: {line}" for line in said), changes


def _why_it_does_not_run(log: Log, robot: Robot | None) -> str:
    try:
        run_filter("leg", log, robot)
    except SurefootError as error:
        return str(error)
    return "the log is too short"


def rules_of(
    log: Log, robot: Robot | None, shares: Iterable[float] = SHARES
) -> Iterator[Iterator[LogVariant]]:
    """Contacts of a log from each quantity that it has, by rising threshold: along it, the error of
    a filter falls and then rises.
    """
    for of in get_args(Quantity):
        with suppress(SurefootError):
            yield _by_rule(log, of, contact_loads(log, of, robot), shares)


def moved(log: Log, kinds: tuple[str, ...], sign: float) -> Iterator[LogVariant]:
    """The log with the columns of these kinds earlier by each of DELAYS, or later if the sign is
    negative.
    """
    when = "earlier" if sign > 0 else "later"
    for delay in DELAYS:
        changes = {"even": {"late": dict.fromkeys(kinds, sign * delay)}}
        other = log_at(log, kinds, log.t + sign * delay)
        yield LogVariant(f"{AS_LOGGED} but {1e3 * delay:.0f} ms {when}", changes, other)


def _by_rule(
    log: Log, of: Quantity, loads: dict[str, np.ndarray], shares: Iterable[float]
) -> Iterator[LogVariant]:
    """Contacts by one threshold for each leg, between its loads in swing and in stance."""
    sign = ContactTable(0.0, 0.0, of).sign
    for share in shares:
        levels = {}
        for leg, load in loads.items():
            swing, stance = np.quantile(load, (_SWING, _STANCE))
            levels[leg] = float(f"{sign * (swing + share * (stance - swing)):.4g}")
        rule = ContactTable(levels, levels, of, debounce=_DEBOUNCE)
        stands = contacts_from_loads(log.t, loads, rule)
        yield LogVariant(f"from {of}", {"contact": vars(rule)}, log.with_columns(stands))


def compare_contacts(
    log: Log,
    robot: Robot | None,
    shares: Iterable[float] = SHARES,
    progress: Callable[[float], None] = lambda share: None,
) -> ContactComparison | None:
    """Run the leg filter with contacts from each source; None where there is nothing to compare.

    Args:
        log: with an IMU, and joint angles or positions of the feet; its first TRIED seconds count.
        robot: of the log; None for one that has positions of the feet.
        shares: thresholds to try.
        progress: called with the share done, 0 to 1.
    """
    log = log.rows(log.t <= log.t[0] + TRIED)
    by_reference = log.has("reference") and len(segments(reference(log).p_GI)[0]) > 0

    def tried(contacts: LogVariant) -> TriedContacts | None:
        try:
            found = run_filter("leg", contacts.log, robot).trajectory
        except SurefootError:
            return None
        if found.diverged:
            return None
        times, squares = (_by_segments if by_reference else _by_windows)(contacts.log, found)
        return TriedContacts(contacts, found, _in_blocks(log.t, times, squares))

    found = [tried(LogVariant(AS_LOGGED, {}, log))] if log.has("contact") else []
    every = [moved(log, ("contact",), sign) for sign in (1.0, -1.0)] if log.has("contact") else []
    every += rules_of(log, robot, shares)
    for k, source in enumerate(every):
        progress(k / len(every))
        if of_source := falling(map(tried, source), lambda one: one.error):
            found.append(chosen(of_source))
    progress(1.0)
    ranked = sorted((one for one in found if one is not None), key=lambda one: one.error)
    return ContactComparison(tuple(ranked), by_reference) if ranked else None


def chosen(each: Sequence[TriedContacts]) -> TriedContacts:
    """Those of the least error; if they are from a threshold, those in which the feet stand longest
    of all from a threshold whose error is not clearly larger.
    """
    best = min(each, key=lambda one: one.error)
    if not best.by_threshold:
        return best
    equal = (one for one in each if one.by_threshold and one.error <= _CLEAR * best.error)
    return max(equal, key=lambda one: one.standing)


def falling(each: Iterable[T | None], cost: Callable[[T], float]) -> list[T]:
    """Those along which the cost falls; empty where the first one failed."""
    found: list[T] = []
    for one in each:
        if one is None or (found and cost(one) > cost(found[-1])):
            break
        found.append(one)
    return found


def least(each: Iterable[T | None], cost: Callable[[T], float]) -> T | None:
    """That up to which the cost falls; None where the first one failed."""
    return next(reversed(falling(each, cost)), None)


def _by_segments(log: Log, found: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Starts [s] and squared errors [m^2] of the segments of 1 m."""
    true, estimate = matched(reference(log), found)
    return true.t[segments(true.p_GI)[0]], relative_errors(true, estimate)[0] ** 2


def _by_windows(log: Log, found: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Starts [s] of windows and the squared velocity errors [m^2/s^2] to be expected there."""
    if found.innovations is None or found.covariance is None:
        return np.zeros(0), np.zeros(0)
    sums = found.innovations.sums
    window, foot = np.nonzero(sums[..., COUNT] > 0.0)
    sums = sums[window, foot]
    ratio = np.mean(sums[:, SUM : SUM + 3] ** 2 / sums[:, VARIANCE : VARIANCE + 3], axis=1)
    claimed = np.trace(found.covariance[:, 3:6, 3:6], axis1=1, axis2=2).mean()
    return found.innovations.start[window], claimed * ratio


def _in_blocks(t: np.ndarray, times: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Means (_BLOCKS,) of values at times over equal sections of t."""
    edges = np.linspace(t[0], t[-1], _BLOCKS + 1)[1:-1]
    means = pd.Series(squares).groupby(np.searchsorted(edges, times)).mean()
    return means.reindex(range(_BLOCKS)).to_numpy()


def moving_in_contact(t: np.ndarray, speed: np.ndarray, contact: np.ndarray) -> tuple[float, float]:
    """Median times [s] that feet still move after contacts begin, and already before they end.

    Args:
        t: (N,) [s].
        speed: of the feet over the ground (N, L) [m/s].
        contact: (N, L), bool.
    """
    begins, ends = [], []
    for stands, flagged in zip((speed < _STANDS).T, contact.T, strict=True):
        for first, last in zip(*stances_between_swings(t, flagged), strict=True):
            still = first + np.flatnonzero(stands[first:last])
            if len(still):
                begins.append(t[still[0]] - t[first])
                ends.append(t[last - 1] - t[still[-1]])
    return (float(np.median(begins)), float(np.median(ends))) if begins else (0.0, 0.0)
