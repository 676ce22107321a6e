"""Which network observes best? Each of them, on both suites, over seeds: `make study-observer`.

Each suite trains on one sequence, as in the paper, and is tested on two courses of other ground.
Everything is kept in the folder: walks, and a row for each training. Killed, it goes on from there.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Annotated

import numpy as np
import pandas as pd
import tyro
from tqdm import tqdm

from surefoot.models.observer.decimate import RATE
from surefoot.models.observer.predict import prediction_errors
from surefoot.models.observer.training import Schedule, train
from surefoot.models.registry import ARCHITECTURES
from surefoot.scenarios.datasets.simulate import simulate_all
from surefoot.scenarios.estimate.registry import declared_model
from surefoot.scenarios.reporting.tables import to_csv, to_markdown
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled, whole_file
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

COURSES = bundled("surefoot.scenarios", "courses")
AXES = ("forward", "lateral", "vertical", "all")


@dataclass(frozen=True)
class Suite:
    """Scenario files below this folder: one to train on, and those to test on."""

    folder: str
    train: str
    tests: tuple[str, ...]


SUITES = {
    "spot": Suite("spot", "upstair", ("atrium", "slopestair")),
    "vision60": Suite("vision60", "3cc3ccw", ("stroll", "slipped")),
}


@dataclass(frozen=True)
class Options:
    """Train every network on both suites and test it; a table of errors over the seeds."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    seeds: int = 3
    steps: int = Schedule.steps
    """Steps of training, the same for all."""
    loss: str = "mse"


def study(options: Options) -> pd.DataFrame:
    """Run what is not yet there, write table.md and table.csv, and return the table."""
    logs = {name: _logs(suite, options.out) for name, suite in SUITES.items()}
    tasks = [
        (suite, model, seed)
        for seed in range(options.seeds)
        for suite in SUITES
        for model in ARCHITECTURES
    ]
    rows = []
    for suite, model, seed in tqdm(tasks, desc="architectures", unit="training"):
        name = f"{suite}_{model}_{options.loss}_{options.steps}_{seed}"
        path = options.out / "trainings" / f"{name}.json"
        if not path.exists():
            row = _trained_and_tested(logs[suite], SUITES[suite], model, seed, options)
            with whole_file(path) as temporary:
                temporary.write_text(json.dumps({"suite": suite, "model": model} | row, indent=1))
        rows.append(json.loads(path.read_text()))
    table = summary(pd.DataFrame(rows))
    for file, text in (("table.md", to_markdown(table, 4) + "\n"), ("table.csv", to_csv(table))):
        with whole_file(options.out / file, force=True) as temporary:
            temporary.write_text(text)
    return table


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """A row a suite and network: mean over the seeds and, after ±, their standard deviation."""
    found = []
    for suite, model in rows[["suite", "model"]].drop_duplicates().itertuples(index=False):
        group = rows[(rows["suite"] == suite) & (rows["model"] == model)]
        cells: dict[str, object] = {"suite": suite, "model": model, "sees": _sees(model)}
        cells["parameters"] = int(group["parameters"].iloc[0])
        cells["CPU [s]"] = f"{group['cpu'].mean():.0f}"
        for axis in AXES:
            values = group[axis]
            cells[f"RMSE {axis} [m/s]"] = f"{values.mean():.4f} ± {values.std(ddof=1):.4f}"
        found.append(cells)
    return pd.DataFrame(found)


def _logs(suite: Suite, out: Path) -> dict[str, Log]:
    """The suite's logs, walked if they are not there, as the declared model sees them."""
    names = (suite.train, *suite.tests)
    files = [COURSES / suite.folder / f"{name}.toml" for name in names]
    rows = simulate_all(files, out / "logs")
    for row in rows:
        if row.falls:
            raise SurefootError(f"{row.scenario}: the robot fell at {row.fell_at:.1f} s")
    logs = [Log.read(out / "logs" / row.file) for row in rows]
    return {
        n: declared_model(log, Robot.for_log(log))[0] for n, log in zip(names, logs, strict=True)
    }


def _trained_and_tested(
    logs: dict[str, Log], suite: Suite, model: str, seed: int, options: Options
) -> dict[str, object]:
    started = process_time()
    schedule = Schedule(steps=options.steps)
    observer = train(
        logs[suite.train], loss=options.loss, seed=seed, schedule=schedule, model=model
    )
    cpu = process_time() - started
    row: dict[str, object] = {"seed": seed, "parameters": observer.network.size, "cpu": cpu}
    errors = {name: prediction_errors(observer, logs[name])[1] for name in suite.tests}
    for name, e in errors.items():
        row |= {f"{name} {axis}": value for axis, value in zip(AXES, _rmse(e), strict=True)}
    # Courses count alike, long or short.
    pooled = np.sqrt(np.mean([_rmse(e) ** 2 for e in errors.values()], axis=0))
    return row | dict(zip(AXES, pooled.tolist(), strict=True))


def _rmse(errors: np.ndarray) -> np.ndarray:
    """Root mean squares (4,), m/s: of each axis, and of the error's length."""
    squares = (errors**2).mean(axis=0)
    return np.sqrt([*squares, squares.sum()])


def _sees(model: str) -> str:
    architecture = ARCHITECTURES[model]
    if not architecture.causal:
        return "past and future"
    if architecture.receptive_field is None:
        return "all the past"
    return f"{(architecture.receptive_field - 1) / RATE:.2f} s"


if __name__ == "__main__":
    print(to_markdown(study(tyro.cli(Options)), 4))
