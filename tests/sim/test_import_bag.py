"""Importing bags: the same readings in ROS 1, ROS 2 and MCAP, by construction; one line a fault."""

from pathlib import Path

import numpy as np
import pytest
from bags import EPOCH, IMU, Maker, write_bag
from recorded import imported
from refusals import refusal

from surefoot.scenarios.cli.main import main
from surefoot.sim.importing.readers.bag import read_bag
from surefoot.sim.log import LEGS

THEIRS = {
    "t": "/imu:header.stamp",
    **{f"gyro_{a}": f"/imu:angular_velocity.{a}" for a in "yz"},
    **{f"accel_{a}": f"/imu:linear_acceleration.{a}" for a in "xyz"},
    "q_knee": "/joints:position[knee]",
    "dq_knee": "/joints:velocity[1]",
    **{f"contact_{leg}": "/joints:effort[0]" for leg in LEGS},
}
POSES = {
    "t": "/mocap:received",
    **{f"ref_p_{a}": f"/mocap:pose.position.{a}" for a in "xyz"},
    **{f"ref_q_{a}": f"/mocap:pose.orientation.{a}" for a in "wxyz"},
}
ENTRIES, REFERENCE = (
    "".join(f'{ours} = "{theirs}"\n' for ours, theirs in columns.items())
    for columns in (THEIRS, POSES)
)
MAP = f"""[columns]
gyro_x = {{ column = "/imu:angular_velocity.x", unit = "deg/s" }}
{ENTRIES}[reference]
[reference.columns]
{REFERENCE}[robot]
name = "ak80_pendulum"
"""
JOINTS, POSE, FRAMES = (
    "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"
)  # fmt: skip


def imu(make: Maker):
    """At 200 Hz for a second, received 0.7 ms late."""
    for k in range(200):
        ns = EPOCH + 5_000_000 * k
        yield "/imu", IMU, ns + 700_000, make.imu(ns, (180.0, 0.1, 1e-3 * k), (0.0, 0.0, 9.81))


def messages(make: Maker):
    """The IMU, joints at 100 Hz 2 ms off, poses."""
    for k, one in enumerate(imu(make)):
        yield one
        ns = EPOCH + 5_000_000 * k
        at = 5e-3 * k + 2e-3
        if k % 2 == 0:
            joints = make.types[JOINTS](
                make.header(ns + 2_000_000), ["hip", "knee"], np.array([9.0, 2.0 * at]),
                np.array([9.0, 2.0]), np.array([float(at > 0.5), 0.0]),
            )  # fmt: skip
            yield "/joints", JOINTS, ns + 2_100_000, joints
        if k % 4 == 0:
            point = make.types["geometry_msgs/msg/Point"](x=3.0 * 5e-3 * k, y=0.0, z=0.5)
            pose = make.types["geometry_msgs/msg/Pose"](point, make.upright)
            yield "/mocap", POSE, ns + 1_000, make.types[POSE](make.header(0), pose)


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_every_kind_of_bag_gives_the_readings_that_went_in(tmp_path, kind):
    log = imported(write_bag(tmp_path / "run", kind, messages), MAP)
    # From the second IMU sample, the first after a joint reading, to the last pose.
    assert log.t[0] == pytest.approx(0.005 - 1e-6, abs=2e-6)
    np.testing.assert_allclose(np.diff(log.t), 0.005, atol=1e-9)
    assert log.rate == pytest.approx(200.0)
    np.testing.assert_allclose(log.gyro[:, 0], np.pi)
    np.testing.assert_allclose(log.frame["q_knee"], 2.0 * log.t, atol=3e-6)
    np.testing.assert_allclose(log.frame["dq_knee"], 2.0)
    np.testing.assert_allclose(log.ref_p[:, 0], 3.0 * log.t, atol=1e-5)
    # A contact is what was last said, not what lies between two messages.
    joints_at = 0.01 * np.floor((log.t - 0.002 + 1e-6) / 0.01) + 0.002
    np.testing.assert_array_equal(log.contact[:, 0], joints_at > 0.5)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("/joints:position[knee]", "/legs:position[knee]", "no topic '/legs' (there are /imu"),
        ("/joints:position[knee]", "/joints:position[ankle]", "the messages have no such field"),
        ("/joints:position[knee]", "/joints:position[7]", "the messages have no such field"),
        ("/joints:position[knee]", "/joints:position", "is not a number"),
        ("/joints:position[knee]", "position", "topic:field.path"),
        ("/joints:position[knee]", "/joints:a b", "cannot read the path"),
        ("[reference]\n", '[reference]\nfile = "x.csv"\n', "x.csv: No such file"),
        ("[columns]\n", "[source]\nrate = 100\n[columns]\n", "must be given, and not both"),
        ("ref_q_z = ", 'ref_q_z = "/imu:orientation.z" #', "are of /imu and /mocap"),
        ("/mocap:received", "/mocap:header.stamp", "message 2: repeats the stamp"),
    ],
)
def test_a_fault_is_one_line_that_names_it(tmp_path, old, new, said):
    bag = write_bag(tmp_path / "run", "sqlite3", messages)
    assert said in refusal(imported, bag, MAP.replace(old, new))


