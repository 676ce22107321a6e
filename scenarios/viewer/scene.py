"""The 3-D part of a recording: ground, robot, footprints, and each estimator's pose."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from surefoot.scenarios.estimate.error_series import ErrorSeries
from surefoot.scenarios.estimate.estimators import shown_at_first
from surefoot.scenarios.reporting.palette import (
    OUTSIDE,
    TRUTH,
    estimator_color,
    friction_color,
    rgba,
)
from surefoot.scenarios.viewer.shapes import (
    geom_shapes,
    height_field,
    link_poses,
    rerun_quaternion,
    visible_geoms,
)
from surefoot.sim.common.series import rows_every
from surefoot.sim.ground.ground_metadata import thinned
from surefoot.sim.ground.height_map import height
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.ground.tiles import add_ground
from surefoot.sim.log import Log
from surefoot.sim.physics.foot_truth import SLIPPING
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.stances import stances

POSE_RATE = 50.0  # Hz
_ELLIPSOID_RATE = 5.0  # Hz
_PIECE = 5  # samples of a trail that appear at once
_FLOOR_MARGIN = 2.0  # m of floor around the walk
_FOOTPRINT = (0x2B, 0x2B, 0x2B, 255)
_SHADOW = (0, 0, 0, 90)
_EDGE = (0x40, 0x3C, 0x38, 255)
_GRID_LINE = (0x40, 0x3C, 0x38, 110)
_GRID = 1.0  # m between the lines on the ground
_GRID_STEP = 0.1  # m along a line between points, on ground that is not level
_ABOVE = 0.01  # m, by which what is drawn on the ground lies above it


def send_columns(stream: rr.RecordingStream, path: str, t: np.ndarray, columns: Any) -> None:
    """Write components of an entity over t (N,) [s], on the recording's only timeline, "time": the
    log's t, as calendar time if it is seconds since the epoch.
    """
    calendar = len(t) and t[0] > 1e8
    times = rr.TimeColumn("time", timestamp=t) if calendar else rr.TimeColumn("time", duration=t)
    stream.send_columns(path, indexes=[times], columns=columns)


def estimate_path(name: str) -> str:
    """Entity of an estimator in the scene, for any name."""
    return f"world/estimates/{rr.escape_entity_path_part(name)}"


def rows_at(log: Log, rate: float) -> np.ndarray:
    """Rows of a log, every so many that they are at about `rate` [Hz]."""
    return np.arange(0, len(log.t), max(1, round(log.rate / rate)))


def write_scene(
    stream: rr.RecordingStream,
    log: Log,
    robot: Robot,
    errors: Mapping[str, ErrorSeries],
    ground: Ground | None,
) -> None:
    """Write all of /world.

    Args:
        stream: the recording.
        log: the walk.
        robot: that walked.
        errors: estimator name -> its aligned path.
        ground: as walked on, if it is known.
    """
    stream.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if ground:
        _write_ground(stream, log, ground)
        _write_shadow(stream, log, robot, ground)
    _write_robot(stream, log, robot)
    rows = rows_at(log, 20.0)
    _write_path(stream, "world/truth", (log.t[rows], log.ref_p[rows]), TRUTH, width=2.0)
    write_estimates(stream, errors, robot)
    if log.has("contact"):
        _write_footprints(stream, log, robot)


def _write_ground(stream: rr.RecordingStream, log: Log, ground: Ground) -> None:
    """Write the ground at /world/ground/friction_<mu>/..., and a label on each patch.

    Args:
        stream: the recording.
        log: the walk; the floor extends a little beyond it.
        ground: as walked on, with patches and bumps drawn by its seed.
    """
    reach = float(np.abs(log.ref_p[:, :2]).max())
    layers = (*ground.strips, *ground.fields)
    edges = [abs(edge) for layer in layers for edge in layer.rectangle]
    half = min(ground.half_size, max(reach, *edges, 0.0) + _FLOOR_MARGIN)
    spec = mujoco.MjSpec()
    # The tiles of the walk's world, except for very large height fields.
    add_ground(spec, replace(thinned(ground), half_size=half))
    model = spec.compile()
    frictions = np.round(model.geom_friction[:, 0], 2)
    for mu in np.unique(frictions):
        alike = np.flatnonzero(frictions == mu)
        root, color = f"world/ground/friction_{mu:.2f}", rgba(friction_color(mu))
        for name, shape in geom_shapes(model, alike, color):
            stream.log(f"{root}/{name}", shape, static=True)
        boxes = alike[model.geom_type[alike] == mujoco.mjtGeom.mjGEOM_BOX]
        for name, shape in geom_shapes(model, boxes, _EDGE, "majorwireframe"):
            stream.log(f"{root}/{name}_edges", shape, static=True)
        for geom in alike[model.geom_type[alike] == mujoco.mjtGeom.mjGEOM_HFIELD]:
            stream.log(f"{root}/field_{geom}", height_field(model, int(geom), color), static=True)
    stream.log("world/ground/grid", _grid(ground, half), static=True)
    for k, patch in enumerate(ground.patches):
        above = height(ground.height_map, patch.center_x, patch.center_y) + 0.02
        at, color = [patch.center_x, patch.center_y, above], [rgba(friction_color(patch.mu))]
        label = _labelled(at, f"friction {patch.mu:.2f}", color, 0.02)
        stream.log(f"world/ground/patch_{k}", label, static=True)


def _grid(ground: Ground, half: float) -> rr.LineStrips3D:
    """Lines on the ground, a metre apart, to +-half [m]."""
    level = not (ground.strips or ground.fields)
    places = _GRID * np.arange(np.ceil(-half / _GRID), np.floor(half / _GRID) + 1.0)
    along = np.array([-half, half]) if level else np.arange(-half, half, _GRID_STEP)
    lines = []
    for place in places:
        for x, y in ((along, np.full(len(along), place)), (np.full(len(along), place), along)):
            z = np.array([height(ground.height_map, *at) for at in zip(x, y, strict=True)])
            lines.append(np.column_stack([x, y, z + _ABOVE]).astype(np.float32))
    return rr.LineStrips3D(lines, colors=[_GRID_LINE], radii=[_pixels(0.4)])


def _write_shadow(stream: rr.RecordingStream, log: Log, robot: Robot, ground: Ground) -> None:
    """Write the trunk's shadow on the ground vertically below it."""
    rows = rows_at(log, POSE_RATE)
    p, R_GB = _trunk_poses(robot, log.ref_p[rows], log.ref_R_GI[rows])
    p[:, 2] = [height(ground.height_map, x, y) + _ABOVE for x, y, _ in p]
    yaw = np.arctan2(R_GB[:, 1, 0], R_GB[:, 0, 0])
    R = Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    _send_poses(stream, "world/shadow", log.t[rows], p, R)
    flat = [*(1.1 * trunk_size(robot)[:2]), 0.5 * _ABOVE]
    shape = rr.Ellipsoids3D(half_sizes=[flat], colors=[_SHADOW], fill_mode="solid")
    stream.log("world/shadow/shape", shape, static=True)


