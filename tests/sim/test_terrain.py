"""The ground the controller and the truth know is the ground MuJoCo collides with, drawn by strips
or by a file of the user's own."""

import struct
import zlib
from dataclasses import replace

import mujoco
import numpy as np
import pandas as pd
import pytest
from ground_course import surfaces
from refusals import refusal, refused
from scipy.interpolate import RegularGridInterpolator

from surefoot.sim.ground.ground_metadata import MOST_POINTS, ground_metadata, ground_of_log, thinned
from surefoot.sim.ground.height_map import height, normal
from surefoot.sim.ground.terrain import Ground, HeightField, Patch, Strip
from surefoot.sim.ground.tiles import add_ground
from surefoot.sim.log import Log, Meta
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, drawn
from surefoot.sim.scenario_catalog import bundled_scenarios
from surefoot.sim.similar_course import course_for
from surefoot.sim.walk import plan, walk

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
    ends = (0.0, 0.0), (3.0, 0.0), 2.0, (0.0, 1.2)
    back = (3.0, 0.0), (0.0, 0.0), 2.0, (1.2, 0.0)
    up, down = (Ground(0.8, strips=(Strip(*e, steps=10),)).height_map for e in (ends, back))
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


def test_what_is_given_by_heights_cannot_be_covered_in_part():
    rough, over = ROUGH.roughened(np.random.default_rng(0)), Strip((-6.0, 1.0), (-5.0, 1.0), 1.0)
    field = HeightField((0.0, 1.0, 0.0, 1.0), np.zeros((3, 3)))
    fields = Ground(0.8, fields=(field, replace(field, mu=0.3)))
    for covered in (Ground(0.8, strips=(rough, over)), fields):
        refused("overlap", add_ground, mujoco.MjSpec(), covered)


X, Y = np.linspace(-1.0, 4.0, 26), np.linspace(-1.5, 1.5, 13)
HILLS = 0.06 * np.outer(np.cos(3.0 * Y), 1.0 - np.cos(1.5 * (X + 1.0)))  # rows along y
SPOT = Robot.load("spot_class")


def scenario(tmp_path, entry: str, rest: str = "", name: str = "own.toml") -> Scenario:
    path = tmp_path / name
    path.write_text(
        'robot = "spot_class"\nstand = 0.2\nsegment = [{duration = 3.0, forward = 0.5}]\n'
        f"[[ground.height_field]]\n{entry}\n{rest}"
    )
    return Scenario.load(path)


def grid(tmp_path, rest: str = "") -> Scenario:
    np.save(tmp_path / "hills.npy", HILLS)
    entry = 'file = "hills.npy"\ncenter = [1.5, 0.0]\nsize = [5.0, 3.0]'
    return scenario(tmp_path, entry, rest)


def png(levels: np.ndarray, size: tuple[int, int] | None = None) -> bytes:
    """A grey picture, written by hand: its first row is the upper one.

    size: rows and columns by its head, if others.
    """
    high, wide = size or levels.shape
    bits = 8 * levels.itemsize
    rows = b"".join(b"\0" + row.astype(f">u{levels.itemsize}").tobytes() for row in levels)

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    head = struct.pack(">IIBBBBB", wide, high, bits, 0, 0, 0, 0)
    parts = chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(rows)), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def test_heights_are_the_files_and_those_that_mujoco_collides_with(tmp_path):
    patch = "[[ground.patch]]\ncenter = [1.0, 0.33]\nsize = [0.7, 0.9]\nmu = 0.2"
    made = drawn(grid(tmp_path, patch), np.random.default_rng(0)).scenario.ground
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-3.0, 5.0, 4000), rng.uniform(-3.0, 3.0, 4000)
    spec = mujoco.MjSpec()
    add_ground(spec, made)
    z, mu = rays(spec.compile(), x, y)
    found, normals = surfaces(made.height_map, x, y)
    np.testing.assert_allclose(found, z, atol=2e-6)
    np.testing.assert_array_equal(made.friction(x, y), mu)
    assert set(mu) == {0.8, 0.2}
    # The file's own points exactly, and between them as far as two triangles bend from a cell.
    at = np.meshgrid(X, Y)
    own = surfaces(made.height_map, *(part.ravel() for part in at))[0]
    np.testing.assert_allclose(own, HILLS.ravel(), atol=1e-12)
    inside = (abs(x - 1.5) < 2.5) & (abs(y) < 1.5)
    between = RegularGridInterpolator((Y, X), HILLS)(np.column_stack([y, x])[inside])
    np.testing.assert_allclose(found[inside], between, atol=0.005)
    assert (found[~inside] == 0.0).all()
    assert (normals[inside, 2] < 1.0).any()


