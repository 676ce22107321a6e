"""Legs found by the kinematic tree alone are the legs that MuJoCo moves."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd
import pytest
from good_texts import URDF
from quadruped_mjcf import SPHERE, UNSEEN, quadruped_mjcf
from refusals import refused
from written import written

from surefoot.scenarios.robot_card import robot_card
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log, Meta
from surefoot.sim.physics.scene import build_world
from surefoot.sim.robot import Robot
from surefoot.sim.robot.catalog import downloadable_robots, known_robots, of_robot, robot_file
from surefoot.sim.robot.home_pose import stands
from surefoot.sim.robot.legs import LEGS
from surefoot.sim.robot.machine import FixedBase, load_machine, machine_for_log
from surefoot.sim.robot.model_file import compiled_model, read_model
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

ROBOTS = sorted(known_robots())


@pytest.fixture(scope="module", params=ROBOTS)
def robot(request) -> Robot:
    return Robot.load(request.param)


def random_joints(robot: Robot, seed: int, n: int) -> np.ndarray:
    lower, upper = robot.joint_range.T
    return np.random.default_rng(seed).uniform(lower, upper, (n, 12))


def test_feet_are_where_mujoco_puts_them(robot):
    model = robot.spec().compile()
    data = mujoco.MjData(model)
    base = model.body(robot.base_name).id
    for q in random_joints(robot, 0, 20):
        for name, angle in zip(robot.joint_names, q, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = angle
        mujoco.mj_kinematics(model, data)
        R = data.xmat[base].reshape(3, 3)
        for leg, (body, place) in enumerate(zip(robot.foot_bodies, robot.foot_places, strict=True)):
            at = model.body(body).id
            foot_G = data.xpos[at] + data.xmat[at].reshape(3, 3) @ place
            foot_I = robot.R_BI.T @ (R.T @ (foot_G - data.xpos[base]) - robot.p_BI)
            np.testing.assert_allclose(robot.feet_I(q[None])[0, leg], foot_I, atol=1e-9)


def test_legs_are_named_by_place(robot):
    x, y = robot.feet_I(robot.q_home[None])[0, :, :2].T + robot.p_BI[:2, None]
    for leg, name in enumerate(LEGS):
        assert (x[leg] > x.mean()) == (name[0] == "F")
        assert (y[leg] > y.mean()) == (name[1] == "L")


def test_home_stands(robot):
    assert stands(robot.legs, robot.foot_radius, robot.q_home)
    lower, upper = robot.joint_range.T
    assert ((robot.q_home > lower) & (robot.q_home < upper)).all()


def disc(radius: float) -> str:
    """Vertices of a disc that turns about y."""
    turned = np.arange(16) * np.pi / 8
    rim = zip(radius * np.cos(turned), radius * np.sin(turned), strict=True)
    return " ".join(f"{x:.4f} {y} {z:.4f}" for x, z in rim for y in (-0.02, 0.02))


def with_mesh(vertices: str, pos: str, also: str = "") -> str:
    """A robot whose feet are this mesh, and have other shapes beside it."""
    asset = f'<asset><mesh name="foot" vertex="{vertices}"/></asset><worldbody>'
    text = quadruped_mjcf(f'<geom type="mesh" mesh="foot" pos="{pos}"/>{also}')
    return text.replace("<worldbody>", asset)


def without_motors(text: str) -> str:
    return re.sub("<actuator>.*</actuator>", "", text)


def odd(folder: Path, text: str) -> Robot:
    return Robot.load(written(folder / "odd.xml", text))


def test_names_and_order_in_the_file_do_not_matter(tmp_path):
    robot = odd(tmp_path, quadruped_mjcf())
    assert robot.joint_names[:3] == ("fl_j1", "fl_j2", "fl_j3")
    assert robot.joint_names[9:] == ("br_j1", "br_j2", "br_j3")


def test_legs_of_unlike_lengths_stand_on_one_ground(tmp_path):
    text = quadruped_mjcf(knee='axis="0 1 0"')
    for hind in ("br3", "bl3"):
        shank = f'<body name="{hind}" pos="0 0 -0.'
        text = text.replace(f'{shank}2">', f'{shank}15">')
    robot = odd(tmp_path, text)
    assert np.ptp(robot.feet_I(robot.q_home[None])[0, :, 2]) < 1e-6
    folded = " ".join(f"{q:.6f}" for q in -robot.q_home.reshape(4, 3)[[3, 1, 2, 0]].ravel())
    home = f'<keyframe><key name="home" qpos="0 0 .3 1 0 0 0 {folded}"/></keyframe></mujoco>'
    kept = odd(tmp_path, text.replace("</mujoco>", home))
    np.testing.assert_allclose(kept.q_home, -robot.q_home, atol=1e-6)


def test_a_mesh_foot_is_the_end_of_the_mesh_that_reaches_farthest(tmp_path):
    """A bounding box has corners where a round foot has nothing, and a shank beside it that lies
    level in the model's zero pose has them lower than the foot."""
    shank = '<geom type="box" size=".1 .02 .03" pos=".1 0 0"/>'
    robot = odd(tmp_path, with_mesh(disc(0.03), "0.2 0 0", shank))
    np.testing.assert_allclose(robot.foot_radius, 0.03, rtol=0.03)
    np.testing.assert_allclose(robot.foot_places, [[0.2, 0.0, 0.0]] * 4, atol=1e-3)