def _write_robot(stream: rr.RecordingStream, log: Log, robot: Robot) -> None:
    """Write the robot at its reference pose: one transform column per link, its shapes once."""
    model = robot.spec().compile()
    base = model.body(robot.base_name).id
    joints = np.array([model.joint(name).id for name in robot.joint_names])
    rows = rows_at(log, POSE_RATE)
    t = log.t[rows]
    p_GB, R_GB = _trunk_poses(robot, log.ref_p[rows], log.ref_R_GI[rows])
    _send_poses(stream, "world/robot", t, p_GB, R_GB)
    followed = rr.Transform3D.columns(translation=(p_GB * [1.0, 1.0, 0.0]).astype(np.float32))
    send_columns(stream, "world/follow", t, followed)
    dot = rr.Points3D([[0.0, 0.0, 0.0]], colors=[rgba(TRUTH)], radii=[_pixels(7.0)])
    stream.log("world/robot/dot", dot, static=True)
    _send_shapes(stream, "world/robot", model, base)
    for body, chain, p, R in link_poses(model, base, joints, log.q[rows]):
        path = f"world/robot/{chain}"
        if np.ptp(p, axis=0).max() + np.ptp(R, axis=0).max() < 1e-9:
            turn = rerun_quaternion(R[0]).tolist()
            stream.log(path, rr.Transform3D(translation=p[0], quaternion=turn), static=True)
        else:
            _send_poses(stream, path, t, p, R)
        _send_shapes(stream, path, model, body)