def test_every_grid_gives_the_same_ground(tmp_path):
    size = "center = [1.5, 0.0]\nsize = [5.0, 3.0]"
    (same,) = grid(tmp_path).ground.fields
    np.savetxt(tmp_path / "hills.csv", HILLS, delimiter=",", fmt="%.17g")
    (table,) = scenario(tmp_path, f'file = "hills.csv"\n{size}').ground.fields
    assert table == same
    head = struct.pack("<ii", *HILLS.shape)
    (tmp_path / "hills.hf").write_bytes(head + HILLS.astype("<f4").tobytes())
    (field,) = scenario(tmp_path, f'file = "hills.hf"\n{size}').ground.fields
    np.testing.assert_allclose(field.heights, same.heights, atol=1e-8)
    low, high = HILLS.min(), HILLS.max()
    for kind, atol in (("u1", 5e-4), ("u2", 2e-6)):
        levels = np.round((HILLS - low) / (high - low) * np.iinfo(kind).max).astype(kind)
        (tmp_path / "hills.png").write_bytes(png(levels[::-1]))
        entry = f'file = "hills.png"\nheights = [{low}, {high}]\n{size}'
        (picture,) = scenario(tmp_path, entry).ground.fields
        np.testing.assert_allclose(picture.heights, same.heights, atol=atol)


def obj(path) -> None:
    """A pyramid of height 0.4 on a square of side 2, with a polygon, a texture's index and an
    index from the end."""
    corners = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (0, 0, 0.4)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += ["f 4 3 2 1", "f 1/7 2/7 5/7", "f 2 3 -1", "f 3 4 5", "f 4 1 5"]
    path.write_text("\n".join(lines))


def test_a_mesh_is_its_upper_surface(tmp_path):
    obj(tmp_path / "tent.obj")
    entry = 'file = "tent.obj"\ncenter = [2.0, 0.5]\nspacing = 0.1\nmu = 0.5'
    made = scenario(tmp_path, entry).ground
    assert made.fields[0].rectangle == (1.0, 3.0, -0.5, 1.5)
    x, y = np.random.default_rng(0).uniform([0.5, -1.0], [3.5, 2.0], (500, 2)).T
    tent = 0.4 * np.clip(1.0 - np.maximum(abs(x - 2.0), abs(y - 0.5)), 0.0, None)
    # Two ridges of the four run across the diagonals of the cells, half a rise off at most.
    np.testing.assert_allclose(surfaces(made.height_map, x, y)[0], tent, atol=0.0201)
    nodes = np.abs(np.linspace(-1.0, 1.0, 21))
    own = 0.4 * (1.0 - np.maximum(nodes[:, None], nodes))
    np.testing.assert_allclose(made.fields[0].heights, own, atol=1e-12)
    assert made.friction(np.array([2.0]), np.array([0.5])) == 0.5


