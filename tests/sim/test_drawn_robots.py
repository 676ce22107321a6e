"""Robots as others draw them walk, or are said not to with what to change, in one line."""

import re

import numpy as np
import pytest
from quadruped_mjcf import KNEE, SPHERE, quadruped_mjcf
from refusals import refused
from written import written

from studies.measured import measured_folder
from surefoot.sim.effects.body import FootRolling
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.physics.scene import build_world
from surefoot.sim.robot import Robot
from surefoot.sim.robot.machine import load_machine
from surefoot.sim.robot.model_file import compiled_model, read_model
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import plan
from surefoot.sim.walking.trial import why_not

VERTICES = "-.02 -.02 -.02 .02 -.02 -.02 -.02 .02 -.02 .02 .02 -.02 0 0 .03"


MESH = f'<asset><mesh name="f" vertex="{VERTICES}"/>'


BALL = '<body name="ball" pos="1 0 .2"><freejoint/><geom name="skin" size=".1"/></body>'


BOX = '<geom type="box" pos="0 0 -.2" size=".02 .02 .01"/>'


SHIN = '<geom type="box" pos="0 0 -.1" size=".03 .03 .098"/>'


WHEELS = "".join(
    f'<body pos="{x} .1 0"><joint name="w{x}" axis="0 1 0"/><geom size=".05"/></body>'
    for x in (0.1, -0.1)
)


CART = f'<body name="cart"><freejoint/><geom size=".1"/>{WHEELS}</body>'


DOOR = '<body name="door"><joint axis="0 0 1"/><geom size=".1"/></body>'


TO_BALL = (
    '<sensor><framepos objtype="body" objname="ball"/></sensor>'
    '<contact><exclude body1="ball" body2="trunk"/></contact>'
    '<equality><connect body1="ball" body2="trunk" anchor="0 0 0"/></equality>'
)


STANDING = " 0 0.75 -1.5" * 4


def posture(qpos: str) -> str:
    return f'<keyframe><key name="home" qpos="{qpos}"/></keyframe>'


def drawn(tmp_path, text: str) -> Robot:
    return Robot.load(written(tmp_path / "dog.xml", text))


@pytest.mark.parametrize(
    "foot",
    [
        '<geom type="cylinder" pos="0 0 -.19" size=".015 .02"/>',
        '<geom type="mesh" mesh="f" pos="0 0 -.2" mass=".03"/>',
        f'<geom size=".025"/>{BOX}',
        *(
            pytest.param(one, marks=pytest.mark.long)
            for one in (
                BOX,
                '<geom type="cylinder" pos="0 0 -.2" size=".025 .008"/>',
                '<geom type="cylinder" pos="0 0 -.2" size=".02 .02" euler="1.57 0 0"/>',
                '<geom type="ellipsoid" pos="0 0 -.2" size=".03 .02 .02"/>',
                '<geom type="capsule" fromto="0 -.02 -.2 0 .02 -.2" size=".02"/>',
            )
        ),
    ],
)
def test_it_walks_on_feet_of_any_shape(tmp_path, foot):
    text = quadruped_mjcf(foot).replace("<worldbody>", f"{MESH}</asset><worldbody>", 1)
    assert why_not(drawn(tmp_path, text)) == ""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (quadruped_mjcf(f"{SPHERE}{SHIN}"), ("br3", "as low as foot")),
        (quadruped_mjcf(trunk='size=".2 .1 .5" mass="6"'), ("trunk", "as low as foot")),
        (quadruped_mjcf().replace('"-1.5 3"', '"-0.2 0.4"', 1), ("not level", "RR", "range")),
        (quadruped_mjcf('<geom size=".06"/>'), ("fl_j3", "wheel")),
        (quadruped_mjcf(torque=2.0), ("falls", "motor of joint", "2 N m")),
        (
            quadruped_mjcf(
                knee='axis="0 1 0" range="-1.2 -0.6"', more=posture(f"0 0 .3 1 0 0 0{STANDING}")
            ),
            ("home", "fl_j3", "range"),
        ),
    ],
)
def test_what_keeps_it_from_walking_is_said(tmp_path, text, words):
    said = why_not(drawn(tmp_path, text))
    assert all(word in said for word in words), said
    assert "\n" not in said


@pytest.mark.parametrize(
    ("text", "left_out"),
    [
        (quadruped_mjcf(scene=BALL), "ball"),
        (quadruped_mjcf(scene=CART), "cart"),
        (quadruped_mjcf(scene=f'{BALL}<body name="table"><geom size=".1"/></body>'), "ball, table"),
        (quadruped_mjcf(scene=DOOR), "door"),
        (
            quadruped_mjcf(scene=f'<camera mode="targetbody" target="ball"/>{BALL}', more=TO_BALL),
            "ball",
        ),
    ],
)
def test_what_else_is_in_a_scene_is_left_out_and_named(tmp_path, text, left_out):
    robot = drawn(tmp_path, text)
    assert robot.base_name == "trunk"
    assert read_model(robot.file)[1][-1].endswith(f": {left_out}")
    world = build_world(robot, Ground(0.8))
    assert world.model.nq == 7 + 12
    assert world.qpos_adr.min() == 7


