"""The example of a ROS 2 node, without ROS: a recorded bag is played through its callbacks."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bags import EPOCH, IMU, Maker, write_bag
from numpy.testing import assert_allclose
from refusals import refused
from rosbags.highlevel import AnyReader
from synthetic import without

import surefoot

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"
sys.path.insert(0, str(EXAMPLES))

import ros2_node  # noqa: E402

JOINTS, ARRAY = "sensor_msgs/msg/JointState", "std_msgs/msg/UInt8MultiArray"
ROBOT = surefoot.Robot.load("spot_class")


@pytest.fixture(scope="module")
def log(log):
    return without(log.rows(slice(0, 2000)), "ref_")


@pytest.fixture(scope="module")
def bag(log, tmp_path_factory) -> Path:
    """The log as a robot records it, joints in an order of their own."""
    order = np.random.default_rng(0).permutation(12)
    names = [ROBOT.joint_names[j] for j in order]

    def messages(make: Maker):
        layout = make.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        for k, t in enumerate(log.t):
            ns = EPOCH + round(1e9 * t)
            joints = (x[k][order] for x in (log.q, log.dq, log.tau))
            joints = make.types[JOINTS](make.header(ns), names, *joints)
            yield "/joint_states", JOINTS, ns, joints
            yield "/contacts", ARRAY, ns, make.types[ARRAY](layout, log.contact[k].astype(np.uint8))
            yield "/imu", IMU, ns, make.imu(ns, log.gyro[k], log.accel[k])

    return write_bag(tmp_path_factory.mktemp("ros") / "walk", "mcap", messages)


def played(bag: Path, node: ros2_node.Estimation):
    callbacks = {
        "/imu": node.on_imu,
        "/joint_states": node.on_joints,
        "/contacts": node.on_contacts,
    }
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            state = callbacks[connection.topic](message)
            if connection.topic == "/imu" and state is not None:
                yield state


def test_a_bag_played_through_the_node_gives_the_estimate_of_the_log(log, bag):
    node = ros2_node.Estimation(surefoot.StreamingEstimator("leg", ROBOT), ROBOT)
    states = list(played(bag, node))
    whole = surefoot.run_filter("leg", log, ROBOT).trajectory
    times = log.t[log.t > log.t[0] + 0.5]
    assert len(states) == len(times)
    last = states[np.searchsorted(times, whole.t[-1])]
    assert_allclose(last.p_GI, whole.p_GI[-1], atol=1e-6)
    assert_allclose(last.R_GI, whole.R_GI[-1], atol=1e-6)
    assert np.linalg.norm(states[-1].p_GI) > 0.5  # it walked


def test_the_odometry_is_pose_in_the_world_and_velocity_in_the_imu(log, bag):
    node = ros2_node.Estimation(surefoot.StreamingEstimator("leg", ROBOT), ROBOT)
    *_, state = played(bag, node)
    empty = SimpleNamespace(
        pose=SimpleNamespace(
            pose=SimpleNamespace(position=SimpleNamespace(), orientation=SimpleNamespace())
        ),
        twist=SimpleNamespace(twist=SimpleNamespace(linear=SimpleNamespace())),
    )
    odometry = ros2_node.fill(empty, state)
    turn, speed = odometry.pose.pose.orientation, odometry.twist.twist.linear
    assert turn.w**2 + turn.x**2 + turn.y**2 + turn.z**2 == pytest.approx(1.0)
    assert_allclose(state.R_GI @ [speed.x, speed.y, speed.z], state.v_GI)


def test_a_joint_that_is_not_published_is_named():
    node = ros2_node.Estimation(surefoot.StreamingEstimator("leg", ROBOT), ROBOT)
    message = SimpleNamespace(name=["a"], position=[0.0], velocity=[], effort=[])
    refused("joint_states lacks", node.on_joints, message, error=ValueError)
