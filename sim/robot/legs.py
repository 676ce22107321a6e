"""Find the legs of a robot in its kinematic tree: chains of hinges that end in a foot.

A foot is a colliding sphere that rolls, the end of another shape where a leg has at most three
hinges, or the flat underside of colliding boxes, meshes and lying rods.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.log.schema import JOINTS, LEGS
from surefoot.sim.robot.kinematics import Legs
from surefoot.sim.robot.limbs import QUADRUPED, Limbs

STANDING = 0.3
"""Largest height of a foot in the model's home pose, relative to the base's; hands and heads are
higher.
"""
SOLE_LEVEL = 0.01
"""Largest height difference of shapes that form a sole together [m]."""
SHORTEST_LINK = 0.01
"""Distance below which hinges form one joint with several axes, without a link between [m]."""
POINT_HINGES = 3
"""Hinges of a leg that can position a point but not level a sole."""
ROUND = 0.1
"""Largest deviation of a wheel from a circle, or from its axle, as a share of its radius."""
_SPHERE, _MESH = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_MESH)
_BOX, _CAPSULE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_CYLINDER, _ELLIPSOID = int(mujoco.mjtGeom.mjGEOM_CYLINDER), int(mujoco.mjtGeom.mjGEOM_ELLIPSOID)
_FLAT, _RODS = (_BOX, _MESH), (_CAPSULE, _CYLINDER)
_FEET = (_SPHERE, *_FLAT, *_RODS, _ELLIPSOID)
_CORNERS = np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, -1).T


@dataclass(frozen=True)
class Foot:
    """What one leg stands on."""

    body: int
    place: np.ndarray  # (3,) m in that body: a sphere's centre, or the middle of a sole
    radius: float = 0.0  # m, zero of flat feet
    reach: float = 0.0  # m, from the place to what may touch the ground
    sole: tuple[float, float] = (0.0, 0.0)
    """Half lengths of a flat sole, fore and aft and sideways [m]; else zero."""
    bottom: float = np.inf  # m, height of its lowest point in the home pose
    rod: bool = False  # of capsules or cylinders, which also serve as shanks and arms


@dataclass(frozen=True)
class LegTree:
    """The legs, and the joints of no leg, of one model, in the order of `limbs`."""

    limbs: Limbs
    base_body: int
    joint_ids: np.ndarray  # (J,)
    feet: tuple[Foot, ...]
    constants: Legs

    @property
    def foot_radius(self) -> np.ndarray:
        """Radius of the feet (L,) [m]; zero of flat ones."""
        return np.array([foot.radius for foot in self.feet])


def find_legs(model: mujoco.MjModel, name: str, feet: Mapping[str, str] | None = None) -> LegTree:
    """Find legs, feet and their constants. Raises SurefootError saying what could not be found.

    Args:
        model: compiled, with one floating base.
        name: of the robot, for messages.
        feet: name of each leg, and of the body or site that is its foot; by default every chain
            that ends in a shape to stand on is a leg, named after its position.
    """
    with errors_in(f"robot {name}"):
        base = _floating_base(model)
        data = posed(model, "home")
        if feet:
            legs, chains, found = _named_legs(data, base, feet)
        else:
            chains, found = _standing_chains(data, base)
            order, legs = _named_by_place(model, base, chains)
            chains, found = [chains[i] for i in order], [found[i] for i in order]
        for chain, foot in zip(chains, found, strict=True):
            _refuse_what_is_no_hinge(model, base, foot.body)
            _refuse_wheel(data, chain[-1])
        joints = [joint for chain in chains for joint in chain]
        if shared := [joint for joint in dict.fromkeys(joints) if joints.count(joint) > 1]:
            raise SurefootError(
                f"legs share hinge {model.joint(shared[0]).name}, which must not be: put "
                "the free joint on the body from which each leg hangs on its own"
            )
        joints += [joint for joint in _hinges(model) if joint not in joints]
        return LegTree(
            limbs=_limbs(model, legs, chains, joints, found),
            base_body=base,
            joint_ids=np.array(joints),
            feet=tuple(found),
            constants=_constants(model, base, chains, found),
        )


def _floating_base(model: mujoco.MjModel) -> int:
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if len(free) != 1:
        raise SurefootError(
            f"expected one free joint, that of the base, found {len(free)}: a robot that walks has "
            "<freejoint/> there in an MJCF; logs of a machine without can be imported and traced"
        )
    return int(model.jnt_bodyid[free[0]])


def posed(model: mujoco.MjModel, keyframe: str = "") -> mujoco.MjData:
    """The poses of all parts in a keyframe or, where there is none, with all joints at zero."""
    data = mujoco.MjData(model)
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, keyframe)
    if key >= 0:
        data.qpos[:] = model.key_qpos[key]
    mujoco.mj_kinematics(model, data)
    return data


def _named_legs(
    data: mujoco.MjData, base: int, feet: Mapping[str, str]
) -> tuple[tuple[str, ...], list[list[int]], list[Foot]]:
    """The legs that a map names, their chains and feet."""
    found = [_named_foot(data, base, foot) for foot in feet.values()]
    chains = [_chain_to(data.model, foot.body, base) for foot in found]
    for leg, chain in zip(feet, chains, strict=True):
        if not chain:
            raise SurefootError(f"no hinge between the base and foot {leg}")
    return tuple(feet), chains, found


def _standing_chains(data: mujoco.MjData, base: int) -> tuple[list[list[int]], list[Foot]]:
    """The chains that end in a foot, and their feet."""
    model = data.model
    chains = [_chain_to(model, int(model.jnt_bodyid[j]), base) for j in _last_hinges(model)]
    feet = [_foot_of(data, base, chain) for chain in chains]
    pairs = [(c, f) for c, f in zip(chains, feet, strict=True) if f is not None]
    sure = [(chain, foot) for chain, foot in pairs if not foot.rod]
    soles = [] if sure else _sole_frames(data)
    if soles:  # a description without shapes
        return [_chain_to(model, foot.body, base) for foot in soles], soles
    if [len(chain) for chain, _ in sure] == [3, 3, 3, 3]:  # a quadruped
        pairs = sure
    elif pairs:
        lowest = min(foot.bottom for _, foot in pairs)
        highest = lowest + STANDING * max(float(data.xpos[base][2]) - lowest, 0.0)
        pairs = [(chain, foot) for chain, foot in pairs if foot.bottom <= max(highest, lowest)]
    if not pairs:
        raise SurefootError(
            f"none of its {len(chains)} chains of hinges ends in a colliding shape for a foot (a "
            "cylinder about the last hinge is a wheel); add a sphere geom at the end of each leg, "
            "or name the feet in the map"
        )
    return [chain for chain, _ in pairs], [foot for _, foot in pairs]


def _last_hinges(model: mujoco.MjModel) -> list[int]:
    """The last hinge of each chain, with no hinge below it."""
    hinges, above = _hinges(model), set[int]()
    for joint in hinges:
        above.update(bodies_up_from(model, model.body_parentid[model.jnt_bodyid[joint]]))
    last = [j for j in hinges if int(model.jnt_bodyid[j]) not in above]
    # Of several hinges on one body, the last is the outermost.
    return [j for j in last if j + 1 not in last or model.jnt_bodyid[j] != model.jnt_bodyid[j + 1]]


def _chain_to(model: mujoco.MjModel, body: int, base: int) -> list[int]:
    """The joints between the base and a body, from the base outwards."""
    chain: list[int] = []
    for link in bodies_up_from(model, body, base):
        chain = [j for j in _joints_of(model, link) if not _is_spring(model, j)] + chain
    return chain


def bodies_up_from(model: mujoco.MjModel, body: int, end: int = 0) -> Iterator[int]:
    """A body, its parent, and so on, up to but without `end` or the world."""
    while body not in (0, end):
        yield int(body)
        body = model.body_parentid[body]


def _joints_of(model: mujoco.MjModel, body: int) -> range:
    """The joints that move a body."""
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def _refuse_what_is_no_hinge(model: mujoco.MjModel, base: int, foot: int) -> None:
    """Raise SurefootError if hinges alone do not determine the position of a foot.

    That is the case for a slide without a spring, a ball joint, or a loop closed by a constraint.

    Args:
        model: compiled.
        base: the floating body.
        foot: the body that carries the foot.
    """
    link = set(bodies_up_from(model, foot, base))
    for joint in np.flatnonzero(np.isin(model.jnt_bodyid, list(link))).tolist():
        kind, called = model.jnt_type[joint], model.joint(joint).name
        slides = kind == mujoco.mjtJoint.mjJNT_SLIDE and model.jnt_stiffness[joint] == 0.0
        if slides or kind == mujoco.mjtJoint.mjJNT_BALL:
            what = "slides" if slides else "is a ball joint"
            raise SurefootError(f"joint {called} of a leg {what}: legs are of hinges")
    closes = np.isin(model.eq_type, (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD))
    for loop in np.flatnonzero(closes):
        ends = [int(model.eq_obj1id[loop]), int(model.eq_obj2id[loop])]
        if model.eq_objtype[loop] == mujoco.mjtObj.mjOBJ_SITE:
            ends = [int(model.site_bodyid[site]) for site in ends]
        if link & set(ends):
            raise SurefootError(
                f"a leg is a closed loop (constraint on {model.body(ends[0]).name}), whose "
                "feet hinges alone do not place; a log with foot positions does without them"
            )


def _refuse_wheel(data: mujoco.MjData, hinge: int) -> None:
    """Raise SurefootError where a round mesh turns about the last hinge of a leg, in the home
    pose.
    """
    model = data.model
    axle, link = data.xaxis[hinge], int(model.jnt_bodyid[hinge])
    of_link = (model.geom_bodyid == link) & (model.geom_type == _MESH)
    for geom in np.flatnonzero(of_link & _collides(model)).tolist():
        along = np.abs(data.geom_xmat[geom].reshape(3, 3).T @ axle)
        across = np.delete(model.geom_aabb[geom, 3:], np.argmax(along))
        off = np.linalg.norm(np.cross(axle, data.geom_xpos[geom] - data.xanchor[hinge]))
        oval = max(float(np.ptp(across)), float(off))
        if along.max() > 0.95 and oval < ROUND * across.max():
            raise SurefootError(
                f"joint {model.joint(hinge).name} of a leg is the axle of a wheel: legs end "
                "in feet; a log with foot positions does without them"
            )


def _is_spring(model: mujoco.MjModel, joint: int) -> bool:
    """Whether a joint is a spring: a slide, or a second hinge about the same axis on its body."""
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
        return True
    same = joint > 0 and model.jnt_bodyid[joint - 1] == model.jnt_bodyid[joint]
    return bool(same and np.array_equal(model.jnt_axis[joint - 1], model.jnt_axis[joint]))


def _hinges(model: mujoco.MjModel) -> list[int]:
    """The hinges that are not springs."""
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE).tolist()
    return [joint for joint in hinges if not _is_spring(model, joint)]


def _foot_of(data: mujoco.MjData, base: int, chain: list[int]) -> Foot | None:
    """The foot on the last link of a chain; None if it has no shape to stand on.

    In legs that position a point, the shape that reaches farthest from the last hinge. In others,
    the sphere farthest from it, unless flat shapes or other spheres reach as low; then the
    underside of all of these. Without spheres and flat shapes, that of lying rods, else the end of
    a capsule.
    """
    model, link = data.model, int(data.model.jnt_bodyid[chain[-1]])
    solid = np.flatnonzero(_collides(model)).tolist()
    shapes = [g for g in solid if _is_fixed_to(model, model.geom_bodyid[g], link)]
    if len(chain) <= POINT_HINGES:
        return _point_foot(data, base, chain, shapes)
    spheres = [g for g in shapes if model.geom_type[g] == _SPHERE]
    flat = [g for g in shapes if model.geom_type[g] in _FLAT]
    rods = [g for g in shapes if model.geom_type[g] in _RODS]
    if spheres:
        hinge = data.xanchor[chain[-1]]
        lowest = {g: float(outline_G(data, g)[:, 2].min()) for g in spheres + flat}
        ball = max(spheres, key=lambda g: float(np.linalg.norm(data.geom_xpos[g] - hinge)))
        if all(lowest[g] >= lowest[ball] + SOLE_LEVEL for g in lowest if g != ball):
            return _sphere_foot(data, ball)
    if spheres or flat:
        return _sole(data, base, spheres + flat)
    lying = [g for g in rods if abs(data.geom_xmat[g, 8]) < 0.5 and not _is_about(data, g, chain)]
    if lying:
        return replace(_sole(data, base, lying), rod=True)
    capsules = [g for g in rods if model.geom_type[g] == _CAPSULE]
    return _point_foot(data, base, chain, capsules)


def _point_foot(data: mujoco.MjData, base: int, chain: list[int], shapes: list[int]) -> Foot | None:
    """The shape that reaches farthest from the last hinge, a sphere before others that reach about
    as far: as a ball in its end, or the underside of boxes. None without shapes.

    A cylinder on a hinge's axis may be a wheel, and is no foot.

    shapes: all that collide on its last link.
    """
    model = data.model
    hinge, axle = data.xanchor[chain[-1]], data.xaxis[chain[-1]]
    reach = {}
    for g in shapes:
        kind = model.geom_type[g]
        if kind in _FEET and not (kind == _CYLINDER and _is_about(data, g, chain)):
            outline = outline_G(data, g)
            reach[g] = float(np.linalg.norm(outline - hinge, axis=1).max())
    if not reach:
        return None
    last = max(reach, key=lambda g: reach[g])
    spheres = [g for g in reach if model.geom_type[g] == _SPHERE]
    ball = max(spheres, key=lambda g: float(np.linalg.norm(data.geom_xpos[g] - hinge)), default=-1)
    if spheres and reach[ball] > reach[last] - SOLE_LEVEL:
        return _sphere_foot(data, ball)
    if model.geom_type[last] == _BOX:
        return _sole(data, base, [g for g in reach if model.geom_type[g] in _FLAT])
    outline = outline_G(data, last) - hinge
    if model.geom_type[last] == _MESH:
        centre, radius = _tip(outline, axle)
    else:
        centre, radius = _round_end(data, last, hinge)
    body = int(model.geom_bodyid[last])
    place = data.xmat[body].reshape(3, 3).T @ (hinge + centre - data.xpos[body])
    along = centre / np.linalg.norm(centre)
    wide = float(np.linalg.norm(outline - np.outer(outline @ along, along), axis=1).max())
    bottom = float(hinge[2] + centre[2]) - radius
    rod = model.geom_type[last] != _MESH
    return Foot(body, place, radius, float(np.hypot(radius, wide)), bottom=bottom, rod=rod)


def _sphere_foot(data: mujoco.MjData, geom: int) -> Foot:
    model = data.model
    place, radius = model.geom_pos[geom].copy(), float(model.geom_size[geom, 0])
    bottom = float(data.geom_xpos[geom, 2]) - radius
    return Foot(int(model.geom_bodyid[geom]), place, radius, radius, bottom=bottom)


def _round_end(data: mujoco.MjData, geom: int, hinge: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) relative to a hinge and radius of a ball [m]: that in the end of a rod which is
    farther from the hinge, or that about an ellipsoid's centre which touches its lowest point.

    hinge: (3,) m in G.
    """
    model = data.model
    centre, axes_G = data.geom_xpos[geom] - hinge, data.geom_xmat[geom].reshape(3, 3)
    if model.geom_type[geom] == _ELLIPSOID:
        return centre, float(np.linalg.norm(axes_G[2] * model.geom_size[geom]))
    radius, half = model.geom_size[geom, :2].tolist()
    if model.geom_type[geom] == _CYLINDER:  # within its flat end
        radius = min(radius, half)
        half -= radius
    ends = centre - half * axes_G[:, 2], centre + half * axes_G[:, 2]
    return max(ends, key=lambda end: float(np.linalg.norm(end))), radius


