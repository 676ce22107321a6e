"""A MuJoCo model as rerun shapes: what each link looks like, and where it is."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import rerun as rr

from surefoot.sim.common.quaternion import matrix_from_quaternion, quaternion_from_matrix

_GEOM = mujoco.mjtGeom
_COLLISION_GROUP = 3  # MuJoCo's viewers hide groups 3 and up
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)
_DEFAULT_COLOR = (96, 104, 114, 255)


@dataclass(frozen=True)
class LinkPose:
    """Pose of one link in its parent link's frame, one row a sample."""

    body: int
    path: str  # the chain of links below the base, "FL_hip/FL_thigh"
    p: np.ndarray  # (N, 3) m, in the parent's frame
    R: np.ndarray  # (N, 3, 3), maps the link's frame to the parent's


def rerun_quaternion(R: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) as quaternions (..., 4) ordered x, y, z, w, as rerun takes them."""
    return quaternion_from_matrix(R)[..., [1, 2, 3, 0]]


def link_poses(
    model: mujoco.MjModel, base: int, joint_ids: np.ndarray, q: np.ndarray
) -> list[LinkPose]:
    """Forward kinematics, by MuJoCo, of every link below body `base`.

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
        p[k] = data.xpos
        R[k] = data.xmat
    R = R.reshape(len(q), model.nbody, 3, 3)
    paths = {base: ""}
    poses = []
    for body in range(base + 1, model.nbody):
        parent = int(model.body_parentid[body])
        if parent not in paths:
            continue
        name = rr.escape_entity_path_part(model.body(body).name or f"link_{body}")
        paths[body] = f"{paths[parent]}/{name}".lstrip("/")
        R_PG = R[:, parent].transpose(0, 2, 1)
        p_PL = np.einsum("nij,nj->ni", R_PG, p[:, body] - p[:, parent])
        poses.append(LinkPose(body, paths[body], p_PL, R_PG @ R[:, body]))
    return poses


def link_shapes(model: mujoco.MjModel, body: int) -> Iterator[tuple[str, rr.AsComponents]]:
    """(entity name, archetype) for the visible geoms of one body, in that body's own frame.

    Geoms that MuJoCo would show (groups 0 to 2) are drawn; a body that has none shows its
    collision geoms instead, so that no link is invisible.
    """
    geoms = np.flatnonzero(model.geom_bodyid == body)
    shown = geoms[model.geom_group[geoms] < _COLLISION_GROUP]
    yield from geom_shapes(model, shown if len(shown) else geoms)


def geom_shapes(
    model: mujoco.MjModel, geoms: np.ndarray, color: tuple[int, int, int, int] | None = None
) -> Iterator[tuple[str, rr.AsComponents]]:
    """(entity name, archetype) for the geoms, in their body's frame; planes are left out."""
    for kind, build in _BUILDERS.items():
        of_kind = geoms[model.geom_type[geoms] == kind]
        if len(of_kind):
            yield kind.name.removeprefix("mjGEOM_").lower(), build(model, of_kind, color)
    for geom in geoms[model.geom_type[geoms] == _GEOM.mjGEOM_MESH]:
        yield f"mesh_{geom}", _mesh(model, int(geom), color)


def _colors(model, geoms, color) -> list[tuple[int, int, int, int]]:
    return [color or _geom_color(model, int(geom)) for geom in geoms]


def _geom_color(model: mujoco.MjModel, geom: int) -> tuple[int, int, int, int]:
    material = int(model.geom_matid[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    if material < 0 and np.array_equal(rgba, _DEFAULT_RGBA):
        return _DEFAULT_COLOR
    r, g, b, a = (round(255 * float(value)) for value in rgba)
    return r, g, b, a


def _placement(model, geoms) -> dict:
    return {
        "centers": model.geom_pos[geoms],
        "quaternions": rerun_quaternion(matrix_from_quaternion(model.geom_quat[geoms])),
        "fill_mode": "solid",
    }


def _boxes(model, geoms, color) -> rr.Boxes3D:
    return rr.Boxes3D(
        half_sizes=model.geom_size[geoms],
        colors=_colors(model, geoms, color),
        **_placement(model, geoms),
    )


def _spheres(model, geoms, color) -> rr.Ellipsoids3D:
    return rr.Ellipsoids3D(
        half_sizes=np.repeat(model.geom_size[geoms, :1], 3, axis=1),
        colors=_colors(model, geoms, color),
        **_placement(model, geoms),
    )


def _ellipsoids(model, geoms, color) -> rr.Ellipsoids3D:
    return rr.Ellipsoids3D(
        half_sizes=model.geom_size[geoms],
        colors=_colors(model, geoms, color),
        **_placement(model, geoms),
    )


def _cylinders(model, geoms, color) -> rr.Cylinders3D:
    return rr.Cylinders3D(
        radii=model.geom_size[geoms, 0],
        lengths=2.0 * model.geom_size[geoms, 1],
        colors=_colors(model, geoms, color),
        **_placement(model, geoms),
    )


def _capsules(model, geoms, color) -> rr.Capsules3D:
    """Rerun's capsule starts at its origin where MuJoCo's is centred on it."""
    placement = _placement(model, geoms)
    axis = matrix_from_quaternion(model.geom_quat[geoms])[:, :, 2]
    half_length = model.geom_size[geoms, 1, None]
    return rr.Capsules3D(
        radii=model.geom_size[geoms, 0],
        lengths=2.0 * model.geom_size[geoms, 1],
        translations=placement["centers"] - half_length * axis,
        quaternions=placement["quaternions"],
        colors=_colors(model, geoms, color),
        fill_mode="solid",
    )


def _mesh(model: mujoco.MjModel, geom: int, color) -> rr.Mesh3D:
    """One mesh, its vertices moved into the body's frame; a vertex for each (position, normal)."""
    mesh = int(model.geom_dataid[geom])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    vertices = model.mesh_face[faces].ravel() + model.mesh_vertadr[mesh]
    normals = model.mesh_facenormal[faces].ravel() + model.mesh_normaladr[mesh]
    # One number for each pair: sorting these takes a tenth of the time of sorting rows.
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


_BUILDERS = {
    _GEOM.mjGEOM_BOX: _boxes,
    _GEOM.mjGEOM_SPHERE: _spheres,
    _GEOM.mjGEOM_ELLIPSOID: _ellipsoids,
    _GEOM.mjGEOM_CYLINDER: _cylinders,
    _GEOM.mjGEOM_CAPSULE: _capsules,
}
