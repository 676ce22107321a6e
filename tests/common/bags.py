"""Bags that a test writes, of each kind."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

IMU = "sensor_msgs/msg/Imu"
EPOCH = 1_700_000_000_123_456_789
"""When bags begin [ns]."""


@dataclass(frozen=True)
class Maker:
    """Makes messages of ROS 1 or ROS 2; times are in ns."""

    types: Any
    ros1: bool

    def header(self, ns: int, frame: str = "") -> Any:
        stamp = self.types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        seq = {"seq": 0} if self.ros1 else {}
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **seq)

    def vector(self, x: float, y: float, z: float) -> Any:
        return self.types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)

    @property
    def upright(self) -> Any:
        return self.types["geometry_msgs/msg/Quaternion"](w=1.0, x=0.0, y=0.0, z=0.0)

    def imu(self, ns: int, rate: tuple, force: tuple) -> Any:
        zeros, gyro, accel = np.zeros(9), self.vector(*rate), self.vector(*force)
        return self.types[IMU](self.header(ns), self.upright, zeros, gyro, zeros, accel, zeros)


def write_bag(
    path: Path, kind: str, messages: Callable[[Maker], Iterable[tuple[str, str, int, Any]]]
) -> Path:
    """A bag of these messages, each with its topic, its type and the time received [ns]; `kind` is
    ros1, whose bags are files, sqlite3 or mcap.
    """
    ros1 = kind == "ros1"
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        path = path.with_suffix(".bag")
        writer, encode = Writer1(path), types.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer, encode = Writer2(path, version=9, storage_plugin=plugin), types.serialize_cdr
    topics = {}
    with writer:
        for topic, of_type, received, message in messages(Maker(types.types, ros1)):
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, of_type, typestore=types)
            writer.write(topics[topic], received, encode(message, of_type))
    return path
