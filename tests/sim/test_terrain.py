"""The ground the controller and the truth know is the ground MuJoCo collides with."""

import mujoco
import numpy as np
import pytest
from ground_course import surfaces
from refusals import refused

from surefoot.sim.ground.height_map import height, normal
from surefoot.sim.ground.terrain import Ground, Patch, Strip
from surefoot.sim.ground.tiles import add_ground

STRIPS = (
    Strip((1.0, 0.0), (4.0, 0.0), 2.0, (0.0, 0.6)),
    Strip((4.0, 0.0), (5.0, 0.0), 2.0, (0.6, 0.6)),
    Strip((5.0, 0.0), (8.0, 0.0), 2.0, (0.6, -0.6), steps=10),
    Strip((0.0, 2.0), (0.0, 5.0), 2.0, (0.0, 1.2), steps=10),
    Strip((-2.0, -1.0), (-2.0, -4.0), 1.5, (0.0, 0.5), mu=0.5),
    Strip((-2.0, -4.0), (-2.0, -5.0), 1.5, (0.5, 0.5)),
    Strip((-4.0, 1.0), (-8.0, 1.0), 2.0, (0.0, 0.4), rough=0.06),
    Strip((-4.0, 4.0), (-4.0, 7.0), 2.0, rough=0.05, grain=0.3),
    Strip((2.0, 0.0), (3.0, 0.0), 1.0, (0.9, 0.9)),
)


ROUGH = STRIPS[6]


def ground() -> Ground:
    strips = tuple(s.roughened(np.random.default_rng(0)) for s in STRIPS)
    patches = (
        Patch(1.5, 0.5, 1.3, 1.1, 0.2),
        Patch(6.0, 0.2, 1.7, 3.0, 0.15),
        Patch(-5.0, 1.0, 1.0, 1.4, 0.3),
        Patch(-5.3, 1.3, 1.0, 1.0, 0.1),
    )
    return Ground(0.8, patches, 12.0, strips)


def rays(model: mujoco.MjModel, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height (N,) and friction (N,) of the compiled scene under the points, by casting rays."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    z, mu, geom = np.empty(len(x)), np.empty(len(x)), np.zeros(1, np.int32)
    for k in range(len(x)):
        start = np.array([x[k], y[k], 5.0])
        z[k] = 5.0 - mujoco.mj_ray(model, data, start, [0, 0, -1.0], None, 1, -1, geom, None)
        mu[k] = model.geom_friction[geom[0], 0]
    return z, mu


def test_height_and_friction_are_those_of_the_compiled_scene():
    world, spec = ground(), mujoco.MjSpec()
    add_ground(spec, world)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-10, 10, (2, 20000))
    z, mu = rays(spec.compile(), x, y)
    np.testing.assert_allclose(surfaces(world.height_map, x, y)[0], z, atol=2e-6)
    np.testing.assert_array_equal(world.friction(x, y), mu)


def test_tiles_never_overlap():
    spec = mujoco.MjSpec()
    add_ground(spec, ground())
    model = spec.compile()
    rng = np.random.default_rng(2)
    inside = np.zeros(2000, int)
    x, y = rng.uniform(-10, 10, (2, 2000))
    for geom in range(model.ngeom):
        size = model.geom_size[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_HFIELD:
            half = model.hfield_size[model.geom_dataid[geom]][:2]
        else:
            R = np.empty(9)
            mujoco.mju_quat2Mat(R, model.geom_quat[geom])
            top = model.geom_pos[geom] + R.reshape(3, 3)[:, 2] * size[2]
            half = size[:2] * np.abs(np.diag(R.reshape(3, 3))[:2])
            model.geom_pos[geom] = top
        centre = model.geom_pos[geom]
        inside += (np.abs(x - centre[0]) < half[0]) & (np.abs(y - centre[1]) < half[1])
    assert (inside == 1).all()


@pytest.mark.parametrize("strip", [STRIPS[0], STRIPS[4], ROUGH.roughened(np.random.default_rng(3))])
def test_normal_is_the_derivative_of_the_height(strip):
    height_map = Ground(0.8, (), 12.0, (strip,)).height_map
    x0, x1, y0, y1 = strip.rectangle
    rng = np.random.default_rng(4)
    e = 1e-6
    for x, y in rng.uniform([x0 + 0.1, y0 + 0.1], [x1 - 0.1, y1 - 0.1], (50, 2)):
        slope_x = (height(height_map, x + e, y) - height(height_map, x - e, y)) / (2 * e)
        slope_y = (height(height_map, x, y + e) - height(height_map, x, y - e)) / (2 * e)
        n = np.array(normal(height_map, x, y))
        assert np.linalg.norm(n) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(n, np.array([-slope_x, -slope_y, 1.0]) * n[2], atol=1e-6)


def test_stairs_are_the_same_from_either_end():
    up = Ground(
        0.8, (), 9.0, (Strip((0.0, 0.0), (3.0, 0.0), 2.0, (0.0, 1.2), steps=10),)
    ).height_map
    down = Ground(
        0.8, (), 9.0, (Strip((3.0, 0.0), (0.0, 0.0), 2.0, (1.2, 0.0), steps=10),)
    ).height_map
    for x in np.linspace(-0.5, 3.5, 97):
        assert height(up, x, 0.1) == pytest.approx(height(down, x, 0.1), abs=1e-12)
    assert height(up, 0.01, 0.0) == pytest.approx(0.12)
    assert height(up, 2.99, 0.0) == pytest.approx(1.2)


def test_bumps_are_as_high_as_the_ground_is_rough_and_end_level():
    one = ROUGH.roughened(np.random.default_rng(1)).bumps
    assert one is not None
    assert 0.03 < one.max() <= 0.06
    assert one.min() >= 0.0
    border = np.concatenate([one[0], one[-1], one[:, 0], one[:, -1]])
    assert not border.any()


def test_a_rough_strip_lies_on_its_lattice():
    refused("multiples", Strip, start=(0.05, 0), end=(1, 0), width=1, rough=0.1)


def test_rough_ground_cannot_be_covered_in_part():
    rough = ROUGH.roughened(np.random.default_rng(0))
    over = Strip((-6.0, 1.0), (-5.0, 1.0), 1.0)
    refused("overlap", add_ground, mujoco.MjSpec(), Ground(0.8, (), 12.0, (rough, over)))
