"""`python -m surefoot.scenarios.tune`: the search that writes tuned.toml, the same for every
filter.

Filters are tuned on the training and calibration courses of the suites alone, walked under all
conditions by a robot and with a seed that no table uses. Each filter has the same budget of runs.
The leg filters are judged on both walks. A learnt filter would be flattered by the walk that its
observer was trained on, and by bounds judged on the errors that they were ranked on: all learnt
filters are judged on the two halves of the calibration walk, each with bounds from the other half.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import arg

from surefoot.scenarios.estimate.registry import ESTIMATORS, declared_model, estimator_named
from surefoot.scenarios.estimate.tuned import BUNDLED, Tuned, read_tuned, tuned
from surefoot.scenarios.experiments.cache import Product, product
from surefoot.scenarios.experiments.file import Condition, Experiment, walk_to_make
from surefoot.scenarios.experiments.products import (
    LearntFiles,
    make_bounds,
    make_observer,
    make_walk,
)
from surefoot.scenarios.reporting.tables import to_markdown
from surefoot.scenarios.stages import processes, stage
from surefoot.scenarios.tuning import facts_on, piece, price_on, search
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled, whole_file
from surefoot.sim.log import Log
from surefoot.sim.walking.batch import known_robot

SUITES = tuple(
    bundled("surefoot.scenarios.experiments", "suites") / f"{n}.toml" for n in ("vision60", "spot")
)


@dataclass(frozen=True)
class TuneFilters:
    """Search the parameters of every filter; writes tuned.toml and a table of before and after."""

    out: Annotated[Path, arg(aliases=["-o"])] = Path("out/tuned")
    """Folder for tuned.toml, tuned.md, and the cache from which a killed run goes on."""
    suites: tuple[Path, ...] = SUITES
    """Experiment files with a course to train and one to calibrate with."""
    seed: int = 10
    """Of the robots and walks. The suites' own seeds are refused."""
    budget: int = 16
    """Runs of each filter over all its pieces."""
    longest: float = 120.0
    """s of a walk that a filter is judged on."""
    conditions: tuple[str, ...] = ()
    """Of the suites' conditions, those to walk under; all where left out."""
    filters: tuple[str, ...] = ()
    """All but the IMU alone where left out: the floor has nothing to be tuned for."""
    workers: int = 1
    force: bool = False
    """Overwrite tuned.toml and tuned.md in `out`."""


@dataclass(frozen=True)
class Part:
    """A piece of a walk and, for the filters that use it, what was learnt elsewhere."""

    log: Product
    name: str
    learnt: LearntFiles


def tune(options: TuneFilters) -> tuple[dict[str, Tuned], str]:
    """The robots' parameters after the search, and the table of before and after."""
    if not options.filters:
        options = replace(options, filters=tuple(name for name in ESTIMATORS if name != "imu"))
    experiments = [_experiment(path, options) for path in options.suites]
    cache = options.out / "cache"
    with processes(options.workers) as pool:
        parts: dict[str, dict[str, list[Part]]] = {}
        groups = {
            (robot, condition.name): (make_parts, cache, experiment, robot, condition, options)
            for experiment in experiments
            for condition in experiment.conditions
            for robot in _robots(experiment)
        }
        for (robot, _), made in stage(pool, "walks and observers", groups).items():
            for kind, some in made.items():
                parts.setdefault(robot, {}).setdefault(kind, []).extend(some)
        searches = {
            (robot, name): (
                make_search, cache, robot, name, kinds[_kind(name)], options.budget,
                experiments[0].gammas[0],
            )
            for robot, kinds in parts.items()
            for name in options.filters
        }  # fmt: skip
        found = stage(pool, "searches", searches)
    return _entries(found, options), _table(found)


def make_parts(
    cache: Path, experiment: Experiment, robot: str, condition: Condition, options: TuneFilters
) -> dict[str, list[Part]]:
    """Pieces for the leg filters and for the learnt ones, of one robot under one condition."""
    nothing = LearntFiles({}, {})
    walks: dict[str, tuple[str, Product]] = {}
    for role in ("train", "calibrate"):
        (scenario,) = experiment.with_role(role, robot)
        job = walk_to_make(scenario, robot, condition, options.seed)
        walk = make_walk(cache, job)
        if walk.facts["falls"]:
            raise SurefootError(f"{scenario.name}, {condition.name}: the robot fell; another seed")
        walks[role] = scenario.name, walk
    parts: dict[str, list[Part]] = {"leg": [], "learnt": []}
    for name, walk in walks.values():
        whole = make_part(cache, walk, 0.0, min(options.longest / walk.facts["duration"], 1))
        parts["leg"].append(Part(whole, f"{name} {condition.name}", nothing))
    if not any(_kind(name) == "learnt" for name in options.filters):
        return parts
    learning, gamma = experiment.learning, experiment.gammas[0]
    observers = {
        loss: make_observer(cache, [walks["train"]], learning, loss, options.seed)
        for loss in learning.losses
    }
    name, walk = walks["calibrate"]
    share = min(options.longest / walk.facts["duration"], 0.5)
    for here, there in ((0.0, 0.5), (0.5, 0.0)):
        other = make_part(cache, walk, there, there + 0.5)
        bounds = {
            loss: make_bounds(cache, one, (name, other), gamma, learning.method)
            for loss, one in observers.items()
        }
        log = make_part(cache, walk, here, here + share)
        title = f"{name} {condition.name}, half {1 if here == 0 else 2}"
        parts["learnt"].append(Part(log, title, LearntFiles(observers, {gamma: bounds})))
    return parts


