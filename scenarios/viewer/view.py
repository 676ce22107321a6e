"""Show recordings in the rerun viewer, on this screen or in a browser on this machine, and record
logs and courses that are not walked yet for it.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.scenarios.viewer.recording import RecordedWalk, write_recording
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import check_unchanged, is_file
from surefoot.sim.ground.ground_metadata import ground_metadata
from surefoot.sim.ground.height_map import height
from surefoot.sim.log import Log, Meta
from surefoot.sim.log.schema import JOINTS
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import SETTLING_TIME, Plan, plan

COURSE_RATE = 50.0  # Hz, of the poses of a preview
_MAGIC = (b"RRF2", b"RRIO")  # the first bytes of every .rrd since rerun 0.2


def view(path: str | Path, web: bool = False) -> None:
    """Show the recording until the viewer (or, with `web`, the server) is closed.

    The server listens on 127.0.0.1 only. Raises SurefootError where `path` is missing or is no
    recording, or where the viewer ends with an error.
    """
    file = Path(path)
    if not is_file(file):
        raise SurefootError(f"{file}: no such file")
    with file.open("rb") as stream:
        start = stream.read(4)
    if start not in _MAGIC:
        raise SurefootError(f"{file}: is not a rerun recording")
    check_unchanged(file)
    how = "--web-viewer" if web else "--new"
    command = [sys.executable, "-m", "rerun", how, "--bind", "127.0.0.1", str(file)]
    try:
        code = subprocess.run(command, check=False).returncode
    except KeyboardInterrupt:
        return
    if code != 0:
        hint = "" if web else "; without a screen, try --web"
        raise SurefootError(f"{file}: the rerun viewer ended with exit code {code}{hint}")


def write_preview(
    source: str, path: Path, robot: str | None = None, seed: int = 0, force: bool = False
) -> None:
    """Write the recording of a log, or of a scenario's course as drawn with the seed.

    Raises SurefootError for anything else, and where it lacks what a recording shows.

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
    scenario = Scenario.load(source)
    name = robot or scenario.robot
    if not name:
        raise SurefootError(f"scenario {source}: names no robot: say which")
    made = plan(scenario, Robot.load(name), seed)
    write_recording(path, RecordedWalk(_course_log(made), made.robot, {}), force)


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
    scenario, ground = f"{made.scenario.name}, before it is walked", ground_metadata(made.ground)
    meta = Meta(COURSE_RATE, robot=made.robot.name, scenario=scenario, model=ground)
    return Log(pd.DataFrame(columns), meta, "course")
