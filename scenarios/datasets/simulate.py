"""Batches of walks: scenarios times seeds, one log each, with an index; an interrupted run is
resumed.
"""

from collections import Counter
from functools import partial
from pathlib import Path

from surefoot.scenarios.datasets.cluster import walk_on_cluster
from surefoot.scenarios.datasets.index import (
    INDEX_FOLDER,
    MINUTE,
    IndexRow,
    Journal,
    fall_path,
    log_name,
    recipe,
    row_of,
    walk_facts,
    write_index,
)
from surefoot.scenarios.datasets.walk_file import walk_and_save
from surefoot.scenarios.settings import SimulateSettings
from surefoot.scenarios.stages import percent_bar
from surefoot.sim.common.errors import SurefootError, check_seed
from surefoot.sim.common.files import (
    as_made,
    check_space,
    clear_debris,
    force_option,
    is_there,
    refuse_overwrite,
    write_whole,
)
from surefoot.sim.common.limits import bounded_text, check_limit
from surefoot.sim.common.sources import code_digest
from surefoot.sim.effects import Effect
from surefoot.sim.effects.file import load_effects, to_toml
from surefoot.sim.log import Log, LogReader
from surefoot.sim.scenario import Ranges, Scenario
from surefoot.sim.walking.batch import Job, known_robot, on_threads, plan_of
from surefoot.sim.walking.long_walk import LONG_WALK

BYTES_PER_SECOND = 150e3
"""Size of a log's file per second of walking [bytes/s]: 500 rows of some 80 columns, compressed to
half.
"""


def simulate(settings: SimulateSettings) -> list[IndexRow]:
    """Simulate every scenario with every seed into `out`/<scenario>_<seed>.parquet; returns the
    rows. Logs have the robot in their name too if it is not the scenario's own.

    A fall is a row without a file, and its log is in `_dataset/falls`; `_dataset/` contains the
    index. Finished walks are kept, so that an interrupted run is resumed. Raises SurefootError for
    bad input, logs in `out` from other inputs, or if every walk fell.
    """
    out, force = settings.out, settings.force
    if settings.workers < 1:
        raise SurefootError(f"workers {settings.workers}: at least 1")
    chosen = load_effects(settings.effects) if settings.effects else ()
    hidden = chosen if settings.undeclared else ()
    if settings.undeclared and not chosen:
        raise SurefootError("undeclared: needs effects")
    seeds = seed_range(settings.seeds)
    jobs = _jobs(settings, seeds, chosen)
    for name in dict.fromkeys(job.robot for job in jobs):
        if known_robot(name).imu is None:
            print(
                f"note: {name}: its model has no IMU, so the base frame is used instead; in an "
                "MJCF, a site named imu on the base body places one"
            )
    for scenario in {job.scenario.name: job.scenario for job in jobs}.values():
        rough = any(strip.rough for strip in scenario.ground.strips)
        if len(seeds) > 1 and scenario.ranges == Ranges() and not rough:
            print(
                f"note: {scenario.name} has no [ranges]: its seeds walk alike, and only the "
                "sensors' noise differs"
            )
    journal = Journal(out)
    for name in ("index.parquet", "README.md"):
        refuse_overwrite(out / INDEX_FOLDER / name, force=True)
    _guard_truth(out, hidden, journal, force)
    for name in {log_name(job) for job in jobs} if force else ():
        refuse_overwrite(out / f"{name}.parquet", force)
    todo = jobs if force else [job for job in jobs if not _done(journal, job)]
    seconds = sum(job.scenario.laps * s.duration for job in todo for s in job.scenario.segments)
    check_space(out, BYTES_PER_SECOND * seconds)
    names = {f".{log_name(job)}.parquet" for job in todo}
    clear_debris(p for p in out.glob(".*.tmp") if p.stem.rpartition(".")[0] in names)
    clear_debris((out / INDEX_FOLDER).rglob(".*.tmp"))
    with percent_bar("simulate") as progress:
        if settings.cluster:
            rows = walk_on_cluster(settings.cluster, todo, out, force, progress)
        else:
            work = partial(walk_and_save, out, force)
            rows = on_threads(todo, work, settings.workers, progress)
        for row in rows:
            journal.add(row)
        progress(1.0)
    index = write_index(out, journal.present())
    made = [row for job in jobs if (row := journal.find(job))]
    fallen = [(job, row) for job in jobs if (row := journal.find(job)) and row.falls]
    earlier = len(jobs) - len(todo)
    kept = f" ({_counted(earlier, 'walk')} of an earlier run kept)" if earlier else ""
    logs, falls = _counted(len(made) - len(fallen), "log"), _counted(len(fallen), "fall")
    print(f"{logs} in {out}{kept}; {falls}; index: {index}")
    for job, row in fallen:
        walk = f"{row.scenario}, {row.robot}, seed {row.seed}"
        print(f"fell: {walk}, at {row.fell_at:.1f} s {row.fall}")
        if (log := fall_path(out, job)).is_file():
            print(f"  the walk up to the fall: {log}")
    if len(fallen) == len(jobs):
        raise SurefootError(f"{out}: no walk was made, as every one ended in a fall")
    return made