def _is_about(data: mujoco.MjData, rod: int, chain: list[int]) -> bool:
    """Whether a rod's middle is on the axis of the last hinge, like that of a wheel or motor."""
    off = np.cross(data.xaxis[chain[-1]], data.geom_xpos[rod] - data.xanchor[chain[-1]])
    return float(np.linalg.norm(off)) < SHORTEST_LINK


def _tip(points: np.ndarray, axle: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) [m] and radius [m] of the ball in the end of a shape that turns about an axle.

    The ball is as wide in the plane of the leg as the part of the shape that is no farther from its
    end than the radius.

    Args:
        points: of the shape (N, 3) [m], relative to the axle.
        axle: unit vector (3,).
    """
    swung = points - np.outer(points @ axle, axle)
    along = swung[np.argmax(np.linalg.norm(swung, axis=1))]
    along, radius = along / np.linalg.norm(along), np.inf
    centre = points.mean(axis=0)
    for _ in range(100):
        across = np.cross(axle, along)
        reach = points @ along
        end = points[reach >= reach.max() - 1.01 * radius]
        middle = 0.5 * (end.min(axis=0) + end.max(axis=0))
        low, high = (end @ across).min(), (end @ across).max()
        before, radius = radius, min(radius, 0.5 * float(high - low))
        in_plane = (reach.max() - radius) * along + 0.5 * (low + high) * across
        centre = in_plane + (middle @ axle) * axle
        if radius > 0.999 * before:
            break
        along = in_plane / np.linalg.norm(in_plane)
    return centre, radius


def _sole(data: mujoco.MjData, base: int, shapes: list[int]) -> Foot:
    """The underside of the lowest of some shapes of one link: that of their bounding box along the
    very lowest's axes.
    """
    outlines_G = {g: outline_G(data, g) for g in shapes}
    lowest = {g: float(points_G[:, 2].min()) for g, points_G in outlines_G.items()}
    first = min(shapes, key=lambda g: lowest[g])
    level = lowest[first] + SOLE_LEVEL
    points_G = np.concatenate([outlines_G[g] for g in shapes if lowest[g] < level])
    axes_G = _axes_G(data, first)
    down = int(np.argmax(np.abs(axes_G[2])))
    along = points_G @ axes_G
    low, high = along.min(axis=0), along.max(axis=0)
    middle = 0.5 * (low + high)
    middle[down] = low[down] if axes_G[2, down] > 0 else high[down]
    forward_G = data.xmat[base].reshape(3, 3)[:, 0]
    sides = [a for a in range(3) if a != down]
    sides.sort(key=lambda a: -abs(float(axes_G[:, a] @ forward_G)))
    half = 0.5 * (high - low)[sides]
    body = int(data.model.geom_bodyid[first])
    place = data.xmat[body].reshape(3, 3).T @ (axes_G @ middle - data.xpos[body])
    reach, bottom = float(np.linalg.norm(half)), float(points_G[:, 2].min())
    return Foot(body, place, 0.0, reach, (float(half[0]), float(half[1])), bottom)


def _named_foot(data: mujoco.MjData, base: int, named: str) -> Foot:
    """The foot that a map names: a site's position, a body's shapes, or a bare body's origin."""
    model = data.model
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, named)
    if site >= 0:
        return Foot(int(model.site_bodyid[site]), model.site_pos[site].copy())
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, named)
    if body < 0:
        raise SurefootError(f"has no body or site '{named}' for a foot")
    chain = _chain_to(model, body, base)
    ends = chain and _is_fixed_to(model, body, int(model.jnt_bodyid[chain[-1]]))
    shaped = _foot_of(data, base, chain) if ends else None
    return shaped if shaped and shaped.body == body else Foot(body, np.zeros(3))


