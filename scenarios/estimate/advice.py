"""What would mend an estimate that is not to be trusted, each tried before it is advised.

A remedy is a change of one thing: the noise of contacts, the times of joints or contacts, the first
state, or a filter that rejects slipping feet. The filter runs again with each, and its innovations
judge. The sum of a window's innovations is normal with the variance that the filter claims if noise
and times are right: a noise is sized by the likelihood of these sums, a delay by their drift, since
it changes which samples count. Advice is given only if the estimate is then to be trusted and,
where there is a reference, has no larger error.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from surefoot.estimator.evaluation.health import Health
from surefoot.estimator.evaluation.innovation_sums import COUNT, SUM, VARIANCE
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.metrics import CONSISTENT, ONE_WALK, Metrics
from surefoot.scenarios.estimate.contact_sources import TRIED, LogVariant, least, moved, rules_of
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.estimators import estimator_named, traits
from surefoot.scenarios.estimate.run import Result, parameters_of, run_filter
from surefoot.scenarios.estimate.settings import FilterSettings, StartSettings, StateSettings
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.advice import advice_words
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

DRIFTING = 2.0
"""Drift of a sensor's innovations from which advice is looked for, 1 if noise is as claimed."""
NOISE_STEPS = 10.0 ** np.arange(0.1, 1.5, 0.1)
"""Factors of a noise that are tried."""
GAIN = 0.02
"""Least gain of `likelihood`: with four feet, fourteen nats in a minute."""
FAR = 0.1
"""Share of the path from which a position error is a reason for advice."""
NO_WORSE = 1.1
"""Largest factor of the position error with a remedy, compared with that without."""
LEARN = (
    "; train the observer on walks like this one, or tune it on a stretch of such a walk with a "
    "reference: surefoot train --from"
)
"""What mends an observer on a walk that is unlike those of its training."""
PATIENCE = 30.0
"""Time after which no further change is tried [s]; all are with a filter whose stream runs over a
log at once.
"""


@dataclass(frozen=True)
class Trial:
    """A remedy in words, what the filter ran with, and its result."""

    words: str
    filter: str
    log: Log
    settings: FilterSettings
    result: Result

    @property
    def likelihood(self) -> float:
        return likelihood(self.result.trajectory)

    @property
    def drift(self) -> float:
        """The largest of a sensor; NaN without innovations."""
        return max((sensor.drift for sensor in self.result.health.sensors), default=np.nan)

    @property
    def errors(self) -> tuple[float, float]:
        """NEES of the position, and position error [m]; NaN without a reference."""
        found = self.result.metrics
        return (np.nan, np.nan) if found is None else (found.nees_position, found.ape_trans)

    @property
    def cost(self) -> float:
        """Position error times the factor by which the filter is overconfident; without a
        reference, the drift.
        """
        nees, far = self.errors
        return self.drift if np.isnan(far) else far * np.sqrt(max(nees / CONSISTENT, 1.0))


Try = Callable[..., Trial | None]
"""Runs the filter with a change of `words`, `filter`, `log` or `settings`; None where it cannot."""


def needs_advice(name: str, metrics: Metrics | None, health: Health) -> bool:
    """Whether an estimate is not to be trusted, drifts, is overconfident or far off; and that of a
    filter without any measurement always.
    """
    drifts = any(one.drift > DRIFTING for one in health.sensors)
    wrong = metrics is not None and (
        metrics.nees_position > ONE_WALK[1] or metrics.ape_trans > FAR * metrics.length
    )
    return health.lost or drifts or wrong or traits(name).floor