def make_part(cache: Path, walk: Product, begin: float, end: float) -> Product:
    """The walk from one share of its rows to another, as a log of its own."""

    def make(path: Path) -> dict[str, Any]:
        log = Log.read(walk.path)
        rows = slice(int(begin * len(log.t)), int(end * len(log.t)))
        part = log.rows(rows)
        replace(part, meta=replace(part.meta, rate=log.rate)).write(path, force=True)
        return {"duration": float(part.t[-1] - part.t[0])}

    inputs = {"walk": walk.digest, "begin": begin, "end": end}
    return product(cache, "part", inputs, "surefoot.sim.log", ".parquet", make)


def make_search(
    cache: Path, robot_name: str, name: str, parts: Sequence[Part], budget: int, gamma: float
) -> Product:
    """One filter's search; the facts are what it started from and found, on all pieces."""
    robot = known_robot(robot_name)
    before = tuned(robot)
    start = before.of(estimator_named(name))
    inputs = {
        "filter": name,
        "start": start,
        "mounting": before.mounting,
        "budget": budget,
        "logs": [part.log.digest for part in parts],
        "observers": [one.digest for p in parts for one in p.learnt.observers.values()],
        "bounds": [
            one.digest for part in parts for b in part.learnt.bounds.values() for one in b.values()
        ],
    }

    def make(path: Path) -> dict[str, Any]:
        pieces = []
        for part in parts:
            log = replace(Log.read(part.log.path), name=part.name)
            known = declared_model(log, robot)
            pieces.append(piece(name, *known, part.learnt.load(gamma)))
        found = search(lambda values: price_on(pieces, values), start, budget)
        facts = found.__dict__ | {
            "before": facts_on(pieces, found.start),
            "after": facts_on(pieces, found.best),
        }
        path.write_text(json.dumps(facts), encoding="utf-8")
        return facts

    return product(cache, "search", inputs, "surefoot.scenarios.tuning", ".json", make)


def write_tuned(path: Path, entries: dict[str, Tuned], force: bool = False) -> None:
    """All robots' parameters as TOML."""
    blocks = []
    for robot, values in entries.items():
        lines = [f"[{robot}]", f'reason = "{values.reason}"', f"mounting = {values.mounting:g}"]
        for name, own in values.filters.items():
            pairs = ", ".join(f"{k} = {v:g}" for k, v in own.items())
            lines.append(f"{name} = {{ {pairs} }}")
        blocks.append("\n".join(lines))
    with whole_file(path, force) as temporary:
        temporary.write_text(HEAD + "\n\n".join(blocks) + "\n", encoding="utf-8")


HEAD = """\
# What the estimators are tuned to by robot, as surefoot.scenarios.tune found it, where that is not
# their defaults, which each class says with unit and meaning. Robots not named here take [default].
# mounting is the suites' tolerance of an IMU's mounting (suites/as_built.toml: 0.006 rad uniform),
# declared for them all.

"""


def _experiment(path: Path, options: TuneFilters) -> Experiment:
    found = Experiment.load(path)
    if options.seed in found.seeds:
        raise SurefootError(f"--seed {options.seed}: {path.name} tests with it; take another")
    known = [condition.name for condition in found.conditions]
    for name in options.conditions:
        if name not in known:
            raise SurefootError(f"--conditions {name}: {path.name} has {', '.join(known)}")
    chosen = tuple(c for c in found.conditions if c.name in (options.conditions or known))
    return replace(found, conditions=chosen)


def _robots(experiment: Experiment) -> list[str]:
    """Robots that walk both a course to train and one to calibrate with."""
    of_role = [
        {r for s in experiment.scenarios if s.role == role for r in experiment.robots_of(s)}
        for role in ("train", "calibrate")
    ]
    return sorted(of_role[0] & of_role[1])


def _kind(name: str) -> str:
    return "learnt" if estimator_named(name).needs.learnt else "leg"


def _entries(found: dict[tuple[str, str], Product], options: TuneFilters) -> dict[str, Tuned]:
    entries = dict(read_tuned(BUNDLED))
    for (robot, name), made in found.items():
        before = entries.get(robot, entries["default"])
        words = f"surefoot.scenarios.tune, seed {options.seed}, budget {options.budget}"
        filters = before.filters | {name: dict(made.facts["best"])}
        entries[robot] = replace(before, filters=filters, reason=words)
    return entries


def _table(found: dict[tuple[str, str], Product]) -> str:
    rows = []
    for (robot, name), made in found.items():
        facts = made.facts
        row = {"robot": robot, "filter": name}
        for when, values, price in (
            ("before", facts["start"], facts["start_price"]),
            ("after", facts["best"], facts["price"]),
        ):
            on = list(facts[when].values())
            row |= {
                f"parameters {when}": ", ".join(f"{k} {v:g}" for k, v in values.items()),
                f"price {when}": f"{price:.2f}",
                f"APE [%] {when}": f"{sum(p['percent'] for p in on) / len(on):.3f}",
                f"NEES_pos {when}": ", ".join(f"{p['nees_position']:.3g}" for p in on),
            }
        rows.append(row)
    return to_markdown(rows)


def main() -> None:
    options = tyro.cli(TuneFilters, prog="python -m surefoot.scenarios.tune")
    try:
        entries, table = tune(options)
        write_tuned(options.out / "tuned.toml", entries, options.force)
        with whole_file(options.out / "tuned.md", options.force) as temporary:
            temporary.write_text(table + "\n", encoding="utf-8")
    except SurefootError as error:
        raise SystemExit(f"tune_filters: {error}") from None
    print(table)


if __name__ == "__main__":
    main()
