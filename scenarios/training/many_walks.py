"""Many walks of one robot, drawn at random to train observers on, and the error of observers by
their number.

Each walk has another course and another robot of its kind, by one of the conditions of the suites:
a sixth equal their model, a third are built within tolerances, and half of them have in addition
the gait, sensors and effects measured on a real robot.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import takewhile
from pathlib import Path

import numpy as np

from surefoot.models.observer.observer import Observer
from surefoot.models.observer.predict import prediction_errors
from surefoot.models.observer.settings import TrainSettings
from surefoot.scenarios.datasets.as_walked import BUNDLED
from surefoot.scenarios.datasets.conditions import Condition, load_conditions
from surefoot.scenarios.datasets.kept_walks import DrawnWalk, KeptLogs, kept_walks
from surefoot.scenarios.datasets.simulate import BYTES_PER_SECOND
from surefoot.scenarios.reporting.html import Picture, Section, write_report
from surefoot.scenarios.reporting.observer_errors import error_by_number
from surefoot.scenarios.settings import WalksSettings
from surefoot.scenarios.stages import percent_bar
from surefoot.scenarios.training.drawn_course import drawn_course
from surefoot.sim.common.errors import SurefootError, check_seed
from surefoot.sim.common.files import cache_folder, check_space, whole_folder
from surefoot.sim.common.limits import check_limit
from surefoot.sim.effects import Effect
from surefoot.sim.log import Log
from surefoot.sim.physics.scene import robot_spec
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walking.batch import known_robot
from surefoot.sim.walking.trial import why_not

SECONDS = 60.0
"""Approximate duration of a drawn course [s]."""
ATTEMPTS = 4
"""Draws of a walk before it is left out."""
SIZE_DRAWS = 20
"""Draws of the size of a machine's own effect before it is the one found."""
SIZES = (0.5, 1.5)
"""Factor on the size of each effect, which is that of one robot."""
SUITE = BUNDLED.with_name("spot.toml")
"""The experiment whose conditions the robots are drawn by."""
SHARES = {"as drawn": 1 / 6, "as built": 1 / 3, "as walked": 1 / 2}
"""Share of the walks under each of these conditions."""
ROLES = ("train", "held_out", "test", "calibrate")
"""Roles of walks; those of different roles are drawn independently."""
HELD_OUT = 4, 1 / 6
"""Walks held out to stop by: at least, and as a share of those to train on."""
CAPTION = (
    "Root mean square error of the velocity over all test walks, each of equal weight, against the "
    "number of walks to train on."
)


@dataclass(frozen=True)
class OwnEffects:
    """Effects of one machine, in place of those of the same kind that are drawn for any robot.

    Attributes:
        effects: with the sizes found.
        spread: standard deviation of a size, in its unit, by name and target; others are exact.
    """

    effects: Sequence[Effect] = ()
    spread: Mapping[tuple[str, str], float] = field(default_factory=dict)

    def drawn(self, rng: np.random.Generator, robot: Robot) -> Iterator[Effect]:
        """The effects with sizes from normal distributions about theirs, within their bounds and
        such that this robot can have them: no foot or link has less than nothing.
        """
        for one in self.effects:
            if spread := self.spread.get((one.name, one.target)):
                low, high = one.bounds_on(None, one.target)
                sizes = (rng.normal(one.value, spread) for _ in range(SIZE_DRAWS))
                drawn = (replace(one, value=float(np.clip(size, low, high))) for size in sizes)
                one = next((other for other in drawn if _can_have(robot, other)), one)
            yield one


def _can_have(robot: Robot, one: Effect) -> bool:
    try:
        one.edit_spec(robot_spec(robot), robot)
    except SurefootError:
        return False
    return True


def many_walks(
    settings: WalksSettings, scenarios: Sequence[str] = (), role: str = "train"
) -> KeptLogs:
    """Simulate walks of a role: `settings.walks` to train on or to calibrate with, or as many as
    are held out (`DrawnWalks`).

    Raises SurefootError where no robot is named, it cannot walk, or all walks are left out.

    Args:
        settings: number and seed of the walks, and the robot, by default that of the scenarios.
        scenarios: files or names, taken in turn; by default a course is drawn for each walk.
        role: one of ROLES.
    """
    aside = role in ("held_out", "test")
    count = held_out_walks(settings.walks) if aside else settings.walks
    if settings.walks < 1 or settings.workers < 0:
        raise SurefootError("walks must be at least 1, and workers not negative")
    check_limit("walks", count, "walks")
    check_seed(settings.walk_seed)
    if logs := [one for one in scenarios if one.endswith(".parquet")]:
        raise SurefootError(f"{logs[0]}: a log; with --walks, give scenarios or nothing")
    courses = [Scenario.load(one) for one in scenarios]
    robots = {settings.robot} if settings.robot else {course.robot for course in courses}
    if len(robots) != 1 or (robot := next(iter(robots))) is None:
        raise SurefootError("walks: give one robot (--robot), since an observer is of one")
    walks = DrawnWalks(known_robot(robot), role, settings.walk_seed, courses)
    return walks.kept(count, settings.workers)


