"""What `surefoot robots` says of legs with other than three hinges."""

import numpy as np
import pytest
from figure_numbers import assert_numbers_apart
from written import written

from surefoot.scenarios.reporting.plotting import png
from surefoot.scenarios.robot_card import portrait, robot_card
from surefoot.sim.robot import Robot

LINK = '<joint name="{name}" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'


def two_legs(links: list[float]) -> str:
    """MJCF of a robot with two legs of these links [m], hinge above hinge."""
    legs = ""
    for side, y in (("left", 0.1), ("right", -0.1)):
        start, place = "", f"0 {y} 0"
        for k, link in enumerate(links):
            start += f'<body pos="{place}">' + LINK.format(name=f"{side}_{k}")
            place = f"0 0 {-link}"
        legs += f'{start}<geom size="0.01" pos="{place}"/>' + "</body>" * len(links)
    return f"""<mujoco><worldbody><body name="base"><freejoint/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{legs}</body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("links", "length"), [([0.4], 0.4), ([0.3, 0.4], 0.7), ([0.0, 0.0, 0.3, 0.4, 0.0, 0.05], 0.75)]
)
def test_a_leg_of_any_number_of_hinges_has_its_length(tmp_path, links, length):
    card = robot_card(str(written(tmp_path / "robot.xml", two_legs(links))), None)
    assert card.values["leg_length"] == pytest.approx(length)
    assert f"legs of {length:.3f} m" in card.text


@pytest.mark.parametrize("link", [0.1, 0.4, 1.0])
def test_numbers_below_a_tall_robot_do_not_touch(tmp_path, link):
    file = written(tmp_path / "robot.xml", two_legs([link, link]))
    assert_numbers_apart(portrait(Robot.load(str(file))))


def test_both_views_of_a_robot_are_at_one_scale_and_height(tmp_path):
    figure = portrait(Robot.load(str(written(tmp_path / "robot.xml", two_legs([0.2, 0.2])))))
    png(figure)
    left, front = figure.axes
    assert left.get_ylim() == pytest.approx(front.get_ylim())
    scales = [np.diff(ax.get_xlim())[0] / ax.get_window_extent().width for ax in figure.axes]
    assert scales[0] == pytest.approx(scales[1])


def test_a_mesh_is_drawn_by_its_outline(tmp_path):
    """The box around a turned mesh reaches farther up and down than the mesh."""
    lens = ".3 0 0 -.3 0 0 0 .02 0 0 -.02 0 0 0 .1 0 0 -.1"
    asset = f'<asset><mesh name="lens" vertex="{lens}"/></asset><worldbody>'
    shape = '<freejoint/><geom type="mesh" mesh="lens" pos="0 0 2" euler="0 45 0"/>'
    text = two_legs([0.2, 0.2]).replace("<worldbody>", asset).replace("<freejoint/>", shape)
    side = portrait(Robot.load(str(written(tmp_path / "robot.xml", text)))).axes[0]
    highest = np.asarray(side.patches[0].get_path().vertices)[:, 1].max()
    assert highest == pytest.approx(2.0 + 0.3 * np.sqrt(0.5), abs=1e-6)


def test_an_imu_above_the_waist_is_named(tmp_path):
    torso = """<body name="torso"><joint name="waist" axis="0 0 1"/><site name="imu"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></worldbody>
        <sensor><gyro site="imu"/></sensor>"""
    file = written(tmp_path / "robot.xml", two_legs([0.3, 0.4]))
    assert "IMU: none in the model: the base frame" in robot_card(str(file), None).text
    file.write_text(two_legs([0.3, 0.4]).replace("</body></worldbody>", torso))
    text = robot_card(str(file), None).text
    assert "IMU: site imu is on torso, not on the base: the base frame stands for it" in text
