"""Observers by inputs, number of walks and architecture, on walks that none has seen: `make
study-observer`.

Walks are kept in the cache, and a row for each training in a folder, so that a killed run resumes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np
import pandas as pd

from studies.command import OutputFolder, run_study
from surefoot import Log, TrainSettings, train
from surefoot.extend import ARCHITECTURES, OBSERVER_RATE, prediction_errors
from surefoot.scenarios.reporting import (
    Picture,
    Section,
    code_digest,
    error_by_number,
    finished_case,
    origin_of,
    progress_bar,
    to_markdown,
    write_page,
    write_results,
)
from surefoot.scenarios.training.many_walks import WalksSettings, many_walks

_MODULE = "studies.observers"
_TITLE = "Observers compared"
DIRECTIONS = ("forward", "lateral", "vertical", "all")


@dataclass(frozen=True)
class ObserverCase:
    """One observer to train and test."""

    inputs: str
    model: str
    walks: int
    seed: int
    steps: int
    batch: int
    width: int | None


@dataclass(frozen=True)
class ObserverStudy:
    """Train and test observers: tables of their errors over the seeds."""

    out: OutputFolder
    robot: str = "spot_class"
    seeds: int = 3
    inputs: tuple[str, ...] = ("q,dq,tau", "gyro,contact,feet", "tau,gyro,accel,contact,feet")
    """Inputs to compare: the paper's, those of a robot without torques, and those recommended."""
    walks: tuple[int, ...] = (1, 4, 16, 48)
    """Numbers of walks to train on."""
    models: tuple[str, ...] = tuple(ARCHITECTURES)
    """Architectures: the first on all numbers of walks and inputs, all on the last but one."""
    steps: int = TrainSettings.steps
    """Training steps, the same for all networks."""
    batch: int = 12
    """Windows in each step."""
    width: int | None = 96
    """Units of the first architecture; the others have their own."""
    data: Path | None = None
    """Folder of finished trainings; by default `trainings` in the output folder."""
    page: Path | None = None
    """Page of results to write too, such as docs/results/observers.md."""

    def run(self) -> None:
        for section in observer_study(self):
            print(to_markdown(pd.DataFrame(section.table), 4))

    @property
    def trainings(self) -> Iterator[ObserverCase]:
        """Each once, those of the first seed first."""
        for seed in range(self.seeds):
            for count in self.walks:
                for inputs in self.inputs:
                    yield self._case(inputs, self.models[0], count, seed)
            for model in self.models[1:]:
                yield self._case(self.inputs[-1], model, self.walks[-2], seed)

    def _case(self, inputs: str, model: str, walks: int, seed: int) -> ObserverCase:
        width = self.width if model == self.models[0] else None
        return ObserverCase(inputs, model, walks, seed, self.steps, self.batch, width)


def observer_study(study: ObserverStudy) -> list[Section]:
    """Run what is missing, and write tables, figure and page; returns the sections."""
    settings = WalksSettings(robot=study.robot, walks=max(study.walks))
    roles = ("train", "held_out", "test")
    walks = {role: list(many_walks(settings, role=role)) for role in roles}
    rows = []
    for one in progress_bar(list(study.trainings), desc="observers", unit="training"):
        inputs = {**vars(one), "robot": study.robot, "code": code_digest(ARCHITECTURES[one.model])}
        inputs |= {role: len(logs) for role, logs in walks.items()}
        row = finished_case(
            study.data or study.out / "trainings",
            "_".join(map(str, (study.robot, *vars(one).values()))),
            inputs,
            _MODULE,
            partial(_trained_and_tested, one, *walks.values()),
        )
        rows.append(vars(one) | row)
    found = pd.DataFrame(rows)
    sections = _sections(study, found, {role: len(logs) for role, logs in walks.items()})
    write_results(study.out, _TITLE, sections, force=True)
    if study.page:
        write_page(study.page, _TITLE, sections, origin_of(_MODULE, "make study-observer"))
    return sections


