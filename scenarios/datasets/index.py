"""Index of a folder of simulated logs: one row per attempted walk (Parquet), and a card (markdown).

Everything but the logs is in `_dataset/`, so that `*.parquet` in the folder, and the folder itself
for `pd.read_parquet`, which ignores names with a leading underscore, are the logs. The journal
gains a line as each walk ends; an interrupted run continues from it.
"""

import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import pandas as pd

from surefoot.estimator.metrics import path_length
from surefoot.scenarios.reporting.tables import to_markdown
from surefoot.sim.common.files import (
    append_lines,
    check_plain,
    file_digest,
    json_digest,
    json_lines,
    whole_file,
    write_whole,
)
from surefoot.sim.common.sources import code_digest, sources_digest
from surefoot.sim.effects import Effect
from surefoot.sim.gait.options import pattern_named
from surefoot.sim.log import Log
from surefoot.sim.physics.foot_truth import SLIPPING
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import Fallen, Plan
from surefoot.sim.walking.batch import Job, known_robot

INDEX_FOLDER = "_dataset"
MINUTE = 60.0  # s
DRY = 0.5  # friction coefficient from which ground counts as dry


FACTS = ("duration", "length", "slip_share", "creep")
"""Columns of the facts about a walk (`walk_facts`)."""


@dataclass(frozen=True)
class IndexRow:
    """One walk of the index. A walk that ended in a fall has NaN for its values and no file."""

    file: Annotated[str, msgspec.Meta(pattern=r"^[^/\\]*$")]  # no path
    scenario: str
    robot: str
    seed: int
    effects: str  # declared ones, JSON
    mu: float  # drawn: of the floor
    speed: float  # drawn: mean factor on the commanded speed
    period: float  # drawn: factor on the gait's period
    clearance: float  # drawn: factor on the swing foot's height
    gain: float  # drawn: factor on the controller's gains
    payload: float  # drawn: kg
    rough: float  # drawn: m, the highest bump
    falls: int
    fell_at: float  # s into the simulation, which begins with 3 s of standing
    duration: float  # s
    length: float  # m, of the reference's path sampled every 0.5 s
    slip_share: float  # of the loaded feet's samples, faster than SLIPPING over the ground
    creep: float  # m/s, median speed over the ground of loaded feet on dry ground
    sha256: str  # of the file
    recipe: str  # hash of all that decides the file's bytes
    fall: str = ""  # where and why it fell, in words


def log_name(job: Job) -> str:
    """`<scenario>_<seed>`, with the robot in between if it is not the scenario's own."""
    robot = known_robot(job.robot).name
    middle = "" if job.robot == job.scenario.robot else f"_{robot}"
    return f"{job.scenario.name}{middle}_{job.seed}"


def fall_path(folder: Path, job: Job) -> Path:
    """Path of the log of a walk that fell, which is not part of the dataset."""
    return folder / INDEX_FOLDER / "falls" / f"{log_name(job)}.parquet"


def recipe(job: Job) -> str:
    """Hash of what determines a walk: same recipe, same bits.

    Undeclared effects are not included, since the recipe is in the index.
    """
    declared = job.effects if job.declared else ()
    return json_digest(determinants(job.scenario, known_robot(job.robot), job.seed, declared))


def determinants(
    scenario: Scenario, robot: Robot, seed: int, effects: Sequence[Effect]
) -> dict[str, Any]:
    """All that determines a simulated walk, as JSON: its inputs, code and versions."""
    gait = pattern_named(scenario.gait.pattern)
    modules = "surefoot.sim.walking.batch", "surefoot.sim.walking.long_walk"
    return {
        "scenario": repr(scenario),
        "strides": [*map(float, gait.phase), gait.duty, gait.period],
        "robot": [robot.name, robot.digest, robot.q_home.tolist()],
        "seed": seed,
        "effects": [one.as_dict() for one in effects],
        "code": [*map(sources_digest, modules), code_digest(*map(type, effects))],
        "versions": _versions(),
    }


@cache
def _versions() -> dict[str, str]:
    return {name: version(name) for name in ("surefoot", "mujoco", "numpy", "numba")}


def row_of(
    job: Job, made: Plan, found: dict[str, float] | Fallen, path: Path | None = None
) -> IndexRow:
    """The row of a walk from its facts (`walk_facts`), or from its fall, with its log's hash."""
    fall = found if isinstance(found, Fallen) else None
    numbers = dict.fromkeys(FACTS, np.nan)
    return IndexRow(
        file="" if fall else f"{log_name(job)}.parquet",
        scenario=job.scenario.name,
        robot=made.robot.name,
        seed=job.seed,
        effects=json.dumps([e.as_dict() for e in job.effects] if job.declared else []),
        **_drawn(made),
        falls=int(fall is not None),
        fell_at=fall.time if fall else np.nan,
        **(numbers if isinstance(found, Fallen) else found),
        sha256=file_digest(path) if path else "",
        recipe=recipe(job),
        fall=fall.how if fall else "",
    )


