"""`surefoot robots NAME`: the model read from a robot's file, as text and as a picture."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from surefoot.scenarios.reporting.palette import INK, OUTSIDE, TRUTH
from surefoot.scenarios.reporting.plotting import new_figure, save_figure, set_title, show_to_scale
from surefoot.scenarios.reporting.tables import to_markdown
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.robot.legs import outline_G
from surefoot.sim.robot.machine import Modelled, load_machine
from surefoot.sim.robot.model_file import compiled_model, read_model
from surefoot.sim.robot.robot import IMU_SITES, Robot
from surefoot.sim.walking.trial import why_not


@dataclass(frozen=True)
class RobotCard:
    """The model read from a robot's file, as text for a reader and as values for a program."""

    text: str
    values: dict[str, Any]


def robot_card(name_or_path: str, picture: Path | None, force: bool = False) -> RobotCard:
    """Legs, limits, masses, feet, IMU and home pose of a robot, and its picture as a PNG.

    Raises SurefootError for a robot that cannot be read or drawn, or where the picture's file
    exists (without `force`).
    """
    if picture is not None and picture.suffix != ".png":
        raise SurefootError(f"{picture}: the picture is a .png")
    machine = load_machine(name_or_path)
    if machine.legged is None:
        if picture is not None:
            raise SurefootError(f"out: {machine.name} is on a fixed base, without a picture")
        return _card_without_legs(machine)
    if picture is not None:
        save_figure(portrait(machine.legged), picture, force)
    return _card(machine.legged)


def _card_without_legs(machine: Modelled) -> RobotCard:
    joints = ", ".join(machine.joint_names)
    text = f"{machine.name}: a machine on a fixed base, joints {joints}\nfile: {machine.file}"
    if machine.legless:
        text += f"\nno legs: {machine.legless}"
    elif machine.file.suffix != ".urdf":
        text += "\nbase: fixed, as no body has a free joint; that of a walking robot needs one"
    text = "\n".join([text, *read_model(machine.file)[1]])
    values = {"name": machine.name, "file": machine.file, "joints": machine.joint_names}
    return RobotCard(text, values)


def _card(robot: Robot) -> RobotCard:
    model = compiled_model(robot.file)
    fault = why_not(robot)
    turned = Rotation.from_matrix(robot.R_BI).as_euler("xyz", degrees=True).round(1)
    by = ", ".join(f"{angle + 0.0:g}" for angle in turned)
    imu = f"site {robot.imu}" if robot.imu else f"{_no_imu(model)}: the base frame stands for it"
    lines = [
        f"{robot.name}: {robot.mass:.2f} kg, legs of {robot.leg_length:.3f} m",
        f"file: {robot.file}",
        f"base: body '{robot.base_name}'",
        f"IMU: {imu}, at {_numbers(robot.p_BI)} m in the base"
        + f", turned by roll, pitch, yaw of {by} deg" * bool(turned.any()),
        f"does not walk in simulation: {fault}" if fault else "walks in simulation",
    ]
    lines += read_model(robot.file)[1]
    # With all that is fixed to it; in a URDF a motor's mass is often that of a link of its own.
    moved = [model.body_weldid[model.jnt_bodyid[model.joint(n).id]] for n in robot.joint_names]
    joints = [
        {
            "joint": joint,
            "in the file": name,
            "from [rad]": robot.joint_range[j, 0],
            "to [rad]": robot.joint_range[j, 1],
            "torque [N m]": robot.torque_limit[j],
            "at home [rad]": round(robot.q_home[j], 6) + 0.0,  # of a search; no -1e-12, no -0
            "link [kg]": float(model.body_mass[model.body_weldid == moved[j]].sum()),
        }
        for j, (joint, name) in enumerate(zip(robot.limbs.joints, robot.joint_names, strict=True))
    ]
    feet = [
        {
            "leg": leg,
            "foot on body": robot.foot_bodies[k],
            "radius [m]": robot.foot_radius[k],
            "at home, in the base [m]": _numbers(robot.home_feet_B[k]),
        }
        for k, leg in enumerate(robot.limbs.legs)
    ]
    shown = ("name", "file", "mass", "leg_length", "imu", "p_BI", "R_BI")
    values = {name: getattr(robot, name) for name in shown}
    values |= {"walks": not fault, "fault": fault, "joints": joints, "feet": feet}
    return RobotCard("\n".join([*lines, "", to_markdown(joints), "", to_markdown(feet)]), values)