def _sole_frames(data: mujoco.MjData) -> list[Foot]:
    """Bodies named as a sole, such as `l_sole`, as in descriptions of humanoids."""
    bodies = (data.body(b) for b in range(data.model.nbody))
    soles = [body for body in bodies if body.name.lower().endswith("_sole")]
    return [Foot(body.id, np.zeros(3), bottom=float(body.xpos[2])) for body in soles]


def _is_fixed_to(model: mujoco.MjModel, body: int, link: int) -> bool:
    """Whether a body is this link, or attached to it without joints other than springs."""
    while body > link:
        if not all(_is_spring(model, joint) for joint in _joints_of(model, body)):
            return False
        body = int(model.body_parentid[body])
    return int(body) == link


def _collides(model: mujoco.MjModel) -> np.ndarray:
    """Whether each shape (G,) collides, in general or as one of a pair.

    If none does, as in a robot whose scenes declare its contacts: whether it is not a mesh.
    """
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    collides[model.pair_geom1] = collides[model.pair_geom2] = True
    return collides if collides.any() else model.geom_type != _MESH


def outline_G(data: mujoco.MjData, geom: int) -> np.ndarray:
    """Vertices (N, 3) [m] in G of a mesh, or corners of another shape's bounding box."""
    model = data.model
    if model.geom_type[geom] == _MESH:
        mesh = model.mesh(int(model.geom_dataid[geom]))
        first, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
        points = model.mesh_vert[first : first + count].astype(float)
        return data.geom_xpos[geom] + points @ data.geom_xmat[geom].reshape(3, 3).T
    middle, half = np.split(model.geom_aabb[geom], 2)
    if model.geom_type[geom] == _SPHERE:  # as low however it is turned
        return data.geom_xpos[geom] + half * _CORNERS
    return data.geom_xpos[geom] + (middle + half * _CORNERS) @ _axes_G(data, geom).T