def test_a_leg_that_is_a_capsule_stands_on_its_end(tmp_path):
    robot = odd(tmp_path, quadruped_mjcf('<geom type="capsule" size=".02 .02" pos="0 0 -.2"/>'))
    np.testing.assert_allclose(robot.foot_radius, 0.02)
    np.testing.assert_allclose(robot.foot_places, [[0.0, 0.0, -0.22]] * 4, atol=1e-12)


FOOT_RODS = [f'pos=".03 {y} -.05" quat=".70384 .06777 .70384 .06777"' for y in (-0.02, 0.02)]
BIPED = """<mujoco><default><geom {touch}/></default><worldbody>
<geom name="floor" type="plane" size="1 1 1"/><body><freejoint/><geom size=".1"/>
<body pos="0 .3 .3"><joint name="arm" axis="0 1 0"/><geom type="capsule" size=".02 .1"/></body>
{legs}</body></worldbody><contact>{pairs}</contact></mujoco>"""


@pytest.mark.parametrize(("rod", "half"), [("capsule", 0.09), ("cylinder", 0.08)])
@pytest.mark.parametrize("touching", ["all", "pairs", "by the scene"])
def test_lying_rods_are_the_sole_of_a_leg_that_can_level_it(tmp_path, rod, half, touching):
    """They are turned about their length at random, touch the ground perhaps by pairs alone, which
    a scene may declare, and the arms of the robot are of capsules too."""
    legs, pairs = "", ""
    for side, y in (("left", 0.1), ("right", -0.1)):
        names = [f"{side}{i}" for i in range(2)]
        foot = "".join(
            f'<geom name="{name}" type="{rod}" size=".01 .08" {at}/>'
            for name, at in zip(names, FOOT_RODS, strict=True)
        )
        for part in ("ankle", "knee", "thigh", "hip"):
            joint = f'<joint name="{side}_{part}" axis="{int(part == "hip")} 1 0"/>'
            shank = "" if part == "ankle" else '<geom size=".01"/>'
            foot = f'<body pos="0 0 -.2">{joint}{shank}{foot}</body>'
        legs += f'<body pos="0 {y} 0">{foot}</body>'
        pairs += "".join(f'<pair geom1="{name}" geom2="floor"/>' for name in names)
    touch, pairs = "" if touching == "all" else UNSEEN, pairs if touching == "pairs" else ""
    robot = odd(tmp_path, BIPED.format(touch=touch, legs=legs, pairs=pairs))
    assert robot.limbs.legs == ("left", "right")
    np.testing.assert_allclose(robot.sole, [[half, 0.03]] * 2, atol=1e-4)
    np.testing.assert_allclose(robot.foot_places, [[0.03, 0.0, -0.06]] * 2, atol=1e-4)