def _no_imu(model: mujoco.MjModel) -> str:
    """Why the base has no IMU: it is on another body, such as a torso above a waist, or missing."""
    gyros = model.sensor_objid[model.sensor_type == mujoco.mjtSensor.mjSENS_GYRO]
    named = (mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) for name in IMU_SITES)
    for site in (*gyros, *named):
        if site >= 0:
            body = model.body(model.site_bodyid[site]).name
            return f"site {model.site(site).name} is on {body}, not on the base"
    return "none in the model"


def portrait(robot: Robot) -> Figure:
    """Draw the robot in its home pose from the left and the front: shapes, legs, feet and IMU."""
    model = compiled_model(robot.file)
    data, feet_B = robot.at_home(model), robot.home_feet_B
    base = model.body(robot.base_name).id
    R, p = data.xmat[base].reshape(3, 3), data.xpos[base]

    def in_base(points: np.ndarray) -> np.ndarray:
        return (np.atleast_2d(points) - p) @ R

    figure, sides = new_figure(1, 2, (9.0, 4.2))
    for axes, across, title in zip(sides[0], (0, 1), ("its left", "the front"), strict=True):
        for geom in np.flatnonzero(model.geom_bodyid > 0):
            outline = in_base(outline_G(data, int(geom)))[:, [across, 2]]
            hull = outline[ConvexHull(outline, qhull_options="QJ").vertices]
            axes.add_patch(Polygon(hull, facecolor=TRUTH, edgecolor=INK, alpha=0.15, linewidth=0.4))
        named = np.empty((0, 2))
        for leg in map(int, np.argsort(-feet_B[:, 1 - across], kind="stable")):  # from the nearest
            names = [robot.joint_names[j] for j in robot.limbs.chains[leg]]
            hinges = [data.xanchor[model.joint(name).id] for name in names]
            line = np.array([*in_base(np.array(hinges)), feet_B[leg]])[:, [across, 2]]
            axes.plot(*line.T, "o-", color=INK, markersize=3.0, linewidth=1.2)
            radius = robot.foot_radius[leg]
            axes.add_patch(Circle(line[-1], radius, facecolor="none", edgecolor=INK))
            apart = np.linalg.norm(named - line[-1], axis=1)
            if (apart > 0.2 * robot.leg_length).all():  # not on top of another name
                name, named = robot.limbs.legs[leg], np.vstack([named, line[-1]])
                below = line[-1] - (0.0, radius)
                style = {"ha": "right", "va": "top", "color": INK, "rotation": 30.0}
                axes.annotate(name, below, (0, -3), textcoords="offset points", **style)
        imu = robot.p_BI[[across, 2]]
        axes.plot(*imu, "s", color=OUTSIDE, markersize=5.0)
        axes.annotate("IMU", imu, (5, 5), textcoords="offset points", color=OUTSIDE)
        axes.margins(0.1)
        axes.set_xlabel("forward [m]" if across == 0 else "left [m]")
        axes.set_ylabel("up [m]")
        set_title(axes, f"{robot.name}, seen from {title}")
    limits = np.array([[axes.get_xlim(), axes.get_ylim()] for axes in sides[0]])
    middle, half = limits.mean(axis=2), 0.5 * np.ptp(limits, axis=2).max(axis=0)
    for axes, centre in zip(sides[0], middle, strict=True):  # both at one scale and height
        show_to_scale(axes, centre - half, centre + half)
    return figure


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value + 0.0:.3f}" for value in values)