def test_a_posture_survives_its_scene(tmp_path):
    ball = "1 0 .2 1 0 0 0"
    text = quadruped_mjcf(scene=BALL, more=posture(f"{ball} 0 0 .3 1 0 0 0{STANDING}"))
    np.testing.assert_allclose(drawn(tmp_path, text).q_home, [0.0, 0.75, -1.5] * 4)


def test_two_robots_are_not_chosen_from(tmp_path):
    (other,) = re.findall(r'<body name="trunk".*</body>(?=</worldbody>)', quadruped_mjcf())
    text = quadruped_mjcf(scene=other.replace('name="', 'name="other_'))
    refused("trunk", drawn, tmp_path, text)


def test_a_fixed_machine_with_something_loose_remains_fixed(tmp_path):
    upper = '<body name="upper"><joint name="b"/><geom size=".1"/></body>'
    arm = f'<body name="arm"><joint name="a"/><geom size=".1"/>{upper}</body>'
    path = written(tmp_path / "arm.xml", f"<mujoco><worldbody>{BALL}{arm}</worldbody></mujoco>")
    machine = load_machine(path)
    assert (machine.fixed, machine.limbs.joints) == (True, ("a", "b"))


@pytest.mark.parametrize("parts", ["body", "joint"])
def test_parts_need_no_names(tmp_path, parts):
    text = re.sub(rf'<{parts} name="[^"]*"', f"<{parts}", quadruped_mjcf())
    if parts == "joint":
        text = re.sub("<actuator>.*</actuator>", "", text)
        text = text.replace("range=", 'actuatorfrcrange="-40 40" range=')
    robot, named = drawn(tmp_path, text), quadruped_mjcf()
    assert why_not(robot) == ""
    assert f" to {parts}_1" in read_model(robot.file)[1][0]
    np.testing.assert_array_equal(robot.legs.offset, drawn(tmp_path, named).legs.offset)


@pytest.mark.parametrize(
    "qpos", ["0 " * 19, f"0 0 .3 0 0 0 0{STANDING}", f"0 0 .3 3 0 0 4{STANDING}"]
)
def test_it_stands_whatever_its_keyframe(tmp_path, qpos):
    robot = drawn(tmp_path, quadruped_mjcf(more=posture(qpos)))
    assert why_not(robot) == ""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (quadruped_mjcf(trunk='size=".2 .1 .05" mass="1e30"'), "body_mass"),
        (quadruped_mjcf(knee=f'{KNEE} armature="1e30"'), "dof_armature"),
        (quadruped_mjcf(knee=f'{KNEE} damping="1e30"'), "dof_damping"),
        (quadruped_mjcf(knee=f'{KNEE} frictionloss="1e30"'), "dof_frictionloss"),
        (quadruped_mjcf(more=posture("1e30 " * 19)), "key_qpos"),
        (quadruped_mjcf(more=posture("nan " * 19)), "key qpos is nan"),
        (quadruped_mjcf(knee='axis="0 1 0" range="nan 1"'), "range is nan"),
    ],
)
def test_numbers_that_nothing_can_have_are_refused(tmp_path, text, words):
    refused(words, drawn, tmp_path, text)


def test_effects_of_feet_need_spheres(tmp_path):
    rolling = FootRolling("all", 0.01)
    scenario = Scenario("short", (Segment(1.0, 0.3),), Ground(0.8))
    refused("foot FL", plan, scenario, drawn(tmp_path, quadruped_mjcf(BOX)), 0, [rolling])


def test_a_model_without_a_scene_is_compiled_as_it_is(tmp_path):
    path = tmp_path / "dog.xml"
    path.write_text(quadruped_mjcf(scene='<geom name="floor" type="plane" size="1 1 1"/>'))
    assert read_model(path)[1] == ()
    assert compiled_model(path).geom("floor").bodyid[0] == 0


MODELS = measured_folder().parent / "models"


ICUB = measured_folder() / "icub_biped" / "icub.urdf"


@pytest.mark.parametrize(
    ("file", "limits"),
    [
        ("anybotics_anymal_c/anymal_c.xml", (80.0, 80.0, 80.0)),
        ("unitree_go1/go1.xml", (23.7, 23.7, 35.55)),
    ],
)
def test_servos_control_ranges_are_angles_and_no_torques(file, limits):
    if not MODELS.is_dir():
        pytest.skip(f"no models in {MODELS}")
    robot = Robot.load(MODELS / file)
    assert robot.limbs.legs == ("FL", "FR", "RL", "RR")
    assert robot.torque_limit.reshape(4, 3).tolist() == [list(limits)] * 4


def test_a_humanoid_from_its_urdf():
    """Its base's x axis points backward: the left leg is the one whose joints are named so."""
    if not ICUB.is_file():
        pytest.skip(f"no {ICUB}")
    icub = Robot.load(ICUB)
    assert icub.mass == pytest.approx(33.1, abs=0.05)
    assert icub.foot_bodies == ("l_sole", "r_sole")
    assert icub.limbs.legs == ("left", "right")
    assert [len(chain) for chain in icub.limbs.chains] == [6, 6]
    assert len(icub.limbs.joints) == 32
    assert icub.limbs.kinds["knee"] == ("l_knee", "r_knee")
    assert icub.torque_limit[0] == 55.5
