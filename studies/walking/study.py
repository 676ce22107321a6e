"""How robots walk: every robot on four grounds, and every course with several seeds, in one table.

After each walk the bare engine steps the same model through the same torques, on the same thread.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import thread_time
from typing import Annotated, Any

import numpy as np
import pandas as pd
from tyro.conf import UseAppendAction, arg

from studies.bench.walking import COURSE, Replay
from studies.command import OutputFolder
from studies.walking.grounds import grounds_for
from surefoot import Scenario
from surefoot.extend import Motion, SurefootError, bundled_scenarios, check_limit, known_robots
from surefoot.scenarios.datasets.index import DRY, recipe, walk_facts
from surefoot.scenarios.reporting import (
    Section,
    finished_case,
    origin_of,
    percent_bar,
    read_case,
    refuse_overwrite,
    to_csv,
    to_markdown,
    whole_folder,
    write_page,
)
from surefoot.sim.physics.foot_truth import SLIPPING
from surefoot.sim.physics.scene import TIMESTEP
from surefoot.sim.walk import (
    SETTLING_TIME,
    STEPS_PER_TICK,
    Fallen,
    Plan,
    plan,
    record,
    simulate_motion,
)
from surefoot.sim.walking.batch import Job, known_robot, on_threads

MEAN_OVER = 1.0  # s, two gait cycles or more: the velocity's bob within them does not count
_MODULE = "studies.walking.study"
_TITLE = "How the robots walk"
DIGITS = {"velocity error [m/s]": 3, "slipping [%]": 2, "creep [mm/s]": 2, "pace": 0}
"""Columns of the page's table, and their decimals."""
LEGEND = (
    "Means over the seeds that did not fall. Velocity error: root mean square of the base's "
    f"velocity, averaged over {MEAN_OVER:g} s, less the commanded one. Slipping: share of the "
    f"loaded feet's samples faster than {SLIPPING} m/s over the ground. Creep: median speed of "
    f"loaded feet where mu >= {DRY}. Pace: simulated seconds per second of one thread, "
    "controller and sensors included; bare: `mujoco.rollout` of the same model, state and "
    "torques on that thread, with seed 0."
)


@dataclass(frozen=True)
class WalkRow:
    """One walk of the study; NaN for quantities that a fall leaves unmeasured."""

    robot: str
    walk: str  # the ground, or the course
    seed: int
    falls: int
    distance: float = np.nan  # m, of the reference's path sampled every 0.5 s
    duration: float = np.nan  # s
    velocity_error: float = np.nan  # m/s, root mean square
    slip_share: float = np.nan  # of the loaded feet's samples
    creep: float = np.nan  # m/s, median speed of loaded feet on dry ground
    pace: float = np.nan  # simulated s per s of its thread
    bare_pace: float = np.nan  # the same, of the bare engine; measured with seed 0


@dataclass(frozen=True)
class WalkingStudy:
    """Measure how robots walk: falls, tracking, slip, creep and speed on four grounds and courses.

    Without --robot and --course: every known robot, and the courses of both suites.
    """

    out: OutputFolder
    """Folder for walking.md and finished walks."""
    robot: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME|FILE")] = ()
    """Name of a robot, or its file (MJCF or URDF); it walks on flat ground, a slope, a slippery
    patch and stairs.
    """
    course: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME|FILE")] = ()
    """Scenario (TOML file or bundled name), walked by its own robot with every seed."""
    seeds: int = 5
    """Number of seeds of each course, from 0."""
    workers: int = 1
    """Number of walks at a time."""
    data: Path | None = None
    """Folder of finished walks, which later runs reuse; by default `walks` in the output."""
    page: Path | None = None
    """Page of results to write as well, such as docs/results/walking.md."""
    force: bool = False
    """Replace what an earlier run of this study wrote."""

    def run(self) -> None:
        print(report(walking_study(self)))
        print(f"table: {self.out / 'walking.md'}")


