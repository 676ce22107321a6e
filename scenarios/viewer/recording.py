"""One walk and its estimates as a rerun recording with a layout of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import rerun as rr

from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.scenarios.estimate.error_series import ErrorSeries, error_series
from surefoot.scenarios.estimate.estimators import shown_at_first
from surefoot.scenarios.viewer.blueprint import EXPLANATION, layout
from surefoot.scenarios.viewer.scene import write_scene
from surefoot.scenarios.viewer.series import write_errors, write_feet, write_update, write_velocity
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled, whole_file
from surefoot.sim.common.toml import read_toml
from surefoot.sim.ground.ground_metadata import ground_of_log
from surefoot.sim.log import Log
from surefoot.sim.physics.foot_truth import SLIPPING
from surefoot.sim.robot import Robot

if TYPE_CHECKING:
    from surefoot.models.calibration.bounds import Bounds
    from surefoot.models.observer.predict import Prediction

_ABOUT = bundled("surefoot.scenarios.viewer", "about.toml")
_ERROR_RATE = 20.0  # Hz; errors and paths change over seconds, not over milliseconds


@dataclass(frozen=True)
class RecordedWalk:
    """A walk and what a recording shows of it.

    Attributes:
        log: the walk; needs its joints and a reference. Contacts, truth and IMU are optional.
        robot: whose geoms are drawn, and which has the mounting of the IMU.
        trajectories: estimator name -> its estimate.
        prediction: the observer's rows (M,) of the log and v_I (M, 3) m/s there.
        bounds: of that observer; they are rotated to the robot's IMU if its mounting differs.
    """

    log: Log
    robot: Robot
    trajectories: Mapping[str, Trajectory]
    prediction: Prediction | None = None
    bounds: Bounds | None = None


def write_recording(
    path: str | Path, walk: RecordedWalk, force: bool = False, tab: str = EXPLANATION
) -> None:
    """Write the .rrd. Raises SurefootError where it exists (without `force`) or the log lacks a
    group.

    Entities: /world/{ground, robot, truth, footprints, estimates/<name>}, /velocity/{x,y,z},
    /distance, /position_error/{x,y,z}, /attitude_error/{roll,pitch,yaw} each by estimator,
    /feet/{contact, slip}/<leg>, /update/<estimator>, /about. One timeline, "time": the log's t.

    Args:
        path: file to write, with the suffix .rrd.
        walk: what is shown.
        force: overwrite.
        tab: of the viewer that is open initially.
    """
    walk.log.require("q", "reference")
    if Path(path).suffix != ".rrd":
        raise SurefootError(f"{path}: a recording's name ends in .rrd")
    with whole_file(path, force) as temporary:
        temporary.write_bytes(recording(walk, Path(path).stem, tab))


def recording(walk: RecordedWalk, title: str, tab: str = EXPLANATION) -> bytes:
    """Content of an .rrd; `title` names a walk without a scenario (see `write_recording`)."""
    log, robot, bounds = walk.log, walk.robot, walk.bounds
    truth = reference(log)
    errors = {n: error_series(truth, e, rate=_ERROR_RATE) for n, e in walk.trajectories.items()}
    stream = rr.RecordingStream("surefoot")
    records = {name: estimate.updates for name, estimate in walk.trajectories.items()}
    records = {n: r for n, r in records.items() if r is not None and r.pi is not None}
    # Kept in memory until complete, since rerun's own files wait forever if the disk is full.
    whole = stream.memory_recording()
    blueprint = layout(log, robot, tuple(errors), bool(records), tab)
    stream.send_blueprint(blueprint, make_active=False)
    stream.send_recording_name(str(log.meta.scenario or title))
    about = rr.TextDocument(_about(walk, errors), media_type="text/markdown")
    stream.log("/about", about, static=True)
    write_scene(stream, log, robot, errors, ground_of_log(log))
    predicted = None if walk.prediction is None else walk.prediction.covariance
    epsilon = None if bounds is None else bounds.epsilon_at(robot.R_BI, predicted)
    write_velocity(stream, log, walk.prediction, epsilon)
    write_errors(stream, errors)
    if log.has("contact"):
        write_feet(stream, log)
    for name, record in records.items():
        write_update(stream, name, record, None if bounds is None else bounds.gamma)
    return whole.drain_as_bytes()


def _about(walk: RecordedWalk, errors: Mapping[str, ErrorSeries]) -> str:
    """Explanation in Markdown of what the recording shows, with each estimator's error at the end
    of the walk.
    """
    log, words = walk.log, read_toml(_ABOUT)
    ends = [f"| {n} | {e.distance[-1]:.2f} m |" for n, e in errors.items()]
    shown = shown_at_first(tuple(errors))
    table = ["| estimator | distance from the truth at the end |", "|---|---|", *ends, ""]
    at_first = words["at_first"].format(shown="; ".join(shown))
    return "\n".join(
        [
            f"# {log.meta.scenario or 'A walk'} by {walk.robot.name}, {log.t[-1] - log.t[0]:.1f} s",
            "",
            words["reference"],
            "",
            *([words["boxes"], "", *table] if errors else []),
            *([at_first, ""] if len(shown) < len(errors) else []),
            words["ground"],
            *([words["footprints"]] if log.has("contact") else []),
            words["velocity"] + (words["prediction"] if walk.prediction else ""),
            *([words["errors"]] if errors else []),
            *([words["feet"].format(slipping=SLIPPING)] if log.has("contact") else []),
            "",
            words["keys"],
        ]
    )
