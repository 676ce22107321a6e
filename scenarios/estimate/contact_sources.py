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

from surefoot.estimator.evaluation.innovation_sums import COUNT, SUM, VARIANCE
from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.estimator.metrics import segments
from surefoot.scenarios.estimate.run import robot_of, run_filter
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects.resampling import log_at
from surefoot.sim.importing.advice import Changes
from surefoot.sim.importing.contacts import contact_loads, contacts_from_loads
from surefoot.sim.importing.sections import ContactTable, Quantity
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

T = TypeVar("T")

TRIED = 60.0
"""Part of a log, from its start, on which contacts and remedies are tried [s]."""
DELAYS = (0.01, 0.02, 0.04, 0.06)
"""Delays of a stream that are tried [s], in both directions."""
AS_LOGGED = "as logged"
SHARES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""Thresholds that are tried, as shares of the way from swing to stance."""
_SWING, _STANCE = 0.05, 0.95
"""Quantiles of a leg's load that are taken for swing and stance: each lasts for more than a
twentieth of a walk.
"""
_DEBOUNCE = 0.02
"""Time that a load must last [s]: a tenth of the shortest stance, and longer than an impact."""
_CLEAR = 1.5
"""Least ratio of the errors at which one source is better than another."""


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
    """Contacts, and the leg filter's error with them: RPE [m] or, without a reference, the velocity
    error [m/s] to be expected; infinite where it is unknown.
    """

    contacts: LogVariant
    error: float

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
        least, logged = self.tried[0].error, self.logged
        clear = np.isfinite(least) and (logged is None or logged.error > _CLEAR * least)
        return chosen(self.tried).contacts if clear else None

    @property
    def line(self) -> str:
        """Errors by source."""
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
        return f"{first} {', '.join(each)}"


def _milli(x: float) -> str:
    return f"{1e3 * x:.0f}" if x > 0.1 else f"{1e3 * x:.2g}"


def contact_lines(
    log: Log, progress: Callable[[float], None], only_better: bool = False
) -> tuple[tuple[str, ...], Changes]:
    """What to say on the contacts of a log, and changes of the import map that better ones need.

    Args:
        log: whose contacts are compared with those from other sources.
        progress: called with the share done, 0 to 1.
        only_better: whether to say nothing unless there are better ones.
    """
    try:
        robot = robot_of(log)
    except SurefootError:  # its feet may be given
        robot = None
    try:
        found = compare_contacts(log, robot, progress)
    except SurefootError as error:
        return () if only_better else (f"contacts: not compared: {error}",), {}
    if only_better and found.better is None:
        return (), {}
    changes, said = {} if found.better is None else found.better.changes, [found.line]
    if found.better is None:
        said.append("none is clearly better than as logged")
    if "contact" in changes:
        said.append("in the import map, [contact] replaces contacts of [columns]")
    return tuple(f"contacts: {line}" for line in said), changes


def rules_of(log: Log, robot: Robot | None) -> Iterator[Iterator[LogVariant]]:
    """Contacts of a log from each quantity that it has, by rising threshold: along it, the error of
    a filter falls and then rises.
    """
    for of in get_args(Quantity):
        with suppress(SurefootError):
            yield _by_rule(log, of, contact_loads(log, of, robot))


def moved(log: Log, kinds: tuple[str, ...], sign: float) -> Iterator[LogVariant]:
    """The log with the columns of these kinds earlier by each of DELAYS, or later if the sign is
    negative.
    """
    when = "earlier" if sign > 0 else "later"
    for delay in DELAYS:
        changes = {"even": {"late": dict.fromkeys(kinds, sign * delay)}}
        other = log_at(log, kinds, log.t + sign * delay)
        yield LogVariant(f"{AS_LOGGED} but {1e3 * delay:.0f} ms {when}", changes, other)


def _by_rule(log: Log, of: Quantity, loads: dict[str, np.ndarray]) -> Iterator[LogVariant]:
    """Contacts by one threshold for each leg, between its loads in swing and in stance."""
    sign = ContactTable(0.0, 0.0, of).sign
    for share in SHARES:
        levels = {}
        for leg, load in loads.items():
            swing, stance = np.quantile(load, (_SWING, _STANCE))
            levels[leg] = float(f"{sign * (swing + share * (stance - swing)):.4g}")
        rule = ContactTable(levels, levels, of, debounce=_DEBOUNCE)
        stands = contacts_from_loads(log.t, loads, rule)
        yield LogVariant(f"from {of}", {"contact": vars(rule)}, log.with_columns(stands))


def compare_contacts(
    log: Log, robot: Robot | None, progress: Callable[[float], None] = lambda share: None
) -> ContactComparison:
    """Run the leg filter with contacts from each source. Raises SurefootError, saying why, where it
    runs with none.

    Args:
        log: with an IMU, and joint angles or positions of the feet; its first TRIED seconds count.
        robot: of the log; None for one that has positions of the feet.
        progress: called with the share done, 0 to 1.
    """
    log = log.rows(log.t <= log.t[0] + TRIED)
    by_reference = log.has("reference") and len(segments(reference(log).p_GI)[0]) > 0
    faults: list[str] = []

    def tried(contacts: LogVariant) -> TriedContacts | None:
        try:
            result = run_filter("leg", contacts.log, robot)
        except SurefootError as error:
            faults.append(str(error))
            return None
        if result.trajectory.diverged:
            return None
        if by_reference and result.metrics is not None:
            return TriedContacts(contacts, result.metrics.rpe_trans)
        return TriedContacts(contacts, _expected_error(result.trajectory))

    found = [tried(LogVariant(AS_LOGGED, {}, log))] if log.has("contact") else []
    every = [moved(log, ("contact",), sign) for sign in (1.0, -1.0)] if log.has("contact") else []
    every += rules_of(log, robot)
    for k, source in enumerate(every):
        progress(k / len(every))
        if of_source := falling(map(tried, source), lambda one: one.error):
            found.append(chosen(of_source))
    progress(1.0)
    ranked = sorted((one for one in found if one is not None), key=lambda one: one.error)
    if not ranked:
        raise SurefootError(faults[0] if faults else "the log is too short")
    return ContactComparison(tuple(ranked), by_reference)


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


def _expected_error(found: Trajectory) -> float:
    """Velocity error [m/s] to be expected: that claimed, times the factor by which sums of
    innovations exceed theirs; infinite without any.
    """
    if found.innovations is None or found.covariance is None:
        return np.inf
    sums = found.innovations.sums
    sums = sums[sums[..., COUNT] > 0.0]
    if not len(sums):
        return np.inf
    ratio = np.mean(sums[:, SUM : SUM + 3] ** 2 / sums[:, VARIANCE : VARIANCE + 3])
    claimed = np.trace(found.covariance[:, 3:6, 3:6], axis1=1, axis2=2).mean()
    return float(np.sqrt(claimed * ratio))
