"""Comparison of the observer's architectures, on both suites, over seeds: `make study-observer`.

As in the paper, each suite trains on one sequence; tests are on two courses with other ground.
Walks, and a row for each training, are stored in the folder, so that a killed run resumes.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time
from typing import cast

import numpy as np
import pandas as pd

from studies.command import OutputFolder, run_study
from surefoot import Log, Robot, SimulateSettings, TrainSettings, simulate, train
from surefoot.extend import (
    ARCHITECTURES,
    OBSERVER_RATE,
    SurefootError,
    declared_model,
    prediction_errors,
)
from surefoot.scenarios.reporting import (
    Section,
    code_digest,
    contents_digest,
    finished_case,
    origin_of,
    progress_bar,
    to_markdown,
    write_page,
    write_results,
)

_MODULE = "studies.observers"
_TITLE = "Observers compared"
PROSE = (
    "Each architecture is trained on one walk of a suite and tested on two others. Root mean "
    "square errors, mean and standard deviation over seeds."
)
DIRECTIONS = ("forward", "lateral", "vertical", "all")


@dataclass(frozen=True)
class SuiteWalks:
    """Bundled scenarios of this folder: one for training, and those for tests."""

    folder: str
    train: str
    tests: tuple[str, ...]


SUITE_WALKS = {
    "spot": SuiteWalks("spot", "upstair", ("atrium", "slopestair")),
    "vision60": SuiteWalks("vision60", "3cc3ccw", ("stroll", "slipped")),
}


@dataclass(frozen=True)
class ObserverStudy:
    """Train and test every network on both suites: a table of errors over the seeds."""

    out: OutputFolder
    seeds: int = 3
    steps: int = TrainSettings.steps
    """Training steps, the same for all networks."""
    loss: str = "mse"
    inputs: tuple[str, ...] = ("q,dq,tau", "tau,feet")
    """Inputs of the networks to compare: the paper's, and leg odometry of the robot's model."""
    data: Path | None = None
    """Folder of finished trainings; by default `trainings` in the output folder."""
    page: Path | None = None
    """Page of results to write too, such as docs/results/observers.md."""

    def run(self) -> None:
        print(to_markdown(observer_study(self), 4))


def observer_study(options: ObserverStudy) -> pd.DataFrame:
    """Run what is missing, write table.md and table.csv, and return the table."""
    logs = {name: _logs(suite, options.out) for name, suite in SUITE_WALKS.items()}
    digests = {
        name: [[contents_digest(log), Robot.for_log(log).digest] for log in own.values()]
        for name, own in logs.items()
    }
    tasks = [
        (suite, inputs, model, seed)
        for seed in range(options.seeds)
        for suite in SUITE_WALKS
        for inputs in options.inputs
        for model in ARCHITECTURES
    ]
    rows = []
    for suite, read, model, seed in progress_bar(tasks, desc="architectures", unit="training"):
        inputs = {"suite": suite, "inputs": read, "model": model, "seed": seed}
        inputs |= {"loss": options.loss, "steps": options.steps}
        row = finished_case(
            options.data or options.out / "trainings",
            "_".join(map(str, inputs.values())),
            inputs | {"logs": digests[suite], "code": code_digest(ARCHITECTURES[model])},
            _MODULE,
            partial(
                _trained_and_tested, logs[suite], SUITE_WALKS[suite], read, model, seed, options
            ),
        )
        rows.append({"suite": suite, "inputs": read, "model": model} | row)
    table = mean_and_spread(pd.DataFrame(rows))
    sections = observer_sections(table)
    write_results(options.out, _TITLE, sections, force=True)
    if options.page:
        write_page(options.page, _TITLE, sections, origin_of(_MODULE, "make study-observer"))
    return table


def observer_sections(table: pd.DataFrame) -> list[Section]:
    """Findings with the total errors, the setting, and the whole table."""
    best = []
    for key, part in table.groupby(["suite", "inputs"], sort=False):
        suite, inputs = cast("tuple[str, str]", key)
        errors = part.set_index("model")["RMSE all [m/s]"]
        least = errors.map(_mean).idxmin()
        best.append(f"`{least}` on {suite} with {inputs} ({errors[least]} m/s)")
    columns = ["suite", "inputs", "model", "parameters", "CPU [s]", "RMSE all [m/s]"]
    shown = pd.DataFrame(table, columns=columns)
    return [
        Section("Findings", f"The most accurate networks are {', '.join(best)}.", shown),
        Section("Setting", PROSE),
        Section("Errors by axis", "", table, file="table"),
    ]


def _mean(text: str) -> float:
    """The mean of "0.0853 ± 0.0077"."""
    return float(text.split()[0])


def mean_and_spread(rows: pd.DataFrame) -> pd.DataFrame:
    """One row for each suite, inputs and network: mean over the seeds and, after ±, standard
    deviation.
    """
    found = []
    for key, group in rows.groupby(["suite", "inputs", "model"], sort=False):
        suite, inputs, model = cast("tuple[str, str, str]", key)
        cells: dict[str, object] = {"suite": suite, "inputs": inputs, "model": model}
        cells["sees"] = _sees(model)
        cells["parameters"] = int(group["parameters"].iloc[0])
        cells["CPU [s]"] = f"{group['cpu'].mean():.0f}"
        for axis in DIRECTIONS:
            values = group[axis]
            cells[f"RMSE {axis} [m/s]"] = f"{values.mean():.4f} ± {values.std(ddof=1):.4f}"
        found.append(cells)
    return pd.DataFrame(found)


def _logs(suite: SuiteWalks, out: Path) -> dict[str, Log]:
    """The suite's logs with declared effects compensated; simulated if they do not exist yet."""
    names = (suite.train, *suite.tests)
    courses = tuple(f"{suite.folder}/{name}" for name in names)
    rows = simulate(SimulateSettings(courses, out / "logs"))
    for row in rows:
        if row.falls:
            raise SurefootError(f"{row.scenario}: the robot fell at {row.fell_at:.1f} s")
    logs = [Log.read(out / "logs" / row.file) for row in rows]
    return {
        n: declared_model(log, Robot.for_log(log))[0] for n, log in zip(names, logs, strict=True)
    }