def _jobs(settings: SimulateSettings, seeds: range, effects: tuple[Effect, ...]) -> list[Job]:
    """The walks of a dataset: each scenario with each seed, with these effects."""
    if not settings.scenarios:
        raise SurefootError("give at least one scenario: a file, or a bundled name")
    jobs = []
    check_limit("walks", len(seeds) * len(settings.scenarios), "walks")
    for path in settings.scenarios:
        scenario = Scenario.load(path)
        name = settings.robot or scenario.robot
        if not name:
            raise SurefootError(f"scenario {path}: names no robot: say which")
        known_robot(name)
        declared = not settings.undeclared
        jobs += [Job(scenario, name, seed, effects, declared) for seed in seeds]
    for name, count in Counter(map(log_name, jobs)).items():
        if count > 1:
            raise SurefootError(f"two scenarios would write {name}.parquet: name them differently")
    return jobs


def _guard_truth(out: Path, hidden: tuple[Effect, ...], journal: Journal, force: bool) -> None:
    """Write undeclared effects to truth.toml; refuse a folder whose logs have others, or none."""
    truth = out / "truth.toml"
    before = bounded_text(truth) if truth.exists() else ""
    text = (
        f"{to_toml(hidden)}\n# made with code {code_digest(*map(type, hidden))}\n" if hidden else ""
    )
    if (before or journal.rows) and before != text and not (force and before and text):
        raise SurefootError(
            f"{out}: holds logs with other undeclared effects, with none, or made by other code of "
            f"them; give another folder{f', or {force_option()}' if before and text else ''}"
        )
    if text and before != text:
        write_whole(truth, text, force)


def _done(journal: Journal, job: Job) -> bool:
    """Whether the walk exists, unchanged; adds the row of a log if an interruption prevented it.

    Raises SurefootError for a file of that name from another walk.
    """
    path = journal.folder / f"{log_name(job)}.parquet"
    row = journal.find(job)
    if row and row.falls:
        return row.recipe == recipe(job)
    if row and row.recipe != recipe(job) and is_there(path):
        raise SurefootError(
            f"{path}: was made from another scenario, robot, effects or code; give another "
            f"folder, or {force_option()} to make it again"
        )
    if row or not as_made(path):
        return row is not None and as_made(path, row.sha256)
    reader, made = LogReader(path), plan_of(job)
    declared = tuple(e.as_dict() for e in job.effects) if job.declared else ()
    meta = reader.meta
    found = (meta.scenario, meta.robot, meta.seed, meta.effects)
    if found != (job.scenario.name, made.robot.name, job.seed, declared):
        refuse_overwrite(path, False)
    long = reader.rows / meta.rate > LONG_WALK
    facts = walk_facts(Log.chunks(reader, MINUTE) if long else [Log.read(path)])
    journal.add(row_of(job, made, facts, path))
    return True


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def seed_range(text: str) -> range:
    """Parse `5` or `0:8` as a range. Raises SurefootError for anything else."""
    first, _, last = text[:50].partition(":")
    try:
        start = int(first)
        end = int(last) if last else start + 1
    except ValueError:
        raise SurefootError(f"seeds {text}: give a number, or a range such as 0:8") from None
    if start < 0 or end <= start:
        raise SurefootError(f"seeds {text}: the range is empty or negative")
    check_seed(end)
    check_limit("walks", end - start, f"seeds {text}: walks")
    return range(start, end)
