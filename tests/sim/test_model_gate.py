"""The gate before MuJoCo: what a model reads, repeats, nests and unpacks is bounded beforehand."""

import struct

import mujoco
import pytest
import refusals
from written import written

from surefoot.sim.robot.model_gate import POINTS, check_compiled, check_model_file

BASE = '<body name="base"><freejoint/><geom size="0.1" mass="1"/>{}</body>'
ATTACHED = (
    '<mujoco><asset><model name="m" file="{}"/></asset><worldbody>'
    + BASE.format('<attach model="m" body="part" prefix="p"/>')
    + "</worldbody></mujoco>"
)
PART = '<mujoco><worldbody><body name="part">{}</body></worldbody></mujoco>'
PNG = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 20_000, 20_000)


def refusal(path):
    message = refusals.refusal(check_model_file, path)
    assert str(path) in message
    return message


def chain(links):
    """Links of a URDF, each below the one before."""
    joint = '<joint name="j{0}"><parent link="l{0}"/><child link="l{1}"/></joint>'
    return "".join(f'<link name="l{k}"/>{joint.format(k, k + 1)}' for k in range(links))


def model(folder, inside, name="robot.xml"):
    return written(folder / name, f"<mujoco><worldbody>{BASE.format(inside)}</worldbody></mujoco>")


@pytest.mark.parametrize("name", ["part.urdf", "part.xml", "part.txt", "part"])
@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('<include file="../outside/secret.xml"/>', "outside"),
        ('<include file="/etc/passwd"/>', "outside"),
        ('<replicate count="100000000"><geom size="1"/></replicate>', "bodies"),
    ],
)
def test_an_attached_model_is_what_its_root_says(tmp_path, name, content, said):
    (tmp_path / name).write_text(PART.format(content))
    (tmp_path / "robot.xml").write_text(ATTACHED.format(name))
    assert said in refusal(tmp_path / "robot.xml")


def test_an_attached_urdf_reads_no_shape_outside(tmp_path):
    shape = '<visual><geometry><mesh filename="../../secret.stl"/></geometry></visual>'
    (tmp_path / "part.urdf").write_text(f'<robot name="r"><link name="part">{shape}</link></robot>')
    (tmp_path / "robot.xml").write_text(ATTACHED.format("part.urdf"))
    assert "outside" in refusal(tmp_path / "robot.xml")


def test_an_attached_model_that_is_harmless_is_compiled(tmp_path):
    (tmp_path / "part.xml").write_text(PART.format('<geom size="0.1" mass="2"/>'))
    path = written(tmp_path / "robot.xml", ATTACHED.format("part.xml"))
    check_model_file(path)
    compiled = mujoco.MjModel.from_xml_path(str(path))
    check_compiled(path, compiled)
    assert compiled.body_mass.sum() == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("name", "root"), [("robot.urdf", "mujoco"), ("robot.xml", "robot"), ("robot", "robot")]
)
def test_a_name_that_its_root_contradicts_is_refused(tmp_path, name, root):
    path = written(tmp_path / name, f'<{root}><link name="a"/></{root}>')
    assert "URDF" in refusal(path)


@pytest.mark.parametrize(
    "inside",
    [
        '<flexcomp name="f" type="grid" count="20 20 20" spacing="1 1 1" mass="1"/>',
        '<replicate count="9"><flexcomp name="f" type="grid" count="20 10"/></replicate>',
        '<flexcomp name="f" type="direct" point="' + "0 0 1 " * 1001 + '"/>',
        '<flexcomp name="f" type="mesh" file="cloth.obj"/>',
        '<composite type="cable" count="500 1 1" size="10"/>',
    ],
)
def test_flexible_bodies_are_bounded(tmp_path, inside):
    (tmp_path / "cloth.obj").write_text("v 0.123456 0.123456 0.123456\n" * 2000)
    assert refusal(model(tmp_path, inside))


@pytest.mark.parametrize(
    ("name", "content", "refused"),
    [
        ("m.obj", b"v 0.1 0.2 0.3\n" * (POINTS + 1), True),
        ("m.OBJ", b"v\t1\t2\t3\n" * (POINTS + 1), True),
        ("obj.stl", b"v 0.1 0.2 0.3\n" * (POINTS + 1), True),
        ("m.msh", struct.pack("<4i", POINTS + 1, 0, 0, 0) + bytes(12 * (POINTS + 1)), True),
        ("m.stl", bytes(80) + struct.pack("<I", 200_000) + bytes(50 * 200_000), False),
        ("text.stl", b"vertex 0.1 0.2 0.3\n" * 200_000, False),
        ("n.obj", b"v 0.1 0.2 0.3\nvn 0 0 1\nvt 0 1\n" * 100_000, False),
        ("n.msh", struct.pack("<4i", POINTS, 0, 0, 0) + bytes(12 * POINTS), False),
    ],
)
def test_the_points_of_a_mesh_are_counted(tmp_path, name, content, refused):
    (tmp_path / name).write_bytes(content)
    path = tmp_path / "robot.xml"
    path.write_text(f'<mujoco><asset><mesh name="m" file="{name}"/></asset></mujoco>')
    if refused:
        assert "points" in refusal(path)
    else:
        check_model_file(path)


def test_a_small_cloth_is_none_of_its_business(tmp_path):
    check_model_file(model(tmp_path, '<flexcomp name="f" type="grid" count="9 9 9" mass="1"/>'))