def test_all_of_a_bag_is_what_is_read_of_each_column(tmp_path):
    path = write_bag(tmp_path / "run", "sqlite3", messages)
    found, topics = read_bag(path), {"/imu", "/joints", "/mocap"}
    assert {found.topic(one) for one in found.cells} == {*found.stamps} == topics
    again = read_bag(path, [*found.cells])
    for name, values in {**again.cells, **again.stamps}.items():
        np.testing.assert_array_equal(values, {**found.cells, **found.stamps}[name])


def frames(make: Maker):
    """The IMU, and frames at 50 Hz: a walking body, a camera and a foot of it, and a slowly
    corrected map.
    """
    yield from imu(make)
    for k in range(50):
        ns = EPOCH + 20_000_000 * k

        def transform(parent: str, child: str, x: float, ns=ns):
            turned = make.types["geometry_msgs/msg/Transform"](
                make.vector(x, 0.0, 0.0), make.upright
            )
            stamped = make.types["geometry_msgs/msg/TransformStamped"]
            return stamped(make.header(ns, parent), child, turned)

        every = [transform("map", "odom", 1e-3 * k)] if k % 5 == 0 else []
        every += [transform("base", "camera", 0.3), transform("base", "FL_foot", -0.2)]
        every += [transform("odom", "base", 0.02 * k)]
        yield "/tf", FRAMES, ns + 300_000, make.types[FRAMES](every)


def test_a_frame_of_tf_has_its_own_messages(tmp_path):
    name = "/tf[odom->base]:transform.translation.x"
    slow = "/tf[map->odom]:transform.translation.x"
    found = read_bag(write_bag(tmp_path / "run", "mcap", frames), [name, slow])
    t = found.stamps[found.topic(name)]
    np.testing.assert_allclose(np.diff(t), 0.02, atol=1e-9)  # those of its own header
    np.testing.assert_allclose(found.cells[name], 0.02 * np.arange(50))
    assert len(found.cells[slow]) == 10


def test_the_frame_that_moves_most_is_drafted_as_the_reference(tmp_path, capsys):
    path = write_bag(tmp_path / "run", "mcap", frames)
    main(["import", str(path), "--guess"])
    said = capsys.readouterr().out
    assert '\nref_p_x = { column = "/tf[odom->base]:transform.translation.x", unit = "m" }' in said
    assert '\nt = { column = "/tf[odom->base]:header.stamp", unit = "s" }' in said
    assert "FL_foot" not in said.partition("# not used")[0]
    unused = [line for line in said.splitlines() if line.startswith("# not used")]
    assert any("does not move" in line and "/tf[base->" in line for line in unused)


@pytest.mark.parametrize("topic", ["/tf[world->base]", "/tf"])
def test_a_frame_that_is_not_there_is_named_with_those_that_are(tmp_path, topic):
    path = write_bag(tmp_path / "run", "mcap", frames)
    caught = refusal(read_bag, path, [f"{topic}:transform.translation.x"])
    assert topic in caught
    assert "/tf[odom->base]" in caught or topic == "/tf"


@pytest.mark.parametrize("name", ["run", "bag"])
def test_topics_of_different_rates_are_drafted_together(tmp_path, monkeypatch, capsys, name):
    """`import bag --guess` too, where "bag" is no kind of file but its name."""
    monkeypatch.chdir(tmp_path)
    write_bag(Path(name), "mcap", messages)
    main(["import", name, "--guess"])
    said = capsys.readouterr().out
    for line in (
        't = { column = "/imu:header.stamp", unit = "s" }',
        'q_knee = { column = "/joints:position[knee]", unit = "rad" }',
        'dq_knee = { column = "/joints:velocity[knee]", unit = "rad/s" }',
        't = { column = "/mocap:received", unit = "s" }',
        'ref_p_x = { column = "/mocap:pose.position.x", unit = "m" }',
    ):
        assert f"\n{line}" in said