def _write_footprints(stream: rr.RecordingStream, log: Log, robot: Robot) -> None:
    """Write a dot at each foothold, magenta where the foot slipped; needs contacts and a
    reference.
    """
    contact, t = log.contact, log.t
    feet_G = log.ref_p[:, None] + np.einsum("nij,nlj->nli", log.ref_R_GI, robot.feet_I(log.q))
    slip = log.slip if log.has("truth") else np.zeros(contact.shape)
    points, slipped = [], []
    for leg in range(contact.shape[1]):
        starts, ends = stances(contact[:, leg])
        for start, end in zip(starts, ends, strict=True):
            if t[end - 1] - t[start] > 0.05:
                middle = (start + end) // 2
                points.append(feet_G[middle, leg] - [0.0, 0.0, robot.foot_radius[leg]])
                slipped.append(slip[start:end, leg].mean() > SLIPPING)
    if points:
        colors = [rgba(OUTSIDE) if s else _FOOTPRINT for s in slipped]
        radii = 0.35 * max(float(robot.foot_radius.max()), 0.02)
        stream.log("world/footprints", rr.Points3D(points, colors=colors, radii=radii), static=True)


def write_estimates(
    stream: rr.RecordingStream, errors: Mapping[str, ErrorSeries], robot: Robot
) -> None:
    """Write each estimator's path, a box of the trunk's size at its pose, and the three-sigma
    ellipsoid of its position.

    Args:
        stream: the recording.
        errors: estimator name -> its aligned path.
        robot: gives the size of the trunk, and the IMU's position in it.
    """
    size, first = trunk_size(robot), shown_at_first(tuple(errors))
    for k, name in enumerate([*first, *(n for n in errors if n not in first)]):
        error = errors[name]
        color, root = estimator_color(name), estimate_path(name)
        _write_path(stream, root, (error.t, error.p_GI), color, width=1.2)
        poses = _trunk_poses(robot, error.p_GI, error.R_GI)
        _send_poses(stream, f"{root}/body", error.t, *poses)
        _write_marker(stream, f"{root}/body", name, error, size, height=2.0 + 0.7 * k)
        _write_ellipsoid(stream, root, error, color)


def _write_ellipsoid(stream: rr.RecordingStream, root: str, error: ErrorSeries, color: str) -> None:
    """Write the estimator's position covariance, if any, as ellipsoids with semi-axes of three
    sigma.

    Args:
        stream: rerun's recording.
        root: of the estimator's entities.
        error: gives the positions of the ellipsoids and their covariances.
        color: of the estimator.
    """
    if error.position_covariance is None:
        return
    rows = rows_every(error.t, 1.0 / _ELLIPSOID_RATE)
    variance, axes = np.linalg.eigh(error.position_covariance[rows])
    axes[np.linalg.det(axes) < 0.0, :, 0] *= -1.0
    style = rr.Ellipsoids3D.from_fields(
        colors=[rgba(color, 0.25)], line_radii=[_pixels(0.7)], fill_mode="majorwireframe"
    )
    stream.log(f"{root}/ellipsoid", style, static=True)
    columns = rr.Ellipsoids3D.columns(
        centers=error.p_GI[rows].astype(np.float32),
        half_sizes=(3.0 * np.sqrt(variance.clip(0.0))).astype(np.float32),
        quaternions=rerun_quaternion(axes).astype(np.float32),
    )
    send_columns(stream, f"{root}/ellipsoid", error.t[rows], columns)