def test_an_stl_of_either_kind_is_the_same_mesh(tmp_path):
    facets = np.array([[[0, 0, 0], [2, 0, 0], [2, 1, 0.2]], [[0, 0, 0], [2, 1, 0.2], [0, 1, 0.2]]])
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *facet.ravel(), 0) for facet in facets)
    (tmp_path / "a.stl").write_bytes(b"solid".ljust(80) + struct.pack("<I", 2) + body)
    text = "".join(f"vertex {x} {y} {z}\n" for x, y, z in facets.reshape(-1, 3))
    (tmp_path / "b.stl").write_text("solid ramp\n" + text + "endsolid")
    binary, written = (scenario(tmp_path, f'file = "{n}.stl"').ground.fields[0] for n in "ab")
    np.testing.assert_allclose(binary.heights, written.heights, atol=1e-8)
    np.testing.assert_allclose(written.heights, 0.2 * np.linspace(0, 1, 21)[None].repeat(41, 0))


def test_a_robot_walks_over_it_and_its_log_keeps_the_ground(tmp_path):
    made = plan(grid(tmp_path), SPOT, 0)
    log = walk(made.scenario, SPOT, 0)
    assert log.ref_p[-1, 0] > 1.0  # it walked on
    feet = log.ref_p[:, None] + np.einsum("nij,nlj->nli", log.ref_R_GI, SPOT.feet_I(log.q))
    stands = log.contact & (log.force > 100.0)
    x, y, sole = (feet[..., a][stands] for a in range(3))
    z, normal = surfaces(made.ground.height_map, x, y)
    above = (sole - z) * normal[:, 2] - SPOT.foot_radius[0]
    assert np.ptp(z) > 0.05
    assert abs(np.median(above)) < 0.002
    assert np.percentile(abs(above), 95) < 0.006
    assert np.median(log.slip[stands]) < 0.02
    # Its drawing needs no file.
    (tmp_path / "hills.npy").unlink()
    log.write(tmp_path / "log.parquet")
    kept = ground_of_log(Log.read(tmp_path / "log.parquet"))
    assert kept is not None
    np.testing.assert_allclose(kept.fields[0].heights, HILLS.T, atol=2e-6)
    assert replace(kept, fields=()) == replace(made.ground, fields=())


def test_other_heights_are_another_scenario(tmp_path):
    one = grid(tmp_path)
    assert one == grid(tmp_path)
    np.save(tmp_path / "hills.npy", HILLS + 1e-6)
    other = Scenario.load(tmp_path / "own.toml")
    assert one != other
    assert repr(one) != repr(other)


def test_many_points_are_drawn_by_fewer():
    x, y = np.meshgrid(np.linspace(0, 3, 901), np.linspace(0, 2, 701), indexing="ij")
    field = HeightField((0.0, 9.0, 0.0, 7.0), 0.1 * np.sin(x) * y)
    (fewer,) = thinned(Ground(0.8, fields=(field,))).fields
    assert fewer.heights.size <= MOST_POINTS
    at = np.random.default_rng(0).uniform([0.1, 0.1], [8.9, 6.9], (200, 2)).T
    z, own = (surfaces(Ground(0.8, fields=(f,)).height_map, *at)[0] for f in (fewer, field))
    np.testing.assert_allclose(z, own, atol=1e-4)
    assert len(ground_metadata(Ground(0.8, fields=(field,)))["ground"]["fields"][0]["levels"]) < 1e6


def test_a_course_of_another_robot_keeps_its_hills_slopes(tmp_path):
    legs = SPOT.legs._replace(offset=0.5 * SPOT.legs.offset, foot=0.5 * SPOT.legs.foot)
    small = replace(SPOT, name="small", file=tmp_path / "small.xml", legs=legs)
    (field,) = course_for(grid(tmp_path), small).ground.fields
    np.testing.assert_allclose(field.heights, 0.5 * HILLS.T)
    assert field.rectangle == (-0.5, 2.0, -0.8, 0.8)


SIZE = "size = [1.0, 1.0]"