def advice(
    name: str, log: Log, robot: Robot | None, learnt: Learnt, settings: FilterSettings
) -> str:
    """The remedy that mends an estimate best (`Trial.cost`), with its effect, or that none does.

    Args:
        name: of the filter.
        log: as read; its declared effects are compensated here.
        robot: of the log.
        learnt: observers and bounds.
        settings: with which the filter ran.
    """
    if traits(name).floor:
        return (
            f"{name} has no measurement of velocity, so that its position drifts within seconds; "
            "it is the baseline of the filters that have legs or an observer"
        )

    first = log.rows(log.t <= log.t[0] + TRIED)
    until = np.inf

    def tried(words="", filter=name, log=first, settings=settings) -> Trial | None:
        if perf_counter() > until:
            return None
        try:
            result = run_filter(filter, log, robot, learnt, settings)
        except SurefootError:
            return None
        return Trial(words, filter, log, settings, result)

    before = tried()
    if before is None:
        return ""
    until = perf_counter() + PATIENCE
    contact = parameters_of(estimator_named(name), robot, settings).get("contact")
    mending = [one for one in _trials(before, contact, tried) if one and _mends(before, one)]
    best = min(mending, key=lambda one: one.cost, default=None)
    # Contacts are replaced only where else another filter would be.
    if contact is not None and (best is None or best.filter != name):
        rules = [_imported(of, tried) for of in rules_of(first, robot)]
        mending += [one for one in rules if one and _mends(before, one)]
    left = "; not all changes were tried, as each run takes long" * (perf_counter() > until)
    if not mending:
        unlike = before.result.trajectory.unlike
        far = unlike is not None and bool((unlike[-1:] > 1.0).any())  # empty without an estimate
        return (
            "no single change of contact noise, source of contacts, times of joints and contacts "
            f"or start mends it{left}{LEARN * far}"
        )
    best = min(mending, key=lambda one: one.cost)
    return f"{best.words}; tried on this log: {_effect(before, best)}{left}"


def likelihood(trajectory: Trajectory) -> float:
    """Mean log likelihood of a sensor's mean innovation in a window, per axis and up to a constant;
    -inf without innovations.
    """
    if trajectory.innovations is None:
        return -np.inf
    sums = trajectory.innovations.sums
    sums = sums[sums[..., COUNT] > 0.0]
    if not len(sums):
        return -np.inf
    variance = sums[:, VARIANCE : VARIANCE + 3]
    squared = sums[:, SUM : SUM + 3] ** 2 / variance
    return float(-0.5 * np.mean(squared + np.log(variance / sums[:, COUNT : COUNT + 1] ** 2)))


def _trials(before: Trial, contact: float | None, tried: Try) -> Iterator[Trial | None]:
    """Remedies of a filter on a log, tried: the best of each kind, and those without a size; None
    for one that cannot run.

    contact: noise of contacts with which the filter ran; None without any.
    """
    log, settings = before.log, before.settings
    usual = replace(settings, start=StartSettings(), state=StateSettings())
    if usual != settings:
        yield tried("leave out what the settings say of start and state", settings=usual)
    if other := traits(before.filter).rejecting:
        yield tried(f"use {other}, which rejects feet whose contacts are wrong", filter=other)
    if contact is not None:
        noises = (_with_noise(before, contact * step, tried) for step in NOISE_STEPS)
        yield least(noises, lambda one: -one.likelihood)
    for kinds in (tuple(filter(log.has, ("q", "dq", "foot"))), ("contact",)):
        for sign in (1.0, -1.0) if all(map(log.has, kinds)) else ():
            yield _imported(moved(log, kinds, sign), tried)


def _imported(variants: Iterable[LogVariant], tried: Try) -> Trial | None:
    """The best of some changes of the import map, tried."""
    trials = (
        tried(f"in the import map: {advice_words(one.changes)}", log=one.log) for one in variants
    )
    return least(trials, lambda one: one.drift)


def _with_noise(before: Trial, contact: float, tried: Try) -> Trial | None:
    value, name, every = float(f"{contact:.2g}"), before.filter, before.settings.filters
    filters = {**every, name: {**every.get(name, {}), "contact": value}}
    words = f"set filters.{name}.contact={value:g}, the likeliest by its innovations"
    return tried(words, settings=replace(before.settings, filters=filters))


def _mends(before: Trial, after: Trial) -> bool:
    """Whether an estimate is then to be trusted, does not drift, and is neither less likely nor
    worse.
    """
    lost, likelier = before.result.health.lost, after.likelihood - before.likelihood
    if after.result.health.lost or after.drift > DRIFTING or likelier < (0.0 if lost else GAIN):
        return False
    if before.result.metrics is None or after.result.metrics is None:
        return True
    (old, far), (new, farther) = before.errors, after.errors
    return max(new, CONSISTENT) <= max(old, CONSISTENT) and farther <= NO_WORSE * far


def _effect(before: Trial, after: Trial) -> str:
    """What a remedy changes, in figures."""
    pairs = {"drift": (before.drift, after.drift)}
    if before.result.metrics is not None and after.result.metrics is not None:
        names = "NEES_pos", "APE_trans [m]"
        pairs |= dict(zip(names, zip(before.errors, after.errors, strict=True), strict=True))
    return ", ".join(f"{name} {new:.3g} instead of {old:.3g}" for name, (old, new) in pairs.items())
