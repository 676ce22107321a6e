"""Export of logs and estimates: TUM and CSV, and MCAP for Foxglove, PlotJuggler or ROS 2; and of
observers in the format of an earlier surefoot.

In an MCAP file the IMU and the joints are ROS 2 messages, poses are Foxglove's PoseInFrame and
FrameTransform as in its package foxglove_msgs for ROS 2. The file includes their definitions, so
that it can be read without these packages.
"""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from surefoot.estimator.evaluation.trajectory import Trajectory, TrajectoryError, reference
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import whole_file
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.log import Log

_FOXGLOVE = {
    "foxglove_msgs/msg/PoseInFrame": (
        "builtin_interfaces/Time timestamp\nstring frame_id\ngeometry_msgs/Pose pose\n"
    ),
    "foxglove_msgs/msg/FrameTransform": (
        "builtin_interfaces/Time timestamp\nstring parent_frame_id\nstring child_frame_id\n"
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
    ),
}
WORLD, BODY = "world", "imu"
"""Frames G and I in an MCAP file."""
FORMATS = (".tum", ".csv", ".mcap", ".safetensors")
_UNKNOWN = -1.0
"""First element of a ROS covariance of an unmeasured quantity (sensor_msgs/Imu)."""
Messages = Iterator[tuple[str, float, Any]]
"""Topic, time [s] and message."""


def export(file: str | Path, out: str | Path, force: bool = False) -> str:
    """Write a log or an estimate as TUM (poses; of a log, its reference), CSV or MCAP, or convert
    an observer of an earlier surefoot, by the suffix of `out`.

    Returns a message for the user. Raises SurefootError, in one line.
    """
    file, out = Path(file), Path(out)
    if out.suffix not in FORMATS:
        raise SurefootError(f"{out}: give a file ending in {' or '.join(FORMATS)}")
    if out.suffix == ".safetensors":
        from surefoot.models.observer.observer import observer_of_torch

        observer = observer_of_torch(file)
        observer.save(out, force)
        return f"{out}: the observer {observer.hash[:12]} of {observer.robot}"
    kept = _read(file)
    if out.suffix == ".tum":
        poses = reference(kept) if isinstance(kept, Log) else kept
        poses.write_tum(out, force)
        return f"{out}: {len(poses.t)} poses"
    if out.suffix == ".csv":
        frame = kept.frame if isinstance(kept, Log) else pd.read_parquet(file)
        with whole_file(out, force) as temporary:
            frame.to_csv(temporary, index=False, float_format="%.17g")
        return f"{out}: {len(frame)} rows, {len(frame.columns)} columns"
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _FOXGLOVE.items():
        store.register(get_types_from_msg(text, name))
    found = _of_log(store, kept) if isinstance(kept, Log) else _of_estimate(store, kept, file.stem)
    return f"{out}: {_write_mcap(out, store, found, force)} messages"


def _read(file: Path) -> Log | Trajectory:
    try:
        return Trajectory.read(file)
    except TrajectoryError:
        return Log.read(file)


def _write_mcap(out: Path, store: Typestore, messages: Messages, force: bool) -> int:
    """Write a bag of one file: rosbags writes a folder, of which the file is kept."""
    count = 0
    with whole_file(out, force) as temporary, TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        connections: dict[str, Any] = {}
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for topic, t, message in messages:
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                content = store.serialize_cdr(message, kind)
                writer.write(connections[topic], _nanoseconds(t), content)
                count += 1
        (written,) = bag.glob("*.mcap")
        temporary.write_bytes(written.read_bytes())
    return count


def _of_log(store: Typestore, log: Log) -> Messages:
    types = store.types
    header, vector = types["std_msgs/msg/Header"], types["geometry_msgs/msg/Vector3"]
    imu, joints = types["sensor_msgs/msg/Imu"], types["sensor_msgs/msg/JointState"]
    quaternion = types["geometry_msgs/msg/Quaternion"]
    flag = types["std_msgs/msg/Bool"]
    inertial, moving, empty = log.has("imu"), log.has("q"), np.zeros((len(log.t), 0))
    gyro, accel = (log.gyro, log.accel) if inertial else (empty, empty)
    streams = ("q", "dq", "tau", "contact")
    q, dq, tau, contact = (getattr(log, one) if log.has(one) else empty for one in streams)
    unknown, zero = np.r_[_UNKNOWN, np.zeros(8)], np.zeros(9)
    for k, t in enumerate(log.t):
        at = header(_time(store, t), BODY)
        if inertial:
            none = quaternion(0.0, 0.0, 0.0, 1.0)
            reading = imu(at, none, unknown, vector(*gyro[k]), zero, vector(*accel[k]), zero)
            yield "/imu", t, reading
        if moving:
            yield "/joint_states", t, joints(at, list(log.joints), q[k], dq[k], tau[k])
        for leg, stands in zip(log.legs, contact[k], strict=False):
            yield f"/contact/{leg}", t, flag(bool(stands))
    if log.has("reference"):
        yield from _poses(store, "/reference", log.t, log.ref_p, log.ref_q)


def _of_estimate(store: Typestore, found: Trajectory, name: str) -> Messages:
    q = quaternion_from_matrix(found.R_GI)
    yield from _poses(store, f"/{name}", found.t, found.p_GI, q)
    types = store.types
    stamped, twist = (types[f"geometry_msgs/msg/{n}"] for n in ("TwistStamped", "Twist"))
    header, vector = types["std_msgs/msg/Header"], types["geometry_msgs/msg/Vector3"]
    for t, v_I in zip(found.t, found.v_I, strict=True):
        moving = twist(vector(*v_I), vector(0.0, 0.0, 0.0))
        yield f"/{name}/velocity", t, stamped(header(_time(store, t), BODY), moving)


def _poses(store: Typestore, topic: str, t: np.ndarray, p: np.ndarray, q: np.ndarray) -> Messages:
    """A pose and a transform from body to world at each time.

    Args:
        store: of the message types.
        topic: of the poses.
        t: (N,) [s].
        p: (N, 3) in G [m].
        q: (N, 4) of I in G as w, x, y, z.
    """
    types = store.types
    point, vector = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Vector3"]
    quaternion, pose = types["geometry_msgs/msg/Quaternion"], types["geometry_msgs/msg/Pose"]
    in_frame, transform = (types[name] for name in _FOXGLOVE)
    for at, place, turn in zip(t, p, q, strict=True):
        stamp, attitude = _time(store, at), quaternion(*turn[1:], turn[0])
        yield topic, at, in_frame(stamp, WORLD, pose(point(*place), attitude))
        moved = transform(stamp, WORLD, f"{topic[1:]}/{BODY}", vector(*place), attitude)
        yield "/tf", at, moved


def _time(store: Typestore, t: float) -> Any:
    seconds, rest = divmod(_nanoseconds(t), 1_000_000_000)
    return store.types["builtin_interfaces/msg/Time"](seconds, rest)


def _nanoseconds(t: float) -> int:
    if t < 0.0:
        raise SurefootError(f"MCAP has no times before zero, the log begins at {t:g} s")
    return round(1e9 * float(t))