def _axes_G(data: mujoco.MjData, geom: int) -> np.ndarray:
    """Axes (3, 3) of a shape, in columns, in G; of a rod, which is round, with one horizontal."""
    axes_G = data.geom_xmat[geom].reshape(3, 3)
    if data.model.geom_type[geom] not in _RODS:
        return axes_G
    rod = axes_G[:, 2]
    side = np.cross([0.0, 0.0, 1.0], rod)
    if (length := float(np.linalg.norm(side))) < 1e-9:
        return axes_G
    side /= length
    return np.column_stack([side, np.cross(rod, side), rod])


def _named_by_place(
    model: mujoco.MjModel, base: int, chains: list[list[int]]
) -> tuple[list[int], tuple[str, ...]]:
    """Order and names of the legs, by the position of their second hinge.

    Four are FL, FR, RL, RR, two left, right; others are named after their first body.
    """
    data = posed(model)
    R = data.xmat[base].reshape(3, 3)
    hips = [data.xanchor[chain[min(1, len(chain) - 1)]] for chain in chains]
    places = np.array([R.T @ (hip - data.xpos[base]) for hip in hips])
    centred = places - places.mean(axis=0)
    if len(chains) == 2 and (sides := _two_sides(model, chains, centred[:, 1])):
        return sides, ("left", "right")
    if len(chains) != 4:
        firsts = [model.body(int(model.jnt_bodyid[chain[0]])).name for chain in chains]
        return list(range(len(chains))), tuple(firsts)
    ordered = []
    for front, left in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        match = np.flatnonzero((front * centred[:, 0] > 0) & (left * centred[:, 1] > 0))
        if len(match) != 1:
            raise SurefootError(
                "cannot distinguish front, rear, left and right legs; the base's x axis must "
                "point forward and y left"
            )
        ordered.append(int(match[0]))
    return ordered, LEGS