def edited(old: str, new: str, **options) -> str:
    return quadruped_mjcf(**options).replace(old, new)


CONNECT = '<equality><connect body1="bl3" body2="trunk" anchor="0 0 0"/></equality>'
WAIST = '<body><joint name="waist"/><geom size=".1"/><body name="br1"'
NO_LEGS = '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
ABREAST = [(0.1, 0.1), (0.2, 0.1), (0.3, 0.1), (0.4, 0.1)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (NO_LEGS, "none of its 0 chains"),
        (quadruped_mjcf(places=ABREAST), "front, rear"),
        (quadruped_mjcf('<geom type="cylinder" size=".02 .02" euler="1.57 0 0"/>'), "for a foot"),
        (with_mesh(disc(0.08), "0 0 0"), "the axle of a wheel"),
        (edited('"br_j3" axis', '"br_j3" type="slide" axis'), "joint br_j3 of a leg slides"),
        (
            without_motors(edited('axis="0 1 0" range="-1.5 3"', 'type="ball"')),
            "joint fl_j2 of a leg is a ball joint",
        ),
        (quadruped_mjcf(more=CONNECT), "a closed loop"),
        (
            edited('<body name="br1"', WAIST).replace("</worldbody>", "</body></worldbody>"),
            "legs share hinge waist",
        ),
        ("<mujoco", "cannot read"),
    ],
)
def test_what_cannot_be_found_is_said_in_one_line(tmp_path, text, words):
    refused(words, odd, tmp_path, text)


def test_robot_descriptions_are_found_by_name_and_failures_are_one_line(tmp_path, monkeypatch):
    package = tmp_path / "robot_descriptions"
    package.mkdir()
    (tmp_path / "odd.xml").write_text(quadruped_mjcf())
    (package / "odd_mj_description.py").write_text(f"MJCF_PATH = {str(tmp_path / 'odd.xml')!r}")
    text = "Cmd('git') failed due to: exit code(128)\\n stderr: 'fatal: no such host'"
    (package / "gone_mj_description.py").write_text(f'raise OSError("{text}")')
    (package / "__init__.py").write_text(
        "from types import SimpleNamespace as S\n"
        "DESCRIPTIONS = {n + '_mj_description': S(dof=12, tags={'quadruped'}) "
        "for n in ('odd', 'go1')} | {'arm_mj_description': S(dof=7, tags={'arm'})}"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "robot_descriptions", raising=False)
    assert robot_file("odd") == tmp_path / "odd.xml"
    assert downloadable_robots() == ("odd",)  # go1 is here already
    refused(r"robot gone: .*fatal: no such host", Robot.load, "gone")
    refused("unknown robot", Robot.load, "nobody")


def test_the_imu_is_where_the_gyro_sits_whatever_it_is_called(tmp_path):
    """A model without one has the base frame for it, and says so."""
    assert odd(tmp_path, edited('<site name="imu"/>', "")).imu is None
    site = '<site name="box" pos=".1 0 .02" quat="0 0 0 1"/>'
    sensor = '<sensor><gyro site="box"/></sensor>'
    robot = odd(tmp_path, edited('<site name="imu"/>', site, more=sensor))
    assert robot.imu == "box"
    np.testing.assert_allclose(robot.p_BI, [0.1, 0.0, 0.02])
    np.testing.assert_allclose(robot.R_BI, np.diag([-1.0, -1.0, 1.0]), atol=1e-12)


def with_visuals(inertial: str, shape: str) -> str:
    """A robot with a texture and a mesh whose files are missing."""
    files = """<asset><texture name="skin" type="2d" file="skin.png"/>
    <mesh name="hull" file="hull.stl"/><material name="metal" texture="skin"/></asset>"""
    shapes = f'<freejoint/>{inertial}<geom type="mesh" mesh="hull" material="metal" {shape}/>'
    text = quadruped_mjcf(trunk='size=".2 .1 .1" material="metal"')
    return text.replace("<worldbody>", f"{files}<worldbody>").replace("<freejoint/>", shapes)


