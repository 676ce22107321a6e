"""Recordings of a course before it is walked, and of a log."""

from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.scenarios.viewer.recording import RecordedWalk, write_recording
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.ground.height_map import height
from surefoot.sim.log import Log, Meta
from surefoot.sim.log.schema import JOINTS
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.scenario_catalog import bundled_scenarios
from surefoot.sim.walk import SETTLING_TIME, Plan, plan

COURSE_RATE = 50.0  # Hz, of the poses of a preview


def write_preview(
    source: str, path: Path, robot: str | None = None, seed: int = 0, force: bool = False
) -> None:
    """Write the recording of a log, or of a scenario's course as drawn with the seed.

    Raises SurefootError for anything else, or where it lacks what a recording shows.

    Args:
        source: a log (.parquet), or a scenario's file or bundled name.
        path: of the recording.
        robot: name or file, instead of that of the log or the scenario.
        seed: of the course and its ground.
        force: whether a file may be replaced.
    """
    if Path(source).suffix == ".parquet":
        log = Log.read(source)
        write_recording(path, RecordedWalk(log, Robot.for_log(log, robot), {}), force)
        return
    if source not in bundled_scenarios() and Path(source).suffix != ".toml":
        raise SurefootError(f"{source}: view opens recordings (.rrd), logs and scenarios (.toml)")
    scenario = Scenario.load(source)
    name = robot or scenario.robot
    if not name:
        raise SurefootError(f"scenario {source}: names no robot: say which")
    made = plan(scenario, Robot.load(name), seed)
    walk = RecordedWalk(_course_log(made), made.robot, {}, ground=made.ground)
    write_recording(path, walk, force)


def _course_log(made: Plan) -> Log:
    """The robot in its home pose, moved along the course over the ground."""
    course = made.course
    ticks = np.searchsorted(course.t, np.arange(SETTLING_TIME, course.t[-1], 1.0 / COURSE_RATE))
    x, y, yaw = course.pose[ticks].T
    z = np.array([height(made.ground.height_map, *at) for at in zip(x, y, strict=True)])
    p_GI = np.column_stack([x, y, z + made.gait.height]) + made.robot.p_BI
    half = 0.5 * yaw
    columns = {"t": np.arange(len(ticks)) / COURSE_RATE}
    home = zip(JOINTS, made.robot.q_home, strict=True)
    columns |= {f"q_{name}": np.full(len(ticks), q) for name, q in home}
    columns |= {f"ref_p_{a}": p for a, p in zip("xyz", p_GI.T, strict=True)}
    zero = np.zeros(len(ticks))
    columns |= {"ref_q_w": np.cos(half), "ref_q_x": zero, "ref_q_y": zero, "ref_q_z": np.sin(half)}
    meta = Meta(
        COURSE_RATE, robot=made.robot.name, scenario=f"{made.scenario.name}, before it is walked"
    )
    return Log(pd.DataFrame(columns), meta, "course")