def _two_sides(model: mujoco.MjModel, chains: list[list[int]], y: np.ndarray) -> list[int]:
    """The left and the right leg, by the names of their joints, since not every base's x axis
    points forward, else by position; empty if neither is conclusive.
    """
    marks = []
    for chain in chains:
        words = {w for j in chain for w in model.joint(j).name.lower().split("_")}
        marks.append((bool(words & {"left", "l"}), bool(words & {"right", "r"})))
    if marks in ([(True, False), (False, True)], [(False, True), (True, False)]):
        return [0, 1] if marks[0][0] else [1, 0]
    if abs(y[0] - y[1]) < SHORTEST_LINK:
        return []
    return [0, 1] if y[0] > y[1] else [1, 0]


def _limbs(
    model: mujoco.MjModel,
    legs: tuple[str, ...],
    chains: list[list[int]],
    joints: list[int],
    feet: list[Foot],
) -> Limbs:
    """Names and order of the joints: canonical for four legs of three hinges, else the model's.

    Args:
        model: compiled.
        legs: their names.
        chains: MuJoCo's joints of each leg.
        joints: all of the robot's, those of the legs first.
        feet: of the legs.
    """
    names, data = [model.joint(j).name for j in joints], posed(model)
    if legs == LEGS and all(len(chain) == 3 for chain in chains):
        names[:12] = JOINTS
        if len(joints) == 12:
            return QUADRUPED
    at = {joint: i for i, joint in enumerate(joints)}
    links = []
    for chain, foot in zip(chains, feet, strict=True):
        end = data.xpos[foot.body] + data.xmat[foot.body].reshape(3, 3) @ foot.place
        points = [*data.xanchor[chain[1:]], end]
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        for joint, length in zip(chain[1:], lengths, strict=True):
            if length > SHORTEST_LINK:
                links.append(names[at[joint]])
    chained = tuple(tuple(at[j] for j in chain) for chain in chains)
    return Limbs(legs, tuple(names), chained, tuple(links))


