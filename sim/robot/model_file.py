"""Read a robot's model: MJCF without visuals whose files are missing, URDF with a floating base and
without its meshes.
"""

import re
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.robot.legs import posed
from surefoot.sim.robot.model_gate import check_compiled, check_model_file

# Otherwise MuJoCo writes MUJOCO_LOG.TXT to the working directory; unstable walks are reported
# anyway.
mujoco.set_mju_user_warning(lambda message: None)

_NO_MASS, _NO_INERTIA = 1e-6, 1e-12
"""Mass [kg] and moment of inertia [kg m^2] below which a URDF's link is only a frame, such as a
sensor's: those of a milligram of 1 mm in size. MuJoCo refuses such moments.
"""
_LEAST_MASS, _LEAST_INERTIA = 1e-6, 1e-10
"""Mass [kg] and moment of inertia [kg m^2] of a URDF's link that turns on a joint but has neither,
such as the middle of a universal joint: a milligram of 1 cm in size.
"""
_POINT_FOOT = 1e-3
"""Radius of a foot whose shape is a mesh of a URDF [m]."""
_IMU_LINK = re.compile(r"(base_|trunk_|body_|pelvis_)?imu(_link|_frame|_sensor)?")
"""Names, in lower case, of a URDF's link that carries the IMU."""
_FREE, _HINGE = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_HINGE


def read_model(file: Path) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """A new MjSpec of an MJCF or URDF file, and how it differs from the file, in words.

    Raises SurefootError in one clear line.

    MuJoCo welds the root link of a URDF to the world and omits its mass; here it floats, unless it
    is called `world`, which the file need not declare. Links that are fixed to others remain
    separate bodies, so that a sole or a sensor's frame is found by its name. Textures, and meshes
    that neither collide nor have mass, are left out of an MJCF where their files are missing.
    Moments of inertia of a URDF that no body can have, and links that turn but have no mass, are
    corrected, since other readers of URDF accept them. A foot that is a mesh, at the end of a leg
    of at most three joints, is taken for a point at the origin of its link. Bodies and joints of an
    MJCF without a name are numbered, and what else is in its scene is left out. Parts of the robot
    do not collide with each other. A link that is fixed to the base and named as an IMU, such as
    `imu_link`, becomes the site of the IMU.
    """
    check_model_file(file)
    try:
        if file.suffix == ".urdf":
            return _urdf_spec(file)
        spec = mujoco.MjSpec.from_file(str(file))
        changes = _leave_out_visuals(spec, file.parent) + name_parts(spec)
        return spec, changes + leave_out_surroundings(spec)
    except SurefootError as error:
        raise SurefootError(f"robot {file}: {error}") from None
    except (ValueError, OSError, RuntimeError, ElementTree.ParseError, mujoco.FatalError) as error:
        raise _unreadable(file, error) from None


def compiled_model(file: Path) -> mujoco.MjModel:
    """The compiled model of an MJCF or URDF file. Raises SurefootError in one clear line."""
    spec, _ = read_model(file)
    try:
        model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError, MemoryError) as error:
        raise _unreadable(file, error) from None
    check_compiled(file, model)
    return model


def _leave_out_visuals(spec: mujoco.MjSpec, folder: Path) -> tuple[str, ...]:
    """Remove the visuals whose files are missing; returns the change in words, if there is one.

    Args:
        spec: of the model.
        folder: that paths in the model are relative to.
    """
    left_out = []
    for texture in list(spec.textures):
        if texture.file and not (folder / spec.compiler.texturedir / texture.file).is_file():
            left_out.append(texture.file)
            for material in spec.materials:
                material.textures = ["" if n == texture.name else n for n in material.textures]
            spec.delete(texture)
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    for mesh in list(spec.meshes):
        if not mesh.file or (folder / spec.compiler.meshdir / mesh.file).is_file():
            continue
        users = [geom for geom in spec.geoms if geom.meshname == mesh.name]
        if not any(_has_effect(geom, spec) or geom.name in paired for geom in users):
            left_out.append(mesh.file)
            for geom in users:
                spec.delete(geom)
            spec.delete(mesh)
    without = f"visuals left out, as their files are missing: {', '.join(left_out)}"
    return (without,) if left_out else ()


def _has_effect(geom: mujoco.MjsGeom, spec: mujoco.MjSpec) -> bool:
    """Whether a shape collides or adds to its body's inertia."""
    from_shapes = {
        mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE: True,
        mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE: False,
    }.get(spec.compiler.inertiafromgeom, not geom.parent.explicitinertial)
    massless = geom.mass == 0.0 or (np.isnan(geom.mass) and geom.density == 0.0)
    return bool(geom.contype or geom.conaffinity or (from_shapes and not massless))


