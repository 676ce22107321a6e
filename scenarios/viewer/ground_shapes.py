"""The ground of a recording: every tile, step, slope and bump, coloured by its friction."""

from dataclasses import replace

import mujoco
import numpy as np
import rerun as rr

from surefoot.scenarios.reporting.palette import friction_color, rgba
from surefoot.scenarios.viewer.robot_shapes import geom_shapes
from surefoot.sim.common.quaternion import matrix_from_quaternion
from surefoot.sim.ground.height_map import height
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.ground.tiles import add_ground

_MARGIN = 2.0  # m of floor around the walk


def write_ground(
    stream: rr.RecordingStream, corners: tuple[np.ndarray, np.ndarray], ground: Ground
) -> None:
    """The ground at /world/ground/friction_<mu>/..., and a label on each patch.

    Args:
        stream: the recording.
        corners: lower and upper (3,) corner of the walk, m; the floor ends a little beyond it.
        ground: as it was walked on, after its seed drew patches and bumps.
    """
    reach = float(np.abs(np.concatenate([c[:2] for c in corners])).max())
    strips = [abs(edge) for strip in ground.strips for edge in strip.rectangle]
    half = min(ground.half_size, max(reach, *strips, 0.0) + _MARGIN)
    model = _tiles(replace(ground, half_size=half))
    frictions = np.round(model.geom_friction[:, 0], 2)
    for mu in np.unique(frictions):
        alike = np.flatnonzero(frictions == mu)
        root, color = f"world/ground/friction_{mu:.2f}", rgba(friction_color(mu))
        for name, shape in geom_shapes(model, alike, color):
            stream.log(f"{root}/{name}", shape, static=True)
        for geom in alike[model.geom_type[alike] == mujoco.mjtGeom.mjGEOM_HFIELD]:
            stream.log(f"{root}/field_{geom}", _field(model, int(geom), color), static=True)
    for k, patch in enumerate(ground.patches):
        above = height(ground.relief, patch.center_x, patch.center_y) + 0.02
        label = rr.Points3D(
            [[patch.center_x, patch.center_y, above]],
            colors=[rgba(friction_color(patch.mu))],
            radii=[0.02],
            labels=[f"friction {patch.mu:.2f}"],
            show_labels=True,
        )
        stream.log(f"world/ground/patch_{k}", label, static=True)


def _tiles(ground: Ground) -> mujoco.MjModel:
    """The very tiles that the walk's world has, without a robot."""
    spec = mujoco.MjSpec()
    add_ground(spec, ground)
    return spec.compile()


def _field(model: mujoco.MjModel, geom: int, color: tuple[int, int, int, int]) -> rr.Mesh3D:
    """A height field as a mesh: two triangles a cell, cut as MuJoCo cuts them."""
    field = int(model.geom_dataid[geom])
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    size_x, size_y, size_z, _ = model.hfield_size[field]
    start = int(model.hfield_adr[field])
    z = size_z * model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    x, y = np.meshgrid(np.linspace(-size_x, size_x, columns), np.linspace(-size_y, size_y, rows))
    slope_y, slope_x = np.gradient(z, y[:, 0], x[0])
    normals = np.stack([-slope_x, -slope_y, np.ones_like(z)], axis=-1).reshape(-1, 3)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, above, across = corner + 1, corner + columns, corner + columns + 1
    triangles = np.concatenate(
        [np.stack([corner, right, across], axis=1), np.stack([corner, across, above], axis=1)]
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    R = matrix_from_quaternion(model.geom_quat[geom])
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3) @ R.T + model.geom_pos[geom]
    return rr.Mesh3D(
        vertex_positions=vertices.astype(np.float32),
        vertex_normals=(normals @ R.T).astype(np.float32),
        triangle_indices=triangles,
        albedo_factor=color,
    )