def _sections(study: ObserverStudy, found: pd.DataFrame, counts: dict[str, int]) -> list[Section]:
    """Findings with the error by inputs and walks, the setting, and all errors as CSV."""
    by_walks = found.query("model == @study.models[0]")
    alike = found.query("walks == @study.walks[-2] and inputs == @study.inputs[-1]")
    errors = {
        str(inputs): {int(str(n)): group["all"].tolist() for n, group in part.groupby("walks")}
        for inputs, part in by_walks.groupby("inputs", sort=False)
    }
    fewest, most = min(study.walks), max(study.walks)
    fall = "; ".join(
        f"with `{inputs}` it falls from {np.mean(of[fewest]):.3f} to {np.mean(of[most]):.3f} m/s"
        for inputs, of in errors.items()
    )
    table = mean_and_spread(by_walks, ("inputs", "walks"))
    caption = "Error on unseen walks; a small dot for each seed, lines through their means."
    sections = [
        Section(
            "Findings",
            f"Root mean square error of the velocity on unseen walks, from {fewest} to {most} "
            f"walks to train on: {fall}.",
            table.filter(items=["inputs", "walks", "parameters", "CPU [s]", "RMSE all [m/s]"]),
            (Picture(error_by_number(errors), caption),),
        ),
        Section(
            "Setting",
            f"Observers ({study.models[0]}) of {study.robot} are trained for at most {study.steps} "
            f"steps of {study.batch} windows on walks drawn as `surefoot train --walks` draws "
            "them, stopped by "
            f"{counts['held_out']} others, and tested on {counts['test']} that no training has "
            "seen. Each walk has equal weight. Errors are by "
            f"{study.seeds} seed(s) of the training: of several, mean and standard deviation.",
        ),
        Section("Errors by axis", "", table, file="by_walks"),
        Section(
            "Architectures",
            f"All read {study.inputs[-1]}, and are trained on {study.walks[-2]} walks.",
            mean_and_spread(alike, ("model",)),
            file="architectures",
        ),
    ]
    return sections if len(study.models) > 1 else sections[:-1]


def mean_and_spread(rows: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """One row for each value of the keys: mean over the seeds and, after ±, standard deviation."""
    found = []
    for _, group in rows.groupby(list(keys), sort=False):
        cells: dict[str, object] = {key: group[key].iloc[0] for key in keys}
        if "model" in keys:
            cells["sees"] = _sees(str(cells["model"]))
        cells["parameters"] = int(group["parameters"].iloc[0])
        cells["CPU [s]"] = f"{group['cpu'].mean():.0f}"
        for axis in DIRECTIONS:
            spread = f" ± {group[axis].std(ddof=1):.4f}" if len(group) > 1 else ""
            cells[f"RMSE {axis} [m/s]"] = f"{group[axis].mean():.4f}{spread}"
        found.append(cells)
    return pd.DataFrame(found)


def _trained_and_tested(
    one: ObserverCase, walks: Sequence[Log], held_out: Sequence[Log], test: Sequence[Log]
) -> dict[str, object]:
    """Train and test one observer: its size, CPU time and RMSE on the tests."""
    started = process_time()
    course = {key: value for key, value in vars(one).items() if key != "walks"}
    settings = TrainSettings(**course)
    observer = train(walks[: one.walks], None, settings, held_out=held_out)
    cpu = process_time() - started
    squares = [(prediction_errors(observer, log)[1] ** 2).mean(axis=0) for log in test]
    mean = np.mean(squares, axis=0)
    rmse = np.sqrt([*mean, mean.sum()])
    row = {"parameters": observer.network.size, "cpu": cpu}
    return row | dict(zip(DIRECTIONS, rmse.tolist(), strict=True))


def _sees(model: str) -> str:
    architecture = ARCHITECTURES[model]
    if not architecture.causal:
        return "past and future"
    if architecture.receptive_field is None:
        return "all the past"
    return f"{(architecture.receptive_field - 1) / OBSERVER_RATE:.2f} s"


if __name__ == "__main__":
    run_study(ObserverStudy)
