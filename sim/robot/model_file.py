"""Read a robot's model: MJCF without visuals whose files are missing, URDF with a floating base and
without its meshes.
"""

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
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


def model_spec(file: Path) -> mujoco.MjSpec:
    """A new MjSpec of an MJCF or URDF file. Raises SurefootError in one clear line.

    MuJoCo welds the root link of a URDF to the world and omits its mass; here it floats, unless it
    is called `world`, which the file need not declare. Links that are fixed to others remain
    separate bodies, so that a sole or a sensor's frame is found by its name. Textures, and meshes
    that neither collide nor have mass, are left out of an MJCF where their files are missing.
    Moments of inertia of a URDF that no body can have, and links that turn but have no mass, are
    corrected, since other readers of URDF accept them; `changes_on_reading` names them.
    """
    return _spec(file)[0]


def changes_on_reading(file: Path) -> tuple[str, ...]:
    """Differences between the model as read and its file, in words.

    Raises SurefootError in one clear line.
    """
    return _spec(file)[1]


def _spec(file: Path) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """The MjSpec of a file, and `changes_on_reading`."""
    check_model_file(file)
    try:
        if file.suffix == ".urdf":
            return _urdf_spec(file)
        spec = mujoco.MjSpec.from_file(str(file))
        missing = _leave_out_visuals(spec, file.parent)
        without = f"visuals left out, as their files are missing: {', '.join(missing)}"
        return spec, (without,) if missing else ()
    except (ValueError, OSError, RuntimeError, ElementTree.ParseError, mujoco.FatalError) as error:
        raise _unreadable(file, error) from None


def compiled_model(file: Path) -> mujoco.MjModel:
    """The compiled model of an MJCF or URDF file. Raises SurefootError in one clear line."""
    check_model_file(file)
    try:
        if file.suffix == ".urdf":
            model = model_spec(file).compile()
        else:
            model = _compiled_mjcf(file)
    except (ValueError, RuntimeError, mujoco.FatalError, MemoryError) as error:
        raise _unreadable(file, error) from None
    check_compiled(file, model)
    return model


def _compiled_mjcf(file: Path) -> mujoco.MjModel:
    try:
        return mujoco.MjModel.from_xml_path(str(file))
    except ValueError:
        spec, changes = _spec(file)
        if not changes:
            raise
        return spec.compile()


def _leave_out_visuals(spec: mujoco.MjSpec, folder: Path) -> tuple[str, ...]:
    """Remove the visuals whose files are missing; returns those files.

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
    return tuple(left_out)


def _has_effect(geom: mujoco.MjsGeom, spec: mujoco.MjSpec) -> bool:
    """Whether a shape collides or adds to its body's inertia."""
    from_shapes = {
        mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE: True,
        mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE: False,
    }.get(spec.compiler.inertiafromgeom, not geom.parent.explicitinertial)
    massless = geom.mass == 0.0 or (np.isnan(geom.mass) and geom.density == 0.0)
    return bool(geom.contype or geom.conaffinity or (from_shapes and not massless))


def _unreadable(file: Path, error: Exception) -> SurefootError:
    if isinstance(error, SurefootError):
        return error
    reason = "; ".join(str(error).strip().splitlines()[:2]) or type(error).__name__
    return SurefootError(f"robot {file}: MuJoCo cannot read it: {reason}")


def _is_a_frame(inertial: ElementTree.Element) -> bool:
    """Whether a link's mass and inertia are negligible, so that it is only a frame."""
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        return False
    moments = [abs(float(inertia.get(axis, "inf"))) for axis in ("ixx", "iyy", "izz")]
    return float(mass.get("value", "inf")) < _NO_MASS and max(moments) < _NO_INERTIA


def _urdf_spec(file: Path) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """The MjSpec of a URDF with a floating root, and the corrections of its inertias, in words."""
    robot, changes = ElementTree.parse(file).getroot(), []
    for mass in robot.findall("link/inertial/mass"):
        if float(mass.get("value", "0")) < 0.0:  # which a lower bound of masses would hide
            raise ValueError(f"a mass is below zero, {mass.get('value')}")
    uneven = [
        link.get("name", "")
        for link in robot.findall("link")
        if (moments := _principal_moments(link)) is not None and sum(moments[:2]) < moments[2]
    ]
    spec = mujoco.MjSpec.from_string(_floating(robot))
    if uneven:
        spec.compiler.balanceinertia = True
        changes.append(
            "one moment of inertia exceeds the sum of the others, which no body has; their mean is "
            f"taken for all three of {', '.join(uneven)}"
        )
    try:
        spec.copy().compile()
    except ValueError as error:
        if "mass and inertia of moving bodies" not in str(error):
            raise
        spec.compiler.boundmass, spec.compiler.boundinertia = _LEAST_MASS, _LEAST_INERTIA
        changes.append("links that turn on a joint but have no mass were given a milligram")
    return spec, tuple(changes)


def _principal_moments(link: ElementTree.Element) -> np.ndarray | None:
    """Principal moments of inertia (3,) of a URDF's link [kg m^2], the largest last; None if it has
    none.
    """
    inertia = link.find("inertial/inertia")
    if inertia is None:
        return None
    pairs = ["xx", "xy", "xz", "xy", "yy", "yz", "xz", "yz", "zz"]
    values = [float(inertia.get(f"i{pair}", "0")) for pair in pairs]
    return np.linalg.eigvalsh(np.reshape(values, (3, 3)))


def _floating(robot: ElementTree.Element) -> str:
    """The text of a URDF's root element, which is changed, with a floating root and without
    meshes.
    """
    for link in robot.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            if shape.find("geometry/mesh") is not None:
                link.remove(shape)
        inertial = link.find("inertial")
        if inertial is not None and _is_a_frame(inertial):
            link.remove(inertial)
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
    return ElementTree.tostring(robot, encoding="unicode")