def walking_study(options: WalkingStudy) -> list[WalkRow]:
    """Write `walking.md` and `walking.csv` (one row per walk); returns the walks.

    A robot walks its four grounds with seed 0.
    """
    robots, courses, out = options.robot, options.course, options.out
    if not robots and not courses:
        robots = tuple(known_robots())
        suites = ("vision60", "spot")
        courses = [c for suite in suites for c in bundled_scenarios() if c.startswith(f"{suite}/")]
    table, rows = out / "walking.md", out / "walking.csv"
    for path in (table, rows):
        refuse_overwrite(path, options.force)
    if options.seeds < 1 or options.workers < 1:
        raise SurefootError("--seeds and --workers: at least 1")
    check_limit("walks", options.seeds, "--seeds")
    check_limit("workers", options.workers, "--workers")
    on_grounds = [Job(g, name, 0) for name in robots for g in grounds_for(known_robot(name))]
    on_courses = [_course_job(path, seed) for path in courses for seed in range(options.seeds)]
    jobs = [*on_grounds, *on_courses]
    order = {(known_robot(j.robot).name, j.scenario.name, j.seed): i for i, j in enumerate(jobs)}
    jobs.sort(key=lambda job: job.seed)  # every course once before any twice
    folder = options.data or out / "walks"
    if any(_finished(folder, job) is None for job in jobs):
        walked(Job(COURSE, "spot_class", 0))  # compiles what is compiled at first use

    def row_of(job: Job, progress: Callable[[float], None]) -> WalkRow:
        inputs = {"recipe": recipe(job)}
        row = finished_case(
            folder, _case(job), inputs, _MODULE, lambda: asdict(walked(job, progress))
        )
        return WalkRow(**row)

    with percent_bar("walking") as progress:
        walks = list(on_threads(jobs, row_of, options.workers, progress))
    walks.sort(key=lambda w: order[w.robot, w.walk, w.seed])
    with whole_folder(out, options.force) as made:
        (made / rows.name).write_text(to_csv([asdict(w) for w in walks]), encoding="utf-8")
        (made / table.name).write_text(report(walks), encoding="utf-8")
    if options.page:
        sections = walking_sections(_lines(walks))
        write_page(options.page, _TITLE, sections, origin_of(_MODULE, "make study-walking"))
    return walks


def walked(job: Job, progress: Callable[[float], None] | None = None) -> WalkRow:
    """Simulate and measure one walk and, with seed 0, time the bare engine on the same work.

    Time is the CPU time of the thread.
    """
    robot = known_robot(job.robot)
    began = thread_time()
    made = plan(job.scenario, robot, job.seed, job.effects)
    try:
        motion = simulate_motion(made.world, robot, made.gait, made.course, progress)
    except Fallen as fall:
        return WalkRow(
            robot.name, job.scenario.name, job.seed, 1, duration=fall.time - SETTLING_TIME
        )
    log = record(made, motion)
    between = thread_time()
    if job.seed == 0:
        Replay.of([(made, motion)]).run()
    ended = thread_time()
    found = walk_facts([log])
    simulated = len(motion.tau) * TIMESTEP
    return WalkRow(
        robot=robot.name,
        walk=job.scenario.name,
        seed=job.seed,
        falls=0,
        distance=found["length"],
        duration=found["duration"],
        velocity_error=velocity_error(made, motion),
        slip_share=found["slip_share"],
        creep=found["creep"],
        pace=simulated / (between - began),
        bare_pace=simulated / (ended - between) if job.seed == 0 else np.nan,
    )


def velocity_error(made: Plan, motion: Motion) -> float:
    """RMS [m/s] of the base's velocity minus the commanded one, along and across the heading.

    Both are means over MEAN_OVER, after settling.
    """
    ticks = slice(round(SETTLING_TIME / TIMESTEP), None, STEPS_PER_TICK)
    ahead = motion.R_GB[ticks, :2, 0]
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    aside = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    v = motion.v_GB[ticks, :2]
    moved = np.column_stack([(v * ahead).sum(axis=1), (v * aside).sum(axis=1)])
    wanted = made.course.velocity[round(SETTLING_TIME / TIMESTEP / STEPS_PER_TICK) :, :2]
    n = min(len(moved), len(wanted))
    window = round(MEAN_OVER / (TIMESTEP * STEPS_PER_TICK))
    total = np.cumsum(np.vstack([np.zeros(2), moved[:n] - wanted[:n]]), axis=0)
    off = (total[window:] - total[:-window]) / window
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def report(walks: Sequence[WalkRow]) -> str:
    """The table in Markdown, with the meaning of its columns."""
    return f"# {_TITLE}\n\n{to_markdown(_lines(walks))}\n\n{LEGEND}\n"