def _unreadable(file: Path, error: Exception) -> SurefootError:
    reason = "; ".join(str(error).strip().splitlines()[:2]) or type(error).__name__
    return SurefootError(f"robot {file}: MuJoCo cannot read it: {reason}")


def _urdf_spec(file: Path) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """The MjSpec of a URDF with a floating root, and the corrections of its inertias, in words."""
    robot = ElementTree.parse(file).getroot()
    shapes = {
        link.get("name", ""): {shape.tag for shape in link.findall("collision/geometry/*")}
        for link in robot.findall("link")
    }
    spec = mujoco.MjSpec.from_string(_floating(robot))
    links = spec.bodies[1:]
    if any(link.mass < 0.0 for link in links):  # which a lower bound of masses would hide
        raise ValueError("a mass is below zero")
    weighed = [link for link in links if link.explicitinertial]
    feet = [link for link in links if shapes.get(link.name) == {"mesh"} and _is_a_foot(link)]
    for foot in feet:
        foot.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[_POINT_FOOT, 0, 0])
    said = {
        "a moment of inertia is zero, below zero or above the sum of the others, which no body "
        "has; the nearest that one can have is taken for ": list(filter(_mend, weighed)),
        "without <inertial>, these links have no mass: ": [
            link
            for link in links
            if weighed and not link.explicitinertial and shapes.get(link.name, set()) - {"mesh"}
        ],
        "meshes of a URDF are not read: feet are points at ": feet,
    }
    changes = [f"{what}{', '.join(link.name for link in of)}" for what, of in said.items() if of]
    try:
        model = spec.copy().compile()
    except ValueError as error:
        if "mass and inertia of moving bodies" not in str(error):
            raise
        spec.compiler.boundmass, spec.compiler.boundinertia = _LEAST_MASS, _LEAST_INERTIA
        changes.append(
            "links that move without a mass or a moment of inertia were given the least that is "
            "possible, those of a milligram of 1 cm in size"
        )
        model = spec.copy().compile()
    for geom in spec.geoms:
        # Parts of a robot are often drawn into each other, and do not collide in Gazebo either.
        geom.contype = 0
    _mark_imu(spec, model)
    return spec, tuple(changes)