INERTIAL = '<inertial pos="0 0 0" mass="5" diaginertia=".1 .1 .1"/>'


@pytest.mark.parametrize(("inertial", "density"), [(INERTIAL, 1000), ("", 0)])
def test_visuals_whose_files_are_missing_are_left_out(tmp_path, inertial, density):
    path, whole = tmp_path / "odd.xml", tmp_path / "whole.xml"
    path.write_text(with_visuals(inertial, f'{UNSEEN} density="{density}"'))
    plain = 'size=".2 .1 .1"'
    whole.write_text(edited("<freejoint/>", f"<freejoint/>{inertial}", trunk=plain))
    robot = Robot.load(path)
    assert robot.mass == Robot.load(whole).mass
    assert robot.spec().compile().ngeom == compiled_model(whole).ngeom
    assert "files are missing: skin.png, hull.stl" in robot_card(str(path), None).text
    assert "missing" not in robot_card(str(whole), None).text


def test_meshes_may_lie_in_a_folder_beside_the_models(tmp_path, monkeypatch):
    """As `mjcf/robot.xml` and `meshes/` of many a package; not in a folder above both."""
    path = tmp_path / "mjcf" / "odd.xml"
    path.parent.mkdir()
    text = with_visuals(INERTIAL, UNSEEN).replace("hull.stl", "../meshes/hull.stl")
    path.write_text(text)
    assert "files are missing: skin.png, ../meshes/hull.stl" in robot_card(str(path), None).text
    links = "../hull.stl", "../../meshes/hull.stl", "../.meshes/hull.stl", "away/../../hull.stl"
    for above in (*links, "../meshes/hull.txt"):
        path.write_text(text.replace("../meshes/hull.stl", above))
        refused(r"hull\.\w+' lies outside", Robot.load, path)
        (path.parent / "away").unlink(missing_ok=True)
        (path.parent / "away").symlink_to(tmp_path / "mjcf" / "a" / "b")
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "me")
    path.write_text(text)
    refused("lies outside", Robot.load, path)


@pytest.mark.parametrize(("inertial", "shape"), [(INERTIAL, ""), ("", UNSEEN)])
def test_a_missing_mesh_that_collides_or_weighs_is_refused(tmp_path, inertial, shape):
    refused(r"hull\.stl", odd, tmp_path, with_visuals(inertial, shape))


def test_the_solver_of_a_walk_is_not_the_robots(tmp_path):
    """Models for parallel simulation ask for one iteration, with which robots fall at once."""
    option = '<option solver="CG" iterations="1" ls_iterations="4" tolerance="1e-3"/>'
    robot = odd(tmp_path, edited("<worldbody>", f"{option}<worldbody>"))
    given = build_world(robot, Ground(0.8)).model.opt
    usual = mujoco.MjSpec().option
    for name in ("solver", "iterations", "ls_iterations", "tolerance"):
        assert getattr(given, name) == getattr(usual, name)


def test_a_foot_that_touches_by_its_scene_alone_is_not_walked(tmp_path):
    """Its legs are read from the shapes at their ends, but it would fall through other ground."""
    unseen = SPHERE.replace("/>", f" {UNSEEN}/>"), f'size=".2 .1 .05" mass="6" {UNSEEN}'
    robot = odd(tmp_path, quadruped_mjcf(unseen[0], trunk=unseen[1]))
    refused("no shape of foot FL touches the ground", build_world, robot, Ground(0.8))
    card = robot_card(str(robot.file), None).text
    assert "does not walk in simulation: no shape of foot FL" in card


def test_a_joint_without_a_torque_limit_is_named_and_not_walked(tmp_path):
    robot = odd(tmp_path, without_motors(quadruped_mjcf()))
    refused("no torque limit for joint fl_j1; give its actuator a", build_world, robot, Ground(0.8))