def walking_sections(lines: Sequence[Mapping[str, Any]]) -> list[Section]:
    """Findings with medians over the robots by ground and course, and every robot's line."""
    frame = pd.DataFrame(lines)
    fell, walked = frame["falls"].str.split(" of ", expand=True).astype(int).to_numpy().T
    numbers = frame[[*DIGITS, "bare"]].apply(pd.to_numeric, errors="coerce")
    frame = frame[["walk"]].assign(walks=walked, falls=fell).join(numbers)
    by = frame.groupby("walk", sort=False)
    table = pd.DataFrame(by[["walks", "falls"]].sum())
    for name, digits in DIGITS.items():
        table[name] = by[name].median().map(f"{{:.{digits}f}}".format)
    fallen = [f"{row['robot']} on {row['walk']}" for row, n in zip(lines, fell, strict=True) if n]
    names = f": {', '.join(fallen)}" if fallen else ""
    text = (
        f"{fell.sum()} of {walked.sum()} walks end in a fall{names}.\n\n"
        f"In the median over robots and courses, the base misses the commanded velocity by "
        f"{numbers['velocity error [m/s]'].median():.3f} m/s, loaded feet slip on "
        f"{numbers['slipping [%]'].median():.2f} % of their samples, and standing feet creep by "
        f"{numbers['creep [mm/s]'].median():.2f} mm/s. A thread simulates "
        f"{numbers['pace'].median():.0f} s of walking in one second; the bare engine, on the same "
        f"work, {numbers['bare'].median():.0f} s."
    )
    return [
        Section("Findings", text, table.reset_index()),
        Section("Columns", LEGEND),
        Section("Every robot and course", "", list(lines), file="robots"),
    ]


def _lines(walks: Sequence[WalkRow]) -> list[dict[str, Any]]:
    alike: dict[tuple[str, str], list[WalkRow]] = {}
    for walk in walks:
        alike.setdefault((walk.robot, walk.walk), []).append(walk)
    return [_line(group) for group in alike.values()]


def _line(walks: Sequence[WalkRow]) -> dict[str, Any]:
    def mean(name: str, digits: int, factor: float = 1.0) -> str:
        values = np.array([getattr(walk, name) for walk in walks if not walk.falls])
        values = values[np.isfinite(values)]
        return f"{factor * values.mean():.{digits}f}" if values.size else "–"

    return {
        "robot": walks[0].robot,
        "walk": walks[0].walk,
        "falls": f"{sum(w.falls for w in walks)} of {len(walks)}",
        "distance [m]": mean("distance", 1),
        "duration [s]": mean("duration", 1),
        "velocity error [m/s]": mean("velocity_error", 3),
        "slipping [%]": mean("slip_share", 2, 100.0),
        "creep [mm/s]": mean("creep", 2, 1e3),
        "pace": mean("pace", 0),
        "bare": mean("bare_pace", 0),
    }


def _case(job: Job) -> str:
    """Name of a walk's finished case."""
    return re.sub(r"\W+", "_", f"{known_robot(job.robot).name} {job.scenario.name} {job.seed}")


def _finished(folder: Path, job: Job) -> dict[str, Any] | None:
    return read_case(folder, _case(job), {"recipe": recipe(job)}, _MODULE)


def _course_job(path: str | Path, seed: int) -> Job:
    scenario = Scenario.load(path)
    if not scenario.robot:
        raise SurefootError(f"scenario {path}: names no robot")
    return Job(scenario, scenario.robot, seed)