def _mark_imu(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Place a site named imu on the floating base where a link fixed to it is named as an IMU."""
    data = posed(model)
    for link in range(1, model.nbody):
        base = int(model.body_weldid[link])
        free = base and model.jnt_type[model.body_jntadr[base]] == _FREE
        if free and _IMU_LINK.fullmatch(model.body(link).name.lower()):
            p, quat = np.empty(3), np.empty(4)
            mujoco.mju_negPose(p, quat, data.xpos[base], data.xquat[base])
            mujoco.mju_mulPose(p, quat, p.copy(), quat.copy(), data.xpos[link], data.xquat[link])
            spec.body(model.body(base).name).add_site(name="imu", pos=p, quat=quat)
            return


def _mend(link: mujoco.MjsBody) -> bool:
    """Change an inertia that no body can have to the nearest that one can, and say whether it was.

    The second moments of a body's mass along its principal axes, each half the sum of the moments
    of inertia less the moment about that axis, are not below zero. Those that are, or that are zero
    like all but one of a thin rod, become a thousandth of the largest. A negligible inertia becomes
    zero, and so does then a negligible mass. Raises ValueError for one that is not finite, or
    below zero about x, y or z.
    """
    xx, yy, zz, xy, xz, yz = link.fullinertia
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not np.isfinite(matrix).all() or min(xx, yy, zz) < 0.0:
        raise ValueError(f"the inertia of {link.name} is below zero or not finite")
    if np.abs(matrix).max() < _NO_INERTIA:
        link.fullinertia, link.inertia = [np.nan, 0, 0, 0, 0, 0], np.zeros(3)
        if link.mass < _NO_MASS:
            link.mass = 0.0
        return False
    moments, axes = np.linalg.eigh(matrix)
    spread = 0.5 * moments.sum() - moments
    if moments[0] > 1e-9 * moments[2] and spread[2] >= 0.0:
        return False
    spread = np.maximum(spread, 1e-3 * spread[0])
    matrix = axes @ np.diag(spread.sum() - spread) @ axes.T
    link.fullinertia = [*np.diag(matrix), matrix[0, 1], matrix[0, 2], matrix[1, 2]]
    return True


def _is_a_foot(link: mujoco.MjsBody) -> bool:
    """Whether a link is named as a foot, and fixed to the end of a leg of at most three joints: a
    foot on an ankle may be flat.
    """
    joints, above = 0, link
    while above := above.parent:
        joints += sum(joint.type != _FREE for joint in above.joints)
    named = any(word in link.name.lower() for word in ("foot", "toe"))
    return named and not link.bodies and not link.joints and 0 < joints < 4


def _floating(robot: ElementTree.Element) -> str:
    """The text of a URDF's root element, which is changed, with a floating root and without
    meshes.
    """
    for link in robot.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            if shape.find("geometry/mesh") is not None:
                link.remove(shape)
    children = {child.get("link", "") for child in robot.findall("joint/child")}
    parents = {parent.get("link", "") for parent in robot.findall("joint/parent")}
    names = [link.get("name", "") for link in robot.findall("link")]
    missing = sorted((children | parents) - set(names))
    if missing == ["world"]:
        # Many files leave the world undeclared, as the readers of Drake and SDFormat allow.
        ElementTree.SubElement(robot, "link", name="world")
        names.append("world")
    elif missing:
        raise ValueError(f"its joints name links that it lacks: {missing[:5]}")
    roots = [name for name in names if name not in children]
    if len(roots) != 1:
        raise ValueError(f"a URDF has one root link, this one {len(roots)}: {roots[:5]}")
    (root,) = roots
    if root != "world":
        ElementTree.SubElement(robot, "link", name="world")
        joint = ElementTree.SubElement(robot, "joint", name="floating_base", type="floating")
        ElementTree.SubElement(joint, "parent", link="world")
        ElementTree.SubElement(joint, "child", link=root)
    options = robot.find("mujoco")
    options = ElementTree.SubElement(robot, "mujoco") if options is None else options
    compiler = options.find("compiler")
    compiler = ElementTree.SubElement(options, "compiler") if compiler is None else compiler
    compiler.set("fusestatic", "false")
    if robot.find("link/inertial") is not None:
        # A URDF's link without <inertial> has no mass; MuJoCo would take it from its shapes.
        compiler.attrib.setdefault("inertiafromgeom", "false")
    return ElementTree.tostring(robot, encoding="unicode")


def name_parts(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Name the bodies and joints of a spec that have no name, which MJCF allows, by their number.

    Returns the change in words, if there is one.
    """
    changes = []
    joints = [joint for joint in spec.joints if joint.type != _FREE]
    for kind, parts in (("body", spec.bodies[1:]), ("joint", joints)):
        taken, named = {part.name for part in parts}, list[str]()
        for number, part in enumerate(parts, 1):
            if part.name:
                continue
            part.name = f"{kind}_{number}"
            while part.name in taken:
                part.name += "_"
            named.append(part.name)
        if named:
            first_and_last = " to ".join(dict.fromkeys((named[0], named[-1])))
            changes.append(f"numbered, as the file gives them no names: {first_and_last}")
    return tuple(changes)


def leave_out_surroundings(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Remove the other bodies of a scene in which something moves freely: balls, tables, carts.

    The machine is the body of the world with the most chains of two or more hinges. If it moves
    freely, all others go; if it is fixed to the world, those that move freely do. Returns the
    change in words, if there is one. Raises SurefootError where two bodies have equal claims.
    """
    bodies = list(spec.worldbody.bodies)
    free = [body for body in bodies if _is_free(body)]
    if len(bodies) < 2 or not free:
        return ()
    bodies.sort(key=_legs_below, reverse=True)
    machine, second = bodies[:2]
    if _legs_below(machine) == _legs_below(second) and _is_free(machine):
        raise SurefootError(
            f"its bodies {machine.name} and {second.name} may both be the robot: leave one out"
        )
    out = [b for b in (bodies if _is_free(machine) else free) if b.name != machine.name]
    left_out = [body.name for body in out]
    for body in out:
        spec.delete(body)
    for looking in (*spec.cameras, *spec.lights):
        if looking.targetbody and spec.body(looking.targetbody) is None:
            spec.delete(looking)
    return (f"left out, as no part of the robot: {', '.join(left_out)}",)


def _is_free(body: mujoco.MjsBody) -> bool:
    return any(joint.type == _FREE for joint in body.joints)


def _legs_below(body: mujoco.MjsBody, above: int = 0) -> int:
    """Number of chains of two or more hinges that end at or below a body, with those `above`."""
    hinges = above + sum(joint.type == _HINGE for joint in body.joints)
    return sum(_legs_below(child, hinges) for child in body.bodies) or int(hinges >= 2)