def _write_marker(
    stream, path: str, name: str, error: ErrorSeries, size: np.ndarray, height: float
) -> None:
    """Write a box around the trunk with a forward arrow and, on a flag above, the estimator's name
    and final error.

    Flags differ in height (in trunk widths), since those of estimators that agree would cover each
    other.

    Args:
        stream: rerun's recording.
        path: of the entity.
        name: of the estimator.
        error: its distance from the truth.
        size: (3,) [m], half sizes of the trunk.
        height: of the flag, in trunk widths.
    """
    color, thin = [rgba(estimator_color(name))], [_pixels(1.0)]
    top = [0.0, 0.0, height * 0.5 * size[0]]
    start, nose = [[size[0], 0.0, 0.0]], [[0.5 * size[0], 0.0, 0.0]]
    # A changing label would not be drawn if the view shows a range of times.
    label = f"{name}, {error.distance[-1]:.2f} m at the end"
    parts = {
        "outline": rr.Boxes3D(
            half_sizes=[1.08 * size], colors=color, radii=thin, fill_mode="majorwireframe"
        ),
        "forward": rr.Arrows3D(origins=start, vectors=nose, colors=color, radii=[0.03 * size[0]]),
        "pole": rr.LineStrips3D([[[0.0, 0.0, size[2]], top]], colors=color, radii=thin),
        "flag": _labelled(top, label, color, _pixels(4.0)),
        # Above the trunk, which would hide it from above.
        "dot": rr.Points3D([[0.0, 0.0, 3.0 * size[2]]], colors=color, radii=[_pixels(7.0)]),
    }
    for part, shape in parts.items():
        stream.log(f"{path}/{part}", shape, static=True)


def trunk_size(robot: Robot) -> np.ndarray:
    """Half sizes (3,) m of a box around the trunk, as long and wide as the distances of the
    hips.
    """
    hips = robot.legs.offset[:, 0]
    half = np.abs(hips - hips.mean(axis=0)).mean(axis=0)
    return np.array([1.25 * half[0], max(1.25 * half[1], 0.3 * half[0]), 0.3 * half[0]])


def _trunk_poses(robot: Robot, p_GI: np.ndarray, R_GI: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) [m] and rotations (N, 3, 3) of the trunk in G, from those of the IMU."""
    R_GB = R_GI @ robot.R_BI.T
    return p_GI - R_GB @ robot.p_BI, R_GB


def _labelled(at: list[float], label: str, color: list, radius: Any) -> rr.Points3D:
    """A dot at (3,) [m] with a label that is always shown."""
    return rr.Points3D([at], colors=color, radii=[radius], labels=[label], show_labels=True)


def _write_path(
    stream, root: str, path: tuple[np.ndarray, np.ndarray], color: str, width: float
) -> None:
    """Write a path as one line and again, as a trail, in short pieces, each at its own time, for a
    view of the last seconds.

    Args:
        stream: rerun's recording.
        root: of the entities.
        path: times (N,) [s] and positions (N, 3) [m] in G.
        color: of the lines.
        width: of the line [points].
    """
    t, p = path
    line = rr.LineStrips3D([p], colors=[rgba(color)], radii=[_pixels(width)])
    stream.log(f"{root}/path", line, static=True)
    starts = np.arange(0, len(t) - 1, _PIECE)
    pieces = [p[k : k + _PIECE + 1].astype(np.float32) for k in starts]
    style = rr.LineStrips3D.from_fields(colors=[rgba(color)], radii=[_pixels(1.5)])
    stream.log(f"{root}/trail", style, static=True)
    columns = rr.LineStrips3D.columns(strips=pieces)
    send_columns(stream, f"{root}/trail", t[starts], columns)


def _pixels(size: float) -> Any:
    """A radius in screen points, independent of the distance."""
    return rr.Radius.ui_points(size)


def _send_poses(stream, path: str, t: np.ndarray, p: np.ndarray, R: np.ndarray) -> None:
    """Poses of an entity over time.

    Args:
        stream: rerun's recording.
        path: of the entity.
        t: (N,) [s].
        p: (N, 3) [m], position in the parent's frame.
        R: (N, 3, 3), to the parent's frame.
    """
    columns = rr.Transform3D.columns(
        translation=p.astype(np.float32), quaternion=rerun_quaternion(R).astype(np.float32)
    )
    send_columns(stream, path, t, columns)


def _send_shapes(stream, path: str, model: mujoco.MjModel, body: int) -> None:
    for name, shape in geom_shapes(model, visible_geoms(model, body)):
        stream.log(f"{path}/{name}", shape, static=True)
