"""Studies of minutes: every robot over what a quadruped should walk, every course on five seeds.

`pytest -m slow -s tests/sim/test_study.py` prints the tables.
"""

import time
from pathlib import Path

import numpy as np
import pytest

from sim.course import lay_course
from sim.log import Log
from sim.robot import Robot
from sim.robot_files import known_robots
from sim.scenario import Scenario, Segment, drawn
from sim.terrain import Ground, Patch, Strip
from sim.walk import STEPS_PER_TICK, Fallen, walk
from sim.world import TIMESTEP

pytestmark = pytest.mark.slow

SUITES = Path(__file__).parents[2] / "scenarios"
# Length [m] and duration [s] of the paper's sequences.
PAPER = {
    "2CC2CCW": (53.15, 76.3), "2CCW2CC": (51.97, 95.57), "3CC3CCW": (74.65, 107.96),
    "3CCW3CC": (83.42, 129.93), "RoomScan": (38.96, 66.97), "Slipped": (19.01, 43.03),
    "Stroll": (99.21, 162.3), "Atrium": (109.93, 124.50), "BiCorridor": (240.82, 277.29),
    "BridgeLoop": (161.17, 187.20), "CorriLoop": (208.68, 229.40), "Downstair": (233.75, 270.90),
    "Overpass": (169.17, 213.49), "Quad": (447.83, 503.69), "SlopeStair": (273.37, 307.49),
    "Tunnel": (247.94, 277.00), "Upstair": (197.22, 227.89),
}  # fmt: skip
COURSES = sorted(p for suite in ("vision60", "spot") for p in (SUITES / suite).glob("*.toml"))
DRY, SLIPPING, SEEDS = 0.4, 0.05, 5
# Riser and tread as shares of the leg; thick shins and a deep belly want shallower stairs.
STAIRS = {"hyqreal1": (0.12, 0.6), "hyqreal2": (0.12, 0.6)}
SUITED = (0.15, 0.5)


def figures(scenario: Scenario, robot: Robot, seed: int) -> dict[str, float]:
    """Walk and measure; a fall is the exception of `walk`."""
    started = time.perf_counter()
    log = walk(scenario, robot, seed)
    wall = time.perf_counter() - started
    standing = log.slip > 0
    return {
        "length": path_length(log),
        "duration": log.t[-1],
        "velocity error": velocity_error(log, scenario, seed),
        "slipping": (log.slip[standing] > SLIPPING).mean(),
        "creep": np.median(log.slip[standing & (log.mu > DRY)]),
        "pace": log.t[-1] / wall,
    }


def path_length(log: Log) -> float:
    """Length [m] of the reference sampled every half second: the gait's bob does not count."""
    points = log.ref_p[:: round(0.5 * log.rate)]
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def velocity_error(log: Log, scenario: Scenario, seed: int) -> float:
    """RMS [m/s] of the forward velocity, averaged over a second, less the commanded one."""
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0])
    segments = drawn(scenario, rng).scenario.segments
    course = lay_course(segments, STEPS_PER_TICK * TIMESTEP, scenario.stand, scenario.laps)
    forward = np.einsum("nj,nj->n", log.ref_R_GI[:, :2, 0], log.ref_v[:, :2])[1::STEPS_PER_TICK]
    n = min(len(forward), len(course.t))
    window = np.full(250, 1 / 250)
    off = np.convolve(forward[:n] - course.velocity[:n, 0], window, "valid")
    return float(np.sqrt(np.mean(off**2)))


def line(name: str, f: dict[str, float], falls: str = "0") -> str:
    return (
        f"| {name} | {f['length']:.1f} | {f['duration']:.1f} | {falls} | "
        f"{f['velocity error']:.3f} | {100 * f['slipping']:.2f} | {1e3 * f['creep']:.2f} | "
        f"{f['pace']:.1f} |"
    )


HEADER = (
    "\n| walk | distance [m] | duration [s] | falls | velocity error [m/s] | slipping stance [%] "
    "| creep on dry ground [mm/s] | simulated s per s |"
)


def trials(robot: Robot) -> dict[str, Scenario]:
    """A minute on each ground, scaled to the leg."""
    leg = robot.leg_length
    v = 0.8 * np.sqrt(leg / 0.66)
    slope, steps = np.tan(np.radians(10.0)), 8
    riser, tread = STAIRS.get(robot.name, SUITED)
    rise, run = riser * leg * steps, tread * leg * steps
    up, top = 2.0 * leg, 4.0 * leg
    stairs = (
        Strip((up, 0), (up + run, 0), 9.0, (0, rise), steps=steps),
        Strip((up + run, 0), (up + run + top, 0), 9.0, (rise, rise)),
        Strip((up + run + top, 0), (up + 2 * run + top, 0), 9.0, (rise, 0), steps=steps),
    )
    side = 0.6 * v * 26.0
    hill = (
        Strip((1.0, 0), (1.0 + side, 0), 9.0, (0, side * slope)),
        Strip((1.0 + side, 0), (2.0 + side, 0), 9.0, (side * slope, side * slope)),
        Strip((2.0 + side, 0), (2.0 + 2 * side, 0), 9.0, (side * slope, 0)),
    )
    turns = (
        Segment(9, v), Segment(6, 0.5 * v, turn=0.5), Segment(9, 1.1 * v),
        Segment(6, 0.5 * v, turn=-0.6),
    )  # fmt: skip
    return {
        "flat": Scenario("flat", turns, Ground(0.8), laps=2),
        "slope": Scenario("slope", (Segment(58, 0.6 * v),), Ground(0.8, (), 80, hill)),
        "ice": Scenario(
            "ice",
            (Segment(20, 0.5 * v), Segment(20, 0.4 * v, turn=0.3), Segment(18, 0.6 * v)),
            Ground(0.8, (Patch(4.0, 0.0, 4.0, 12.0, 0.15),)),
        ),
        "stairs": Scenario("stairs", (Segment(58, 0.5 * v),), Ground(0.8, (), 80, stairs)),
    }


@pytest.mark.parametrize("name", sorted(known_robots()))
def test_every_robot_walks_a_minute_of_everything(name):
    robot = Robot.load(name)
    print(HEADER)
    fallen = []
    for ground, scenario in trials(robot).items():
        try:
            print(line(f"{name} {ground}", figures(scenario, robot, 0)))
        except Fallen as error:
            print(f"| {name} {ground} | {error} |")
            fallen.append(ground)
    assert not fallen


@pytest.mark.parametrize("path", COURSES, ids=lambda p: p.stem)
def test_every_course_keeps_the_papers_length_on_five_seeds(path):
    scenario = Scenario.load(path)
    robot = Robot.load(scenario.robot or "")
    length, duration = PAPER[scenario.name]
    rows = [figures(scenario, robot, seed) for seed in range(SEEDS)]
    mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
    print(HEADER)
    print(line(scenario.name, mean, f"0 of {SEEDS}"))
    for row in rows:
        assert row["length"] == pytest.approx(length, rel=0.02)
        assert row["duration"] == pytest.approx(duration, rel=0.02)
        assert row["creep"] < 1e-3