def test_a_long_chain_of_links_is_refused(tmp_path):
    assert "deeper" in refusal(
        written(tmp_path / "a.urdf", f'<robot name="r">{chain(199)}</robot>')
    )
    check_model_file(written(tmp_path / "b.urdf", f'<robot name="r">{chain(90)}</robot>'))


def test_elements_are_counted_through_includes(tmp_path):
    for k in range(3):
        name = f"<include file='{k + 1}.xml'/>" if k < 2 else "<geom/>"
        text = f"{'<body>' * 40}{name}{'</body>' * 40}"
        (tmp_path / f"{k}.xml").write_text(f"<mujoco>{text}</mujoco>")
    assert "deeper" in refusal(tmp_path / "0.xml")


@pytest.mark.parametrize("element", ["texture", "hfield"])
def test_a_picture_is_measured_before_it_is_unpacked(tmp_path, element):
    (tmp_path / "big.png").write_bytes(PNG)
    path = tmp_path / "robot.xml"
    path.write_text(f'<mujoco><asset><{element} name="x" file="big.png"/></asset></mujoco>')
    assert "pixels" in refusal(path)


@pytest.mark.parametrize(
    ("element", "said"),
    [
        ('<sensor><user dim="2000000000"/></sensor>', "user"),
        ('<sensor><contact geom1="g" num="1000000000"/></sensor>', "contact"),
        ('<sensor><jointpos joint="j" nsample="90000000"/></sensor>', "jointpos"),
        ('<actuator><general joint="j" actdim="2000000000"/></actuator>', "general"),
        ('<asset><mesh name="m" builtin="plate" params="9000 2"/></asset>', "mesh"),
        ('<asset><texture type="cube" builtin="flat" width="9000"/></asset>', "texture"),
        ('<asset><texture builtin="flat" width="2500" height="2500"/></asset>' * 2, "texture"),
        ('<asset><hfield nrow="2500" ncol="2500"/></asset>' * 2, "hfield"),
        ('<sensor><plugin><config key="size" value="9000 9000"/></plugin></sensor>', "config"),
        ('<size njmax="900000000"/>', "njmax"),
        ('<size nuser_geom="99999"/>' + "<geom/>" * 100, "nuser"),
        ('<size nkey="99999"/>' + "<geom/>" * 100, "nkey"),
        ("<keyframe>" + "<key/>" * 9999 + "</keyframe>", "nkey"),
        ('<deformable><flex vertex="' + "0 0 1 " * 1001 + '"/></deformable>', "points"),
        ('<composite type="cable" vertex="' + "0 0 1 " * 200 + '"/>', "composite"),
    ],
)
def test_what_an_element_asks_for_is_bounded(tmp_path, element, said):
    assert said in refusal(written(tmp_path / "robot.xml", f"<mujoco>{element}</mujoco>"))


def test_a_model_counts_as_often_as_it_is_attached(tmp_path):
    many = "".join(f'<attach model="m" body="part" prefix="{k}"/>' for k in range(40))
    for k in range(2):
        asset = f'<asset><model name="m" file="{k + 1}.xml"/></asset>'
        text = f'{asset}<worldbody><body name="part">{many}</body></worldbody>'
        (tmp_path / f"{k}.xml").write_text(f"<mujoco>{text}</mujoco>")
    (tmp_path / "2.xml").write_text(PART.format("<geom/>" * 9))
    assert "bodies" in refusal(tmp_path / "0.xml")
    check_model_file(tmp_path / "1.xml")


def test_the_scanned_file_is_the_one_that_is_included(tmp_path):
    """MuJoCo takes it from the model's folder, if it is there, before the including file's."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "part.xml").write_text("<mujoco/>")
    (tmp_path / "sub" / "first.xml").write_text('<mujoco><include file="part.xml"/></mujoco>')
    path = written(tmp_path / "robot.xml", '<mujoco><include file="sub/first.xml"/></mujoco>')
    check_model_file(path)
    (tmp_path / "part.xml").write_text('<mujoco><include file="/etc/passwd"/></mujoco>')
    assert "outside" in refusal(path)


@pytest.mark.parametrize(
    "include",
    [
        '<mujoco><include file="..\\outside\\part.xml"/></mujoco>',
        '<mujoco xmlns="any"><include file="../outside/part.xml"/></mujoco>',
        '<mujoco><include file="link/../part.xml"/></mujoco>',
        '<mujoco><asset><model file="..\\outside\\part.xml"/></asset></mujoco>',
        '<mujoco><compiler meshdir="..\\..\\.."/><asset><mesh file="m.stl"/></asset></mujoco>',
    ],
)
def test_a_path_is_read_as_mujoco_reads_it(tmp_path, include):
    folder = tmp_path / "robot"
    (folder / "sub" / "deep").mkdir(parents=True)
    (folder / "link").symlink_to("sub/deep")
    (folder / "part.xml").write_text("<mujoco/>")
    (folder / "robot.xml").write_text(include)
    assert "outside" in refusal(folder / "robot.xml")


def test_a_root_in_capitals_is_a_urdf(tmp_path):
    (tmp_path / "part").write_text(f"<ROBOT>{chain(199)}</ROBOT>")
    (tmp_path / "robot.xml").write_text(ATTACHED.format("part"))
    assert "deeper" in refusal(tmp_path / "robot.xml")