@dataclass(frozen=True)
class DrawnWalks:
    """Walks of a role, each always the same by its number.

    Attributes:
        robot: of them.
        role: one of ROLES.
        seed: of all walks.
        courses: taken in turn; by default one is drawn for each walk.
        own: effects of this machine.
    """

    robot: Robot
    role: str
    seed: int
    courses: Sequence[Scenario] = ()
    own: OwnEffects = OwnEffects()

    def walk(self, number: int, attempt: int) -> DrawnWalk:
        """The walk of a number, drawn anew in each attempt."""
        rng = np.random.default_rng([self.seed, ROLES.index(self.role), number, attempt])
        if self.courses:
            scenario = self.courses[number % len(self.courses)]
        else:
            scenario = drawn_course(f"drawn_{number}", SECONDS, rng)
        condition = _conditions()[rng.choice(list(SHARES), p=list(SHARES.values()))]
        drawn = condition.walk(scenario, self.robot, int(rng.integers(2**31)))
        known = {one.name for one in self.own.effects}
        others = [one for one in drawn.effects if one.name not in known]
        effects = [_resized(one, rng.uniform(*SIZES)) for one in others]
        return replace(drawn, effects=[*effects, *self.own.drawn(rng, self.robot)])

    def kept(self, count: int, workers: int = 0) -> KeptLogs:
        """Simulate so many of them, `workers` at once, by default one for each core.

        Walks in which the robot falls each time that they are drawn are left out, with a line.
        Raises SurefootError where it cannot walk, or all walks are left out.
        """
        name, role = self.robot.name, self.role
        if fault := why_not(self.robot):
            raise SurefootError(f"robot {name} cannot walk in simulation: {fault}")
        check_space(cache_folder(), BYTES_PER_SECOND * SECONDS * count)
        with percent_bar(f"walking: {role}") as progress:
            made = kept_walks(self.walk, count, ATTEMPTS, role, progress, workers)
        left = count - len(made)
        if left:
            print(f"{role}: {left} of {count} walks left out, on which the robot falls")
        if not made:
            raise SurefootError(f"walks: {name} falls on every one")
        return made


def held_out_walks(walks: int) -> int:
    """Number of walks that are held out of so many to train on."""
    least, share = HELD_OUT
    return max(least, round(share * walks))


def _resized(one: Effect, factor: float) -> Effect:
    low, high = one.traced.bounds_on_legs or one.bounds
    return replace(one, value=float(np.clip(factor * one.value, low, high)))


@cache
def _conditions() -> dict[str, Condition]:
    """Those of the suites, by name."""
    return {one.name: one for one in load_conditions(SUITE)}


def write_error_by_walks(
    folder: Path,
    observer: Observer,
    walks: KeptLogs,
    held_out: Sequence[Log],
    tests: Sequence[Log],
    settings: TrainSettings,
    force: bool = False,
) -> None:
    """Train on the first 1, 4, 16, ... walks too, and write report.html with table and figure.

    Args:
        folder: to write.
        observer: trained on all `walks`.
        walks: to train on.
        held_out: to stop by.
        tests: to evaluate on.
        settings: of each training.
        force: whether the folder may be replaced.
    """
    from surefoot.models.observer.training import train

    errors = {}
    for count in takewhile(lambda n: n < len(walks), (4**k for k in range(10))):
        fewer = train(walks.first(count), None, settings, True, held_out=held_out)
        errors[count] = test_rmse(fewer, tests)
    errors[len(walks)] = test_rmse(observer, tests)
    rows = [
        {"walks": count, "RMSE [m/s]": rmse, "unseen walks": len(tests)}
        for count, rmse in errors.items()
    ]
    inputs = ",".join(observer.inputs)
    figure = Picture(error_by_number({inputs: errors}), CAPTION, "error_by_walks.png")
    with whole_folder(folder, force) as out:
        section = Section(f"Observers of {inputs}", CAPTION, rows, (figure,))
        title = f"Error of {observer.robot}'s observers by the number of walks"
        write_report(out / "report.html", title, [section])


def test_rmse(observer: Observer, tests: Sequence[Log]) -> float:
    """Root mean square of the error's norm [m/s], in which each walk has equal weight."""
    squares = [(prediction_errors(observer, log)[1] ** 2).sum(axis=1).mean() for log in tests]
    return float(np.sqrt(np.mean(squares)))
