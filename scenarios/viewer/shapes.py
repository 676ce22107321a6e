"""Conversion of a MuJoCo model to rerun shapes: geoms, meshes and height fields, and link poses."""

from collections.abc import Callable, Iterator
from typing import Any, Literal

import mujoco
import numpy as np
import rerun as rr

from surefoot.sim.common.quaternion import matrix_from_quaternion, quaternion_from_matrix

_GEOM = mujoco.mjtGeom
_Sizes = Callable[[np.ndarray], dict[str, Any]]
_PRIMITIVES: dict[mujoco.mjtGeom, tuple[Any, _Sizes]] = {
    _GEOM.mjGEOM_BOX: (rr.Boxes3D, lambda s: {"half_sizes": s}),
    _GEOM.mjGEOM_SPHERE: (rr.Ellipsoids3D, lambda s: {"half_sizes": s[:, [0, 0, 0]]}),
    _GEOM.mjGEOM_ELLIPSOID: (rr.Ellipsoids3D, lambda s: {"half_sizes": s}),
    _GEOM.mjGEOM_CYLINDER: (rr.Cylinders3D, lambda s: {"radii": s[:, 0], "lengths": 2.0 * s[:, 1]}),
    _GEOM.mjGEOM_CAPSULE: (rr.Capsules3D, lambda s: {"radii": s[:, 0], "lengths": 2.0 * s[:, 1]}),
}
"""Kinds of geom: rerun's archetype, and its sizes from those of the geoms (n, 3)."""
_COLLISION_GROUP = 3  # MuJoCo's viewers hide groups 3 and up
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)
_DEFAULT_COLOR = (96, 104, 114, 255)


def rerun_quaternion(R: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) as quaternions (..., 4) ordered x, y, z, w, as rerun takes them."""
    return quaternion_from_matrix(R)[..., [1, 2, 3, 0]]


def link_poses(
    model: mujoco.MjModel, base: int, joint_ids: np.ndarray, q: np.ndarray
) -> Iterator[tuple[int, str, np.ndarray, np.ndarray]]:
    """Forward kinematics, by MuJoCo, of every link below body `base`: its body, its path, which is
    the chain of links below the base ("FL_hip/FL_thigh"), and in its parent's frame its positions
    (N, 3) [m] and rotations (N, 3, 3).

    Args:
        model: the compiled robot.
        base: id of the body that carries the base frame B.
        joint_ids: (J,) MuJoCo joint of each column of q.
        q: (N, J) joint angles in rad (or m).
    """
    data = mujoco.MjData(model)
    address = model.jnt_qposadr[joint_ids]
    p = np.empty((len(q), model.nbody, 3))
    R = np.empty((len(q), model.nbody, 9))
    for k, row in enumerate(q):
        data.qpos[address] = row
        mujoco.mj_kinematics(model, data)
        p[k], R[k] = data.xpos, data.xmat
    R = R.reshape(len(q), model.nbody, 3, 3)
    paths = {base: ""}
    for body in range(base + 1, model.nbody):
        parent = int(model.body_parentid[body])
        if parent not in paths:
            continue
        name = rr.escape_entity_path_part(model.body(body).name or f"link_{body}")
        paths[body] = f"{paths[parent]}/{name}".lstrip("/")
        R_PG = R[:, parent].transpose(0, 2, 1)
        p_PL = np.einsum("nij,nj->ni", R_PG, p[:, body] - p[:, parent])
        yield body, paths[body], p_PL, R_PG @ R[:, body]


def visible_geoms(model: mujoco.MjModel, body: int) -> np.ndarray:
    """The geoms of a body that MuJoCo would show (groups 0 to 2) or, where there are none, its
    collision geoms, so that no link is invisible.
    """
    geoms = np.flatnonzero(model.geom_bodyid == body)
    shown = geoms[model.geom_group[geoms] < _COLLISION_GROUP]
    return shown if len(shown) else geoms


def geom_shapes(
    model: mujoco.MjModel,
    geoms: np.ndarray,
    color: tuple[int, int, int, int] | None = None,
    fill: Literal["solid", "majorwireframe"] = "solid",
) -> Iterator[tuple[str, rr.AsComponents]]:
    """(entity name, archetype) for the geoms, in their body's frame; planes are omitted."""
    for kind, (archetype, sizes) in _PRIMITIVES.items():
        mine = geoms[model.geom_type[geoms] == kind]
        if len(mine):
            name = kind.name.removeprefix("mjGEOM_").lower()
            place, R = model.geom_pos[mine], matrix_from_quaternion(model.geom_quat[mine])
            centre = "centers"
            if archetype is rr.Capsules3D:
                # Rerun's capsule starts at its origin, while MuJoCo's is centred on it.
                centre, place = "translations", place - model.geom_size[mine, 1, None] * R[:, :, 2]
            shape = archetype(
                **sizes(model.geom_size[mine]),
                **{centre: place},
                quaternions=rerun_quaternion(R),
                colors=[color or _geom_color(model, int(geom)) for geom in mine],
                fill_mode=fill,
            )
            yield name, shape
    for geom in geoms[model.geom_type[geoms] == _GEOM.mjGEOM_MESH]:
        yield f"mesh_{geom}", _mesh(model, int(geom), color)


def _geom_color(model: mujoco.MjModel, geom: int) -> tuple[int, int, int, int]:
    material = int(model.geom_matid[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    if material < 0 and np.array_equal(rgba, _DEFAULT_RGBA):
        return _DEFAULT_COLOR
    r, g, b, a = (round(255 * float(value)) for value in rgba)
    return r, g, b, a


def _mesh(model: mujoco.MjModel, geom: int, color) -> rr.Mesh3D:
    """One mesh with its vertices in the body's frame; one vertex for each (position, normal)."""
    mesh = int(model.geom_dataid[geom])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    vertices = model.mesh_face[faces].ravel() + model.mesh_vertadr[mesh]
    normals = model.mesh_facenormal[faces].ravel() + model.mesh_normaladr[mesh]
    # One number for each pair, since sorting these takes a tenth of the time of sorting rows.
    pairs = vertices.astype(np.int64) * len(model.mesh_normal) + normals
    unique, triangles = np.unique(pairs, return_inverse=True)
    vertices, normals = np.divmod(unique, len(model.mesh_normal))
    R = matrix_from_quaternion(model.geom_quat[geom])
    return rr.Mesh3D(
        vertex_positions=model.mesh_vert[vertices] @ R.T + model.geom_pos[geom],
        vertex_normals=model.mesh_normal[normals] @ R.T,
        triangle_indices=triangles.reshape(-1, 3),
        albedo_factor=color or _geom_color(model, geom),
    )


def height_field(model: mujoco.MjModel, geom: int, color: tuple[int, int, int, int]) -> rr.Mesh3D:
    """A height field as a mesh: two triangles per cell, divided as in MuJoCo."""
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
