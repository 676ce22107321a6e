"""Align a reference with the IMU of its log: report, numbers, figure and aligned log."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from surefoot.models.alignment.alignment import Alignment, align, aligned_log, noted_as_aligned
from surefoot.models.alignment.rotation_guess import LEAST_OVERLAP, rates_of, smoothed
from surefoot.scenarios.reporting.palette import AFTER, TRUTH
from surefoot.scenarios.reporting.plotting import legend_below, new_figure, save_figure, set_title
from surefoot.scenarios.settings import AlignSettings
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import refuse_overwrite, whole_folder, write_whole
from surefoot.sim.common.quaternion import matrix_from_quaternion
from surefoot.sim.importing.assemble import RawRecording
from surefoot.sim.importing.recording import read_recording
from surefoot.sim.importing.reference import REFERENCE_OFFSET, reference_offset, tracked_poses
from surefoot.sim.log import Log
from surefoot.sim.log.reference import Poses, reference_poses
from surefoot.sim.robot import Robot

_OUTPUTS = ("alignment.json", "alignment.png", "aligned.parquet")
_SHOWN = 4.0
"""Length of the section that is plotted [s]: some strides."""


def align_file(settings: AlignSettings) -> tuple[Alignment, tuple[str, ...]]:
    """Align a log, or a recording with its map; returns the result and a description.

    Raises SurefootError where a file exists (without `force`), IMU or reference are missing or
    overlap too little, or the robot is unknown.
    """
    out, robot = settings.out, settings.robot
    for name in _OUTPUTS:
        refuse_overwrite(out / name, settings.force)
    file, map_path = settings.file, settings.map
    recording = None if map_path is None else read_recording(file, map_path, robot)
    log, poses, about, R_GW = _read(settings.file, recording)
    if len(poses.t) < 2 or min(np.ptp(log.t), np.ptp(poses.t)) < LEAST_OVERLAP:
        raise SurefootError(f"{log.name}: IMU and reference share too little to be aligned")
    at = Robot.for_log(log, robot) if robot else None
    found = align(log, poses, settings.most, about=about, R_GW=R_GW)
    if recording is None or recording.poses is None:
        aligned = aligned_log(log, found, poses)
    else:
        aligned = noted_as_aligned(recording.with_reference(found.map_values).log(), found)
    with whole_folder(out, settings.force) as folder:
        write_whole(folder / "alignment.json", json.dumps(found.as_dict(), indent=1) + "\n")
        save_figure(figure(log, poses, found), folder / "alignment.png")
        aligned.write(folder / "aligned.parquet")
    said = list(found.lines)
    if at:
        x, y, z = 1e3 * (at.p_BI + at.R_BI @ found.p_IM)
        said.insert(2, f"       at ({x:.0f}, {y:.0f}, {z:.0f}) mm in the base of {robot}")
    return found, (*said, "", *_map_lines(found, recording))


def _map_lines(found: Alignment, recording: RawRecording | None) -> tuple[str, ...]:
    """The whole [reference] of the recording's map with the alignment, or the keys to replace."""
    reference = None if recording is None else recording.rules.sections.reference
    if recording is None or reference is None:
        said = "for the import map, in place of these keys of its [reference]"
        return (f"{said}; if it has p_IM or q_IM already, align with --map:", *found.map_lines())
    said = "for the import map, in place of its [reference], before [reference.columns]:"
    return (said, *found.map_lines(reference, recording.name))


def figure(log: Log, poses: Poses, found: Alignment) -> Figure:
    """Plot the gyro and the rotation of the tracked body, before and after."""
    t, gyro = log.t, log.gyro
    begin = _busiest(found.fitted.t, gyro, t)
    at = np.arange(begin, begin + _SHOWN, 0.01)
    seen = smoothed(at, t, gyro)
    middle, rates = rates_of(poses)
    before = smoothed(at, middle, rates)
    after = smoothed(at, middle + found.offset, rates @ found.R_IM.T) + found.bias_gyro
    drawn, axes = new_figure(3, 2, size=(9.0, 6.0))
    recorded = "As recorded" + ": reference at other times" * bool(np.isnan(before).all())
    for column, (other, title) in enumerate(((before, recorded), (after, "Aligned"))):
        set_title(axes[0, column], title)
        for row, axis in enumerate("xyz"):
            ax = axes[row, column]
            ax.plot(at, seen[:, row], color=TRUTH, linewidth=2.5, label="gyro")
            ax.plot(at, other[:, row], color=AFTER, linewidth=1.2, label="reference")
            ax.set_ylabel(f"{axis} [rad/s]")
        axes[2, column].set_xlabel("time [s]")
    legend_below(drawn, axes[0, 1])
    return drawn


def _read(file: Path, recording: RawRecording | None) -> tuple[Log, Poses, float, np.ndarray]:
    """The log, the poses of its reference, the clock offset that its map adds to theirs [s], and
    the rotation (3, 3) by which it turns their world.
    """
    reference = None if recording is None else recording.rules.sections.reference
    if recording is not None and recording.poses is not None and reference is not None:
        R_GW = matrix_from_quaternion(np.array(reference.q_GW))
        poses = tracked_poses(recording.poses, replace(reference, q_GW=(1.0, 0.0, 0.0, 0.0)))
        about = reference_offset(recording.rules, recording.name)
        return recording.without_reference().log(), poses, about, R_GW
    log = recording.log() if recording is not None else Log.read(file)
    log.require("imu", "reference")
    # Its poses have the offset of its map already.
    poses, about = reference_poses(log), log.meta.model.get(REFERENCE_OFFSET, 0.0)
    return log, replace(poses, t=poses.t - about), about, np.eye(3)


def _busiest(shared: np.ndarray, gyro: np.ndarray, t: np.ndarray) -> float:
    """Start of the _SHOWN seconds, within the shared times, in which the IMU rotates most."""
    starts = shared[shared < max(shared[-1] - _SHOWN, shared[0] + 0.1)]
    turned = np.cumsum(np.sum(gyro**2, axis=1))
    within = np.interp(starts + _SHOWN, t, turned) - np.interp(starts, t, turned)
    return float(starts[np.argmax(within)])