@pytest.mark.parametrize(
    ("name", "content", "more", "words"),
    [
        ("a.tif", b"", SIZE, "is none of .png, .npy"),
        ("a.npy", b"not numpy", SIZE, "file 'a.npy'"),
        ("a.npy", b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': "
         b"(1000000, 1000000), }".ljust(129), SIZE, "file 'a.npy'"),
        ("a.csv", b"1,2\n3\n", SIZE, "file 'a.csv'"),
        ("a.csv", b"1,2\n3,nan\n", SIZE, "not a finite number"),
        ("a.csv", b"1,2\n", SIZE, "2 x 2 points"),
        ("a.csv", b"1,2\n3,4e9\n", SIZE, "heights must not exceed"),
        ("a.csv", b"1,2\n3,4\n", "", "needs size"),
        ("a.csv", b"1,2\n3,4\n", "size = [0.001, 0.001]", "apart"),
        ("a.hf", struct.pack("<iif", 9999, 9999, 0.0), SIZE, "not as long"),
        ("a.png", b"\x89PNG\r\n\x1a\n", SIZE, "file 'a.png'"),
        ("a.png", png(np.zeros((3, 3), np.uint8)), SIZE, "needs heights"),
        ("a.png", png(np.zeros((3, 3), np.uint8), (10_000, 10_000)), SIZE, "pixels"),
        ("a.obj", b"v 0 0 0\n", "", "no faces"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n", "", "names a vertex"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n", "", "no surface"),
        ("a.obj", b"v 0 0 0\nv 1e9 0 0\nv 0 1e9 1\nf 1 2 3\n", "", "points: "),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 x\nf 1 2 3\n", "", "file 'a.obj'"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 1\nf 1 2 3\n", SIZE, "leave them out"),
        ("a.stl", b"solid\nvertex 1 2 3\n", "", "is no STL"),
    ],
)  # fmt: skip
def test_a_bad_file_is_one_line(tmp_path, name, content, more, words):
    folder = tmp_path / "inner"
    folder.mkdir()
    if content is not None:
        (folder / name).write_bytes(content)
    message = refusal(scenario, folder, f'file = "{name}"\n{more}')
    assert words in message
    assert "own.toml: [[ground.height_field]] 1 " in message


def test_a_kept_ground_that_is_damaged_is_one_line(tmp_path):
    log = walk(replace(grid(tmp_path), segments=grid(tmp_path).segments[:1]), SPOT, 0)
    kept = dict(log.meta.model["ground"])
    rough = {"start": [0, 0], "end": [1, 0], "width": 1.0, "rough": 0.1}  # without its bumps
    fields = {"levels": "AAAA"}, {"shape": [1, 9]}, {"shape": [10**6, 10**6]}, {"range": [0]}
    damages = [{"fields": [kept["fields"][0] | field]} for field in fields]
    for damage in (*damages, {"strips": [rough]}):
        damaged = kept | damage
        meta = replace(log.meta, model={"ground": damaged})
        refused("metadata", ground_of_log, replace(log, meta=meta))


def test_a_patch_that_slips_follows_the_fields_lattice(tmp_path):
    rest = "[[ground.patch]]\ncenter = [1.03, 0.3]\nsize = [0.7, 0.9]\nmu = 0.2"
    (patch,) = drawn(grid(tmp_path, rest), np.random.default_rng(0)).scenario.ground.patches
    assert patch.rectangle == pytest.approx((0.6, 1.4, -0.25, 0.75))
    far = Patch(-5.0, 0.03, 0.7, 0.9, 0.2)
    assert far.snapped(grid(tmp_path).ground.fields[0]) != far


def test_a_log_keeps_the_ground_of_any_bundled_course():
    for name in bundled_scenarios():
        scenario = Scenario.load(name)
        ground = drawn(scenario, np.random.default_rng(0)).scenario.ground
        log = Log(pd.DataFrame({"t": [0.0, 1.0]}), Meta(1.0, model=ground_metadata(ground)))
        kept = ground_of_log(log)
        assert kept is not None
        assert kept.patches == ground.patches
        (x, y), half = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 500)), ground.half_size
        there = surfaces(ground.height_map, half * x, half * y)[0]
        found = surfaces(kept.height_map, half * x, half * y)[0]
        assert np.quantile(np.abs(found - there), 0.98) < 1e-5, name