def _trained_and_tested(
    logs: dict[str, Log],
    suite: SuiteWalks,
    inputs: str,
    model: str,
    seed: int,
    options: ObserverStudy,
) -> dict[str, object]:
    """Train and test one observer: its size, CPU time and RMSE on the tests.

    Args:
        logs: by name.
        suite: names of the logs to train and test on.
        inputs: of the network.
        model: name of the architecture.
        seed: of weights and windows.
        options: loss and steps.
    """
    started = process_time()
    settings = TrainSettings(
        inputs=inputs, loss=options.loss, seed=seed, steps=options.steps, model=model
    )
    observer = train(logs[suite.train], None, settings)
    cpu = process_time() - started
    row: dict[str, object] = {"seed": seed, "parameters": observer.network.size, "cpu": cpu}
    errors = {name: prediction_errors(observer, logs[name])[1] for name in suite.tests}
    for name, e in errors.items():
        row |= {f"{name} {axis}": value for axis, value in zip(DIRECTIONS, _rmse(e), strict=True)}
    # Long and short courses have equal weight.
    pooled = np.sqrt(np.mean([_rmse(e) ** 2 for e in errors.values()], axis=0))
    return row | dict(zip(DIRECTIONS, pooled.tolist(), strict=True))


def _rmse(errors: np.ndarray) -> np.ndarray:
    """Root mean squares (4,) [m/s]: of each axis, and of the error's norm."""
    squares = (errors**2).mean(axis=0)
    return np.sqrt([*squares, squares.sum()])


def _sees(model: str) -> str:
    architecture = ARCHITECTURES[model]
    if not architecture.causal:
        return "past and future"
    if architecture.receptive_field is None:
        return "all the past"
    return f"{(architecture.receptive_field - 1) / OBSERVER_RATE:.2f} s"


if __name__ == "__main__":
    run_study(ObserverStudy)
