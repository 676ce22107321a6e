"""What would mend an estimate that is not to be trusted, each tried before it is advised.

A remedy is a change of one thing: the noise of contacts, the times of joints or contacts, the first
state, or a filter that rejects slipping feet. The filter runs again with each, and its innovations
judge: the sum of a window's innovations is normal with the variance that the filter claims, so that
their likelihood is highest where noise, times and contacts are right. Advice is given only if the
estimate is then to be trusted and, where there is a reference, has no larger error.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from surefoot.estimator.evaluation.health import Health
from surefoot.estimator.evaluation.innovation_sums import COUNT, SUM, VARIANCE
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.metrics import CONSISTENT, ONE_WALK, Metrics
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.estimators import estimator_named, traits
from surefoot.scenarios.estimate.run import Result, parameters_of, run_filter
from surefoot.scenarios.estimate.settings import FilterSettings, StartSettings, StateSettings
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

TRIED = 120.0
"""Part of a log, from its start, on which remedies are tried [s]."""
DRIFTING = 2.0
"""Drift of a sensor's innovations from which advice is looked for, 1 if noise is as claimed."""
NOISE_STEP, NOISE_MOST = 10.0**0.1, 30.0
"""Factor between two values of a noise, and the largest factor that is tried."""
DELAYS = (0.01, 0.02, 0.04, 0.06)
"""Delays of a stream that are tried [s], in both directions."""
GAIN = 0.02
"""Least gain of `likelihood`: with four feet, fourteen nats in a minute."""
FAR = 0.1
"""Share of the path from which a position error is a reason for advice."""
KINDS = "contact noise, times of joints and contacts, start, leg_slip"
NO_WORSE = 1.1
"""Largest factor of the position error with a remedy, compared with that without."""


@dataclass(frozen=True)
class Remedy:
    """One change, in words, and what the filter then runs with."""

    words: str
    filter: str
    log: Log
    settings: FilterSettings


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
    """The remedy with the highest likelihood among those that mend an estimate, with its effect, or
    that none of them does.

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

    def tried(remedy: Remedy) -> Result | None:
        try:
            return run_filter(remedy.filter, remedy.log, robot, learnt, remedy.settings)
        except SurefootError:
            return None

    plain = Remedy("", name, log.rows(log.t <= log.t[0] + TRIED), settings)
    before = tried(plain)
    if before is None:
        return ""
    each = [(one, after) for one in _remedies(plain, robot, tried) if (after := tried(one))]
    mending = [
        (likelihood(after.trajectory), one, after) for one, after in each if _mends(before, after)
    ]
    if not mending:
        return f"no single change mends it; tried: {KINDS}"
    _, one, after = max(mending, key=lambda found: found[0])
    return f"{one.words}; tried on this log: {_effect(before, after)}"


def likelihood(trajectory: Trajectory) -> float:
    """Mean log likelihood of a sensor's sum of innovations over a window, per axis and up to a
    constant; -inf without innovations.

    The sums are divided by their counts, so that remedies with other counts can be compared.
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


def _remedies(
    plain: Remedy, robot: Robot | None, tried: Callable[[Remedy], Result | None]
) -> Iterator[Remedy]:
    """Remedies of a filter on a log: the likeliest of each kind, and those that are not sized."""
    estimator, log, settings = estimator_named(plain.filter), plain.log, plain.settings
    values = parameters_of(estimator, robot, settings)
    if "contact" in values:
        least = values["contact"]
        steps = NOISE_STEP ** np.arange(1, 1 + round(np.log(NOISE_MOST) / np.log(NOISE_STEP)))
        yield from _likeliest(
            (_with_noise(plain, float(f"{least * step:.2g}")) for step in steps), tried
        )
    for kinds in (tuple(filter(log.has, ("q", "dq", "foot"))), ("contact",)):
        if all(map(log.has, kinds)):
            yield from _likeliest((_earlier(plain, kinds, d) for d in DELAYS), tried)
            yield from _likeliest((_earlier(plain, kinds, -d) for d in DELAYS), tried)
    own = replace(settings, start=StartSettings(), state=StateSettings())
    if own != settings:
        yield replace(plain, words="leave out start and state of the settings", settings=own)
    if plain.filter == "leg":
        words = "use leg_slip, which rejects feet whose contacts are wrong"
        yield replace(plain, words=words, filter="leg_slip")


def _likeliest(
    remedies: Iterator[Remedy], tried: Callable[[Remedy], Result | None]
) -> Iterator[Remedy]:
    """The remedy up to which the likelihood rises; none where it falls at once."""
    best, highest = None, -np.inf
    for one in remedies:
        result = tried(one)
        if result is None or (value := likelihood(result.trajectory)) < highest:
            break
        best, highest = one, value
    if best is not None:
        yield best


def _with_noise(plain: Remedy, value: float) -> Remedy:
    own = dict(plain.settings.filters.get(plain.filter, {}), contact=value)
    filters = {**plain.settings.filters, plain.filter: own}
    words = f"set filters.{plain.filter}.contact={value:g}, the likeliest by its innovations"
    return replace(plain, words=words, settings=replace(plain.settings, filters=filters))


def _earlier(plain: Remedy, kinds: tuple[str, ...], delay: float) -> Remedy:
    """The log with the columns of these kinds earlier by a delay [s], or later if negative."""
    log, shift = plain.log, round(delay * plain.log.rate)
    at = np.clip(np.arange(len(log.t)) + shift, 0, len(log.t) - 1)
    names = [n for n in map(str, log.frame) if n.startswith(tuple(f"{one}_" for one in kinds))]
    moved = log.with_columns({name: log.frame[name].to_numpy()[at] for name in names})
    late = ", ".join(f"{one} = {delay:g}" for one in kinds)
    words = (
        f"{' and '.join(kinds)} seem {1e3 * abs(delay):.0f} ms {'late' if delay > 0 else 'early'}; "
        f"in the import map: [even] late = {{ {late} }}"
    )
    return replace(plain, words=words, log=moved)


def _mends(before: Result, after: Result) -> bool:
    """Whether a remedy makes an estimate trusted, or consistent, and does not make it worse."""
    if after.health.lost or likelihood(after.trajectory) < likelihood(before.trajectory) + GAIN:
        return False
    old, new = before.metrics, after.metrics
    if old is None or new is None:
        return True
    nees = [abs(np.log(one.nees_position / CONSISTENT)) for one in (old, new)]
    return bool(nees[1] < nees[0] and new.ape_trans <= NO_WORSE * old.ape_trans)


def _effect(before: Result, after: Result) -> str:
    """What a remedy changes, in figures."""
    drifts = [max((s.drift for s in one.health.sensors), default=np.nan) for one in (before, after)]
    pairs = {"drift": drifts}
    if before.metrics is not None and after.metrics is not None:
        each = before.metrics, after.metrics
        pairs["NEES_pos"] = [one.nees_position for one in each]
        pairs["APE_trans [m]"] = [one.ape_trans for one in each]
    return ", ".join(f"{name} {new:.3g} instead of {old:.3g}" for name, (old, new) in pairs.items())