WELD = '<joint name="weld" type="fixed"><parent link="{}"/><child link="{}"/></joint>'
GUARD = '<link name="guard"><collision><geometry><box size="1 1 1"/></geometry></collision></link>'
FRAME = (
    '<link name="imu"><inertial><mass value="1e-7"/>'
    '<inertia ixx="1e-22" iyy="1e-22" izz="1e-22" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)


@pytest.mark.parametrize(
    ("extra", "nq", "masses"),
    [
        # Some readers of URDF know the world without its link: a machine that is fixed to it.
        (WELD.format("world", "base"), 1, [0.0, 5.0, 1.0]),
        # Guards and boxes are often drawn as shapes alone, and weigh nothing to other readers.
        (GUARD + WELD.format("base", "guard"), 8, [0.0, 5.0, 0.0, 1.0]),
        # What has next to no inertia is a frame.
        (FRAME + WELD.format("base", "imu"), 8, [0.0, 5.0, 0.0, 1.0]),
    ],
)
def test_a_link_of_a_urdf_weighs_what_its_inertial_says(tmp_path, extra, nq, masses):
    file = written(tmp_path / "arm.urdf", URDF.replace("</robot>", f"{extra}</robot>"))
    model = compiled_model(file)
    assert (model.nq, sorted(model.body_mass)) == (nq, sorted(masses))


def test_inertias_of_a_urdf_that_no_body_has_are_mended_and_named(tmp_path):
    """Drawn by hand, as in many robots' files, which other readers take as they are."""
    joint = (
        '<link name="middle"/><joint name="yaw" type="continuous"><parent link="arm"/>'
        '<child link="middle"/></joint>'
    )
    text = URDF.replace('izz="0.1"', 'izz="0.4"').replace("</robot>", f"{joint}</robot>")
    assert text.count('izz="0.4"') == 2
    file = written(tmp_path / "arm.urdf", text)
    model = compiled_model(file)
    np.testing.assert_allclose(model.body("arm").inertia, [0.4, 0.2002, 0.2002])
    assert model.body("arm").mass[0] == 1.0
    assert 0.0 < model.body("middle").mass[0] < 1e-5
    card = robot_card(str(file), None).text
    assert "above the sum of the others" in card
    assert "the nearest that one can have is taken for base, arm" in card
    assert "links that move without a mass or a moment of inertia" in card
    file.write_text(URDF)
    assert read_model(file)[1] == ()


def quadruped_urdf(foot: str) -> str:
    """A URDF of four legs of three hinges, with this shape for a foot, a box for a thigh that
    reaches into the base's, and an IMU that is turned.
    """
    inertial = (
        '<inertial><mass value="{}"/><inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )
    box = '<collision><geometry><box size="{}"/></geometry></collision>'
    lines = [f'<link name="trunk">{inertial.format(8)}{box.format("0.5 0.3 0.1")}</link>']
    lines += ['<link name="plate"/>', '<link name="imu_link"/>']
    weld = '<joint name="{}" type="fixed"><parent link="{}"/><child link="{}"/>{}</joint>'
    lines.append(weld.format("a", "trunk", "plate", '<origin xyz="0.1 0 0" rpy="0 0 1.5707963"/>'))
    lines.append(weld.format("b", "plate", "imu_link", '<origin xyz="0.02 0 0.03"/>'))
    for leg, x, y in (("LF", 0.2, 0.1), ("RF", 0.2, -0.1), ("LH", -0.2, 0.1), ("RH", -0.2, -0.1)):
        above, place = "trunk", f"{x} {y} 0"
        for part, axis in (("hip", "1 0 0"), ("thigh", "0 1 0"), ("shank", "0 1 0")):
            name = f"{leg}_{part}"
            shape = box.format("0.05 0.05 0.2") if part == "thigh" else ""
            lines.append(f'<link name="{name}">{inertial.format(0.8)}{shape}</link>')
            lines.append(
                f'<joint name="{name}_joint" type="revolute"><parent link="{above}"/>'
                f'<child link="{name}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
                '<limit lower="-2.5" upper="2.5" effort="40" velocity="20"/></joint>'
            )
            above, place = name, "0 0 0" if part == "hip" else "0 0 -0.25"
        shape = f"<collision><geometry>{foot}</geometry></collision>"
        lines.append(f'<link name="{leg}_FOOT">{shape}</link>')
        lines.append(weld.format(f"{leg}_end", above, f"{leg}_FOOT", f'<origin xyz="{place}"/>'))
    return f'<robot name="four">{"".join(lines)}</robot>'


def test_a_foot_that_is_a_mesh_of_a_urdf_is_a_point(tmp_path):
    file = written(tmp_path / "four.urdf", quadruped_urdf('<sphere radius="0.02"/>'))
    round_feet = Robot.load(file)
    feet = "LF_FOOT, RF_FOOT, LH_FOOT, RH_FOOT"
    assert read_model(file)[1] == (f"without <inertial>, these links have no mass: {feet}",)
    file.write_text(quadruped_urdf('<mesh filename="package://four/foot.dae"/>'))
    robot = Robot.load(file)
    (said,) = read_model(file)[1]
    assert said.endswith(f"feet are points at {feet}")
    np.testing.assert_allclose(robot.foot_radius, 1e-3)
    np.testing.assert_allclose(
        robot.feet_I(robot.q_home[None]), round_feet.feet_I(robot.q_home[None])
    )
    assert robot.mass == pytest.approx(8.0 + 12 * 0.8)


def test_the_card_gives_the_mass_of_a_link_with_what_is_fixed_to_it(tmp_path):
    text = quadruped_urdf('<sphere radius="0.02"/>')
    inertia = 'ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"'
    inertial = f'<inertial><mass value="0.15"/><inertia {inertia}/></inertial>'
    file = tmp_path / "four.urdf"
    file.write_text(text.replace('<link name="LF_FOOT">', f'<link name="LF_FOOT">{inertial}'))
    rows = robot_card(file, None).text.splitlines()
    masses = {row.split()[1]: row.split()[-2] for row in rows if "_calf " in row}
    others = dict.fromkeys(("FR_calf", "RL_calf", "RR_calf"), "0.800")
    assert masses == {"FL_calf": "0.950"} | others


def test_the_imu_of_a_urdf_is_the_link_named_so(tmp_path):
    """Fixed to the base by way of a plate that is turned by a quarter about z."""
    file = written(tmp_path / "four.urdf", quadruped_urdf('<sphere radius="0.02"/>'))
    robot = Robot.load(file)
    assert robot.imu == "imu"
    np.testing.assert_allclose(robot.p_BI, [0.1, 0.02, 0.03], atol=1e-6)
    np.testing.assert_allclose(robot.R_BI, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-6)
    file.write_text(quadruped_urdf('<sphere radius="0.02"/>').replace("imu_link", "lidar"))
    assert Robot.load(file).imu is None


def test_parts_of_a_urdf_may_reach_into_each_other_and_it_walks(tmp_path):
    """Its thighs are drawn through its trunk, as in many a published file."""
    robot = Robot.load(written(tmp_path / "four.urdf", quadruped_urdf('<sphere radius="0.02"/>')))
    log = walk(Scenario("short", (Segment(2.0, 0.3),), Ground(0.8)), robot, seed=0)
    assert np.linalg.norm(log.ref_p[-1, :2] - log.ref_p[0, :2]) > 0.3


def arm_urdf(*inertia: float) -> str:
    """`URDF` with these ixx, ixy, ixz, iyy, iyz and izz of its arm [kg m^2]."""
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    new = " ".join(f'{name}="{value!r}"' for name, value in zip(names, inertia, strict=True))
    old = 'ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"'
    head, tail = URDF.rsplit(old, 1)
    return head + new + tail


@pytest.mark.parametrize(
    ("given", "moments"),
    [
        # As of a link that a tool filled with one number: a plate.
        ((1e-3,) * 6, (1.5015e-3, 1.5015e-3, 3e-3)),
        # Rods without thickness, one across the axes.
        ((0.2, 0.0, 0.0, 0.2, 0.0, 0.0), (4e-4, 0.2002, 0.2002)),
        ((0.1, -0.1, 0.0, 0.1, 0.0, 0.2), (4e-4, 0.2002, 0.2002)),
        # A product of inertia that is larger than its moments.
        ((0.1, 0.15, 0.0, 0.1, 0.0, 0.1), (0.0502, 0.2002, 0.25)),
        # Numbers of a computation that should be zero.
        ((2e-20, -1e-21, 1e-20, 5e-20, 3e-21, 1e-20), (1e-10,) * 3),
    ],
)
def test_an_inertia_that_no_body_has_becomes_the_nearest_possible_one(tmp_path, given, moments):
    file = written(tmp_path / "arm.urdf", arm_urdf(*given))
    np.testing.assert_allclose(np.sort(compiled_model(file).body("arm").inertia), moments)
    (said, *_) = read_model(file)[1]
    assert ("milligram" if max(moments) < 1e-9 else "is taken for arm") in said


def test_a_log_with_feet_is_of_no_machine_on_a_fixed_base(tmp_path):
    """A URDF's feet may be meshes, which are not read: the reason must reach the user, and no
    trace take the base to be held still."""
    file = written(tmp_path / "arm.urdf", URDF)
    machine = load_machine(file)
    assert isinstance(machine, FixedBase)
    assert "none of its 1 chains of hinges ends in" in machine.legless
    assert machine.legless in robot_card(str(file), None).text
    t = 0.01 * np.arange(50)
    frame = pd.DataFrame({"t": t, "q_shoulder": 0.0 * t})
    meta = Meta(100.0, robot=str(file))
    assert isinstance(machine_for_log(Log(frame, meta, "held")), FixedBase)
    stands = Log(frame.assign(contact_left=1.0), meta, "walk")
    refused("walk: is of a machine with legs; robot arm: none", machine_for_log, stands)
    refused("no body or site 'toe'", load_machine, file, feet={"left": "toe"})


@pytest.fixture(scope="module")
def text() -> str:
    """A bundled model with a heavier trunk: another robot."""
    return robot_file("spot_class").read_text().replace('mass="13', 'mass="14')


@pytest.fixture(scope="module")
def mine(tmp_path_factory, text) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("mine")
    file = folder / "mine.xml"
    file.write_text(text)
    log = walk(Scenario("stand", (Segment(0.2),), Ground(0.8), stand=0.2), Robot.load(file), 0)
    log.write(folder / "log.parquet")
    return file, folder / "log.parquet"


def test_a_file_that_moved_or_changed_is_replaced_by_what_the_log_keeps(
    mine, text, tmp_path, monkeypatch
):
    file, path = mine
    monkeypatch.setenv("SUREFOOT_CACHE", str(tmp_path / "cache"))
    log, same = Log.read(path), Robot.load(file)
    assert Robot.for_log(log).file == file
    file.write_text(text.replace('mass="14', 'mass="19'))
    try:
        changed = Robot.for_log(log)
        file.rename(file.with_name("moved.xml"))
        moved = machine_for_log(log)
    finally:
        file.write_text(text)
    for found in (changed, moved):
        assert isinstance(found, Robot)
        assert (found.name, found.mass, found.digest) == ("mine", same.mass, same.digest)


def test_what_was_tampered_with_or_needs_other_files_is_one_line(mine, tmp_path):
    _, path = mine
    log = Log.read(path)
    kept = log.meta.model["file"] | {"path": str(tmp_path / "gone.xml")}
    for model, message in (
        (kept | {"text": kept["text"] + " "}, "does not match its digest"),
        ({k: v for k, v in kept.items() if k != "text"}, "gone.xml, is not there: say which"),
        (kept | {"path": str(tmp_path / "..")}, "is not there: say which"),
    ):
        other = replace(log, meta=replace(log.meta, model={"file": model}))
        refused(message, Robot.for_log, other)


def test_a_robot_that_is_named_takes_the_place_of_the_log_s(mine):
    file, path = mine
    log = of_robot(Log.read(path), "spot_class")
    assert "file" not in log.meta.model
    assert Robot.for_log(log).file == robot_file("spot_class")
    assert Robot.for_log(of_robot(log, file)).file == file