def _drawn(made: Plan) -> dict[str, float]:
    draw = made.draw
    written, walked = (sum(s.duration for s in x.segments) for x in (made.scenario, draw.scenario))
    return {
        "mu": draw.scenario.ground.mu,
        "speed": written / walked,
        "period": draw.period,
        "clearance": draw.clearance,
        "gain": draw.gain,
        "payload": draw.payload,
        "rough": max((strip.rough for strip in draw.scenario.ground.strips), default=0.0),
    }


def walk_facts(pieces: Iterable[Log]) -> dict[str, float]:
    """Duration [s], length [m], share of slipping stance and creep [m/s], as in `IndexRow`, of a
    log in pieces.

    The path of each piece is sampled separately, and the creep is the weighted median of the
    pieces', by their loaded samples. NaN where no foot is loaded, or none on dry ground.
    """
    loaded = slipping = 0.0
    length, duration, creeps, weights = 0.0, 0.0, [], []
    for log in pieces:
        slip = log.slip
        dry = slip[(slip > 0.0) & (log.mu >= DRY)]
        loaded, slipping = loaded + (slip > 0.0).sum(), slipping + (slip > SLIPPING).sum()
        if dry.size:
            creeps.append(float(np.median(dry)))
            weights.append(dry.size)
        length, duration = length + path_length(log.t, log.ref_p), float(log.t[-1])
    creep = np.nan
    if creeps:
        creep = float(np.quantile(creeps, 0.5, weights=weights, method="inverted_cdf"))
    return {
        "duration": duration,
        "length": length,
        "slip_share": float(slipping / loaded) if loaded else np.nan,
        "creep": creep,
    }


class Journal:
    """Rows of a folder, one JSON line each, appended as walks end; the last of each walk counts.

    An incomplete line from an interruption is skipped, and its walk is checked again.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.path = folder / INDEX_FOLDER / "journal.jsonl"
        self.rows: dict[tuple[str, str, int], IndexRow] = {}
        check_plain(self.path, folder)
        for entry in json_lines(self.path):
            with suppress(msgspec.ValidationError):
                self._keep(msgspec.convert(entry, IndexRow))

    def _keep(self, row: IndexRow) -> None:
        self.rows[row.scenario, row.robot, row.seed] = row

    def add(self, row: IndexRow) -> None:
        append_lines(self.path, [asdict(row)])
        self._keep(row)

    def find(self, job: Job) -> IndexRow | None:
        """The row of a walk, whether or not its file is there."""
        return self.rows.get((job.scenario.name, known_robot(job.robot).name, job.seed))

    def present(self) -> list[IndexRow]:
        """Rows of walks that fell or whose files exist, sorted."""
        rows = [r for r in self.rows.values() if r.falls or (self.folder / r.file).is_file()]
        return sorted(rows, key=lambda r: (r.scenario, r.robot, r.seed))


def write_index(folder: Path, rows: Sequence[IndexRow]) -> Path:
    """Write `_dataset/index.parquet` and `_dataset/README.md`, each whole; returns the index."""
    frame = pd.DataFrame([asdict(row) for row in rows], columns=[f.name for f in fields(IndexRow)])
    path = folder / INDEX_FOLDER / "index.parquet"
    with whole_file(path, force=True) as temporary:
        frame.to_parquet(temporary, index=False)
    write_whole(path.with_name("README.md"), card(frame), force=True)
    return path


def card(rows: pd.DataFrame) -> str:
    """Summary of the folder, in a few lines and one table; `rows` as in the index."""
    whole = rows[rows.falls == 0]
    table = []
    for _, part in rows.groupby(["scenario", "robot"], sort=False, dropna=False):
        mean = part.loc[part.falls == 0, list(FACTS)].mean(skipna=False)
        row = {"scenario": part.scenario.iloc[0], "robot": part.robot.iloc[0]}
        row |= {"walks": len(part), "falls": part.falls.sum()}
        row |= {"length [m]": mean.length, "duration [s]": mean.duration}
        table.append(row | {"slip [%]": 100.0 * mean.slip_share, "creep [mm/s]": 1e3 * mean.creep})
    versions = ", ".join(f"{name} {v}" for name, v in _versions().items())
    return (
        "# Simulated quadruped walks\n\n"
        f"{len(whole)} logs, {whole.duration.sum() / 60:.1f} min, "
        f"{whole.length.sum():.0f} m; {len(rows) - len(whole)} walks ended in a fall and "
        f"have no log. Made with {versions}.\n\n"
        f"{to_markdown(table)}\n\n"
        "One Parquet file a walk, sensors at 500 Hz, with the true motion; SI units, quaternions "
        "w, x, y, z. `index.parquet` has what each walk's seed drew, how it went and its "
        "file's sha256.\n"
        f"Slip: share of the loaded feet's samples faster than {SLIPPING} m/s over the ground. "
        f"Creep: median speed of loaded feet where mu >= {DRY}.\n"
    )