def _constants(model: mujoco.MjModel, base: int, chains: list[list[int]], feet: list[Foot]) -> Legs:
    count, most = len(chains), max(len(chain) for chain in chains)
    offset, rotation = np.zeros((count, most, 3)), np.zeros((count, most, 3, 3))
    axis, anchor = np.zeros((count, most, 3)), np.zeros((count, most, 3))
    q_zero, foot = np.zeros((count, most)), np.zeros((count, 3))
    joints, first = np.zeros((count, most), np.int64), 0
    for leg, chain in enumerate(chains):
        previous = base
        for j, joint in enumerate(chain):
            body = int(model.jnt_bodyid[joint])
            rotation[leg, j], offset[leg, j] = _between(model, previous, body)
            axis[leg, j], anchor[leg, j] = model.jnt_axis[joint], model.jnt_pos[joint]
            q_zero[leg, j] = model.qpos0[model.jnt_qposadr[joint]]
            joints[leg, j] = first + j
            previous = body
        first += len(chain)
        R, p = _between(model, previous, feet[leg].body)
        foot[leg] = p + R @ feet[leg].place
    lengths = np.array([len(chain) for chain in chains])
    return Legs(offset, rotation, axis, anchor, q_zero, foot, joints, lengths)


def _between(model: mujoco.MjModel, ancestor: int, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Pose of `body` in the frame of `ancestor` with every joint between at zero."""
    R, p = np.eye(3), np.zeros(3)
    for link in bodies_up_from(model, body, ancestor):
        R_step = np.empty(9)
        mujoco.mju_quat2Mat(R_step, model.body_quat[link])
        R_step = R_step.reshape(3, 3)
        p = model.body_pos[link] + R_step @ p
        R = R_step @ R
    return R, p
