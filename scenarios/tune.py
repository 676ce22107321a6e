"""`surefoot tune`: search the parameters of any filter, with one budget of runs.

The cost of a filter on a log is

    log(APE_trans / path length) + PRICE |log(NEES_pos / 3)|,

averaged over logs, so that both errors and a wrong covariance cost: NEES off 3 by the factor e
costs as much as an APE larger by the factor e^PRICE. Both are clipped: a diverged estimate costs as
much as one whose error is the path. The search is a compass search over the logarithms of the
parameters (Kolda, Lewis, Torczon, SIAM Review 2003): a step up or down in each parameter in turn,
kept if better, and halved once none is.

The logs should not be those that observers were trained and bounds calibrated on, whose errors are
smaller than those of new walks, nor those on which filters are compared.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.estimator.evaluation.trajectory import reference
from surefoot.estimator.metrics import Metrics, evaluate
from surefoot.scenarios.cache import finished_case
from surefoot.scenarios.estimate.contract import Learnt, Parameters
from surefoot.scenarios.estimate.estimators import (
    ESTIMATORS,
    check_filter,
    estimator_code,
    estimator_named,
)
from surefoot.scenarios.estimate.run import declared_model, estimated
from surefoot.scenarios.estimate.settings import (
    FilterSettings,
    Tuned,
    read_tuned,
    tuned,
    tuned_file,
)
from surefoot.scenarios.reporting.tables import to_markdown
from surefoot.scenarios.settings import TuneSettings
from surefoot.scenarios.stages import processes, stage
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import file_digest, refuse_overwrite, whole_folder, write_whole
from surefoot.sim.common.sources import code_digest
from surefoot.sim.effects import declared_effects
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

PRICE = 0.3
_LEGEND = (
    "before and after: with the parameters at the start and with the best. price: mean over the "
    f"logs of log(APE_trans / path length) + {PRICE:g} |log(NEES_pos / 3)|, which the search "
    "minimises. APE: mean of APE_trans as a share of the path. NEES_pos: of each log, 3 if "
    "consistent."
)
SHARES, NEES = (1e-5, 1.0), (0.01, 1000.0)
"""Ranges to which APE as a share of the path, and NEES, are clipped."""
EVALUATED = 120.0
"""Part of each log, from its start, on which filters are evaluated [s]."""
FIRST_FACTOR = 4.0
"""Factor of the first steps."""
FINEST = 1.02
"""Factor at which a search ends."""


def search(
    price: Callable[[Mapping[str, float]], float], start: Mapping[str, float], budget: int
) -> dict[str, float]:
    """Parameters of the least cost found within `budget` >= 1 evaluations, including `start`; all
    values are > 0.
    """
    best, lowest = dict(start), price(start)
    tried, step = {_key(best)}, FIRST_FACTOR
    while len(tried) < budget and step > FINEST:
        improved = False
        for name in start:
            for factor in (step, 1.0 / step):
                trial = best | {name: best[name] * factor}
                if _key(trial) in tried or len(tried) >= budget:
                    continue
                tried.add(_key(trial))
                if (found := price(trial)) < lowest:
                    best, lowest, improved = trial, found, True
                    break
        if not improved:
            step = np.sqrt(step)
    return {name: float(f"{value:.3g}") for name, value in best.items()}


def price_of(metrics: Metrics) -> float:
    """Cost of one estimate, finite even if it diverged."""
    share, nees = metrics.ape_trans / metrics.length, metrics.nees_position
    share = np.clip(share, *SHARES) if np.isfinite(share) else SHARES[1]
    nees = np.clip(nees, *NEES) if np.isfinite(nees) else NEES[1]
    return float(np.log(share) + PRICE * abs(np.log(nees / 3.0)))


def tune(paths: Sequence[Path], settings: TuneSettings, learnt: Learnt) -> str:
    """Search each filter's parameters for each robot; a finished search is not repeated.

    Returns the text of tuned.md. Raises SurefootError on bad input.

    Args:
        paths: logs with a reference, of one or several robots.
        settings: filters, amount of work and where to.
        learnt: observers and bounds.
    """
    out, filters = settings.out, settings.filters
    if settings.budget < 1:
        raise SurefootError(f"budget {settings.budget}: at least 1")
    for name in filters:
        check_filter(name)
    for name in ("tuned.toml", "tuned.md"):
        refuse_overwrite(out / name, settings.force)
    of_robot: dict[str, list[Path]] = {}
    for path in paths:
        log = Log.read(path)
        of_robot.setdefault(Robot.for_log(log, settings.robot).name, []).append(path)
    searches = {
        (known, name): (search_filter, name, own, settings, learnt)
        for known, own in of_robot.items()
        for name in filters or ESTIMATORS
    }
    with processes(settings.workers) as pool:
        results = stage(pool, "searches", searches)
    found = {key: result for key, result in results.items() if "left_out" not in result}
    lines = [to_markdown([_row(known, name, one) for (known, name), one in found.items()]), _LEGEND]
    for (known, name), result in results.items():
        if why := result.get("left_out"):
            if name in filters:
                raise SurefootError(f"filter {name}, {known}: {why}")
            lines.append(f"left out for {known}: {name} ({why})")
    entries = dict(read_tuned(tuned_file()))
    for (known, name), result in found.items():
        before = entries.get(known, entries["default"])
        reason = f"surefoot tune, budget {settings.budget}, {len(of_robot[known])} logs"
        own = before.filters | {name: result["after"]["parameters"]}
        entries[known] = replace(before, filters=own, reason=reason)
    text = "\n\n".join(lines) + "\n"
    with whole_folder(out, settings.force) as folder:
        write_tuned(folder / "tuned.toml", entries)
        write_whole(folder / "tuned.md", text)
    return text


def search_filter(
    name: str, paths: Sequence[Path], settings: TuneSettings, learnt: Learnt
) -> dict[str, Any]:
    """One filter's search on one robot's logs, as a finished case.

    `before` and `after`: parameters, cost, and on each log the error as a percentage of the path,
    and NEES; for a filter that the logs or `learnt` do not allow: `left_out`, the reason.
    """
    estimator = estimator_named(name)
    walks, declared = [], []
    for path in paths:
        log = Log.read(path)
        log = log.rows(log.t - log.t[0] <= EVALUATED)
        declared += declared_effects(log)
        walks.append(declared_model(log, Robot.for_log(log, settings.robot)))
    entry = tuned(walks[0][1])
    declared_ones = {each.name for each in estimator.parameters if each.declared}
    every = entry.of(estimator)
    start = {name: value for name, value in every.items() if name not in declared_ones}

    def judged(values: Parameters) -> list[Metrics]:
        chosen = FilterSettings(filters={name: {**every, **values}})
        return [
            evaluate(reference(log), estimated(estimator, log, robot, learnt, chosen))
            for log, robot in walks
        ]

    def price(values: Parameters) -> float:
        try:
            return _mean_price(judged(values))
        except SurefootError:
            return PRICE * float(np.log(NEES[1] / 3.0))

    def shown(values: Parameters) -> dict[str, Any]:
        found = judged(values)
        percent = [100.0 * metrics.ape_trans / metrics.length for metrics in found]
        nees = [metrics.nees_position for metrics in found]
        about = {"parameters": dict(values), "price": _mean_price(found)}
        return about | {"percent": percent, "nees": nees}

    def make() -> dict[str, Any]:
        before = shown(start)
        return {"before": before, "after": shown(search(price, start, settings.budget))}

    inputs = {
        "filter": name,
        "estimator": estimator_code(name),
        "start": every,
        "mounting": entry.mounting,
        "budget": settings.budget,
        "logs": [file_digest(path) for path in paths],
        "robots": [robot.digest for _, robot in walks],
        "effects": code_digest(*map(type, declared)),
        "observers": [one.hash for one in learnt.observers],
        "bounds": [repr(one) for one in learnt.bounds],
    }
    case = f"{walks[0][1].name}_{name}"
    try:
        return finished_case(settings.out / "searches", case, inputs, __name__, make)
    except SurefootError as error:
        return {"left_out": str(error)}


def write_tuned(path: Path, entries: Mapping[str, Tuned]) -> None:
    """All robots' entries as TOML."""
    blocks = []
    for robot, entry in entries.items():
        lines = [f"[{robot}]", f'reason = "{entry.reason}"', f"mounting = {entry.mounting:g}"]
        for name, values in entry.filters.items():
            pairs = ", ".join(f"{key} = {value:g}" for key, value in values.items())
            lines.append(f"{name} = {{ {pairs} }}")
        blocks.append("\n".join(lines))
    write_whole(path, "\n\n".join(blocks) + "\n")


def _mean_price(judged: Sequence[Metrics]) -> float:
    return float(np.mean([price_of(metrics) for metrics in judged]))


def _row(robot: str, name: str, result: Mapping[str, Any]) -> dict[str, str]:
    row = {"robot": robot, "filter": name}
    for when, one in result.items():
        values = one["parameters"].items()
        row |= {
            f"parameters {when}": ", ".join(f"{key} {value:g}" for key, value in values),
            f"price {when}": f"{one['price']:.2f}",
            f"APE [%] {when}": f"{np.mean(one['percent']):.3f}",
            f"NEES_pos {when}": ", ".join(f"{value:.3g}" for value in one["nees"]),
        }
    return row


def _key(values: Mapping[str, float]) -> tuple[float, ...]:
    return tuple(round(float(np.log(value)), 6) for value in values.values())
