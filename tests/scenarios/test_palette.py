"""Colours that differ, and figures of robots and of observers in which nothing touches."""

import numpy as np
import pytest
from written import written

from surefoot.scenarios.estimate.estimators import ESTIMATORS, shown_at_first, traits
from surefoot.scenarios.reporting.observer_errors import (
    error_bounds,
    error_distributions,
)
from surefoot.scenarios.reporting.palette import (
    AFTER,
    BEFORE,
    OBSERVER,
    OUTSIDE,
    TEST,
    TRAIN,
    TRUTH,
    estimator_color,
    rgba,
)
from surefoot.scenarios.robot_card import portrait, robot_card
from surefoot.sim.robot import Robot

WHITE, VIEWER = 1.0, 0.005  # relative luminance of a page and of the viewer's background
SEEN = {
    "with": np.eye(3),
    "protan": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "deutan": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
}


"""How linear RGB is seen with colour vision and without (Machado et al. 2009, severity 1)."""


TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def linear(color: str) -> np.ndarray:
    c = np.array(rgba(color)[:3]) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    f = np.cbrt(TO_XYZ @ rgb.clip(0.0, 1.0) / [0.9505, 1.0, 1.089])
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", SEEN)
def test_colours_differ(vision):
    """A difference of 10 is seen at a glance; those that are shown together differ by 30."""
    names = [name for name in ESTIMATORS if traits(name).drawn]
    first = shown_at_first(names)
    places = {name: lab(SEEN[vision] @ linear(estimator_color(name))) for name in names}
    for k, a in enumerate(names):
        for b in names[k + 1 :]:
            apart = np.linalg.norm(places[a] - places[b])
            assert apart > (30.0 if {a, b} <= set(first) else 10.0), (a, b, apart)
    for pair in ((TRAIN, TEST), (BEFORE, AFTER), (TRUTH, OUTSIDE), (OBSERVER, OUTSIDE)):
        one, other = (lab(SEEN[vision] @ linear(color)) for color in pair)
        assert np.linalg.norm(one - other) > 30.0, pair


@pytest.mark.parametrize("name", [name for name in ESTIMATORS if traits(name).color])
def test_a_line_stands_out_from_a_page_and_from_the_viewer(name):
    luminance = TO_XYZ[1] @ linear(estimator_color(name))
    assert (WHITE + 0.05) / (luminance + 0.05) > 1.9
    assert (luminance + 0.05) / (VIEWER + 0.05) > 2.3


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


def test_of_legs_one_behind_another_the_nearest_is_named(tmp_path):
    file = written(tmp_path / "robot.xml", two_legs([0.3, 0.4]))
    views = portrait(Robot.load(str(file))).axes
    named = [{text.get_text() for text in view.texts} - {"IMU"} for view in views]
    assert named == [{"left"}, {"left", "right"}]


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


EPSILON = np.array([0.1, 0.1, 0.1])


@pytest.fixture(scope="module")
def errors():
    """Gaussian in training; elsewhere skewed and biased, heavy-tailed, and the same."""
    rng = np.random.default_rng(0)
    train = 0.03 * rng.standard_normal((6000, 3))
    test = 0.03 * rng.standard_normal((6000, 3))
    test[:, 0] = 0.02 * (rng.gamma(2.0, size=6000) - 1.0)
    test[:, 1] = 0.03 * rng.standard_t(3, size=6000)
    return train, test


def test_the_bounds_figure_shows_shares_of_the_data(errors):
    train, test = errors
    for drawn in (error_bounds, error_distributions):
        for k, ax in enumerate(drawn(train, test, EPSILON, 0.8).axes[:3]):
            share = 100 * (np.abs(test[:, k]) <= EPSILON[k]).mean()
            assert f"test {share:.1f} %" in ax.get_title()


def test_the_motivating_figure_fits_a_gaussian_to_each(errors):
    """The fit drawn over each axis' errors has their mean and their spread."""
    biased = errors[1] + np.array([0.04, -0.05, 0.06])
    figure = error_distributions(errors[0], biased, EPSILON, 0.8)
    for k, ax in enumerate(figure.axes[:3]):
        fits = [line for line in ax.get_lines() if "Gaussian fit" in str(line.get_label())]
        for line, e in zip(fits, (errors[0][:, k], biased[:, k]), strict=True):
            x, density = np.asarray(line.get_xydata()).T
            assert x[np.argmax(density)] == pytest.approx(e.mean(), abs=x[1] - x[0])
            assert density.max() == pytest.approx(1 / np.sqrt(2 * np.pi) / e.std(), rel=0.02)
