"""What is exported is read back: by pandas, by evo's format of poses, and as a bag by a map."""

import numpy as np
import pandas as pd
import pytest
from refusals import refused
from rosbags.highlevel import AnyReader

from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.estimate.run import run_filter
from surefoot.scenarios.export import export
from surefoot.sim.importing.recording import import_log
from surefoot.sim.log import LEGS, Log
from surefoot.sim.robot import Robot


@pytest.fixture(scope="module")
def files(log, tmp_path_factory):
    """A log of a second, at 100 Hz, and an estimate of it."""
    folder, log = tmp_path_factory.mktemp("export"), log.rows(slice(0, 500, 5))
    log.write(folder / "log.parquet")
    run_filter("imu", log, Robot.load("spot_class")).trajectory.write(folder / "imu.parquet")
    return folder


READINGS = {
    "t": "/imu:header.stamp",
    **{f"gyro_{a}": f"/imu:angular_velocity.{a}" for a in "xyz"},
    **{f"accel_{a}": f"/imu:linear_acceleration.{a}" for a in "xyz"},
    "q_FL_hip": "/joint_states:position[FL_hip]",
    "tau_FL_hip": "/joint_states:effort[FL_hip]",
    **{f"contact_{leg}": f"/contact/{leg}:data" for leg in LEGS},
}
POSES = {
    "t": "/reference:timestamp",
    **{f"ref_p_{a}": f"/reference:pose.position.{a}" for a in "xyz"},
    **{f"ref_q_{a}": f"/reference:pose.orientation.{a}" for a in "wxyz"},
}


def entries(columns: dict[str, str]) -> str:
    return "".join(f'{ours} = "{theirs}"\n' for ours, theirs in columns.items())


def test_a_log_comes_back_from_mcap_by_a_map(files, capsys):
    main(f"export {files / 'log.parquet'} -o {files / 'log.mcap'}".split())
    assert "messages" in capsys.readouterr().out
    text = f"[columns]\n{entries(READINGS)}[reference]\n[reference.columns]\n{entries(POSES)}"
    (files / "map.toml").write_text(text)
    log, back = Log.read(files / "log.parquet"), import_log(files / "log.mcap", files / "map.toml")
    np.testing.assert_allclose(back.gyro, log.gyro[-len(back.t) :], atol=1e-12)
    np.testing.assert_allclose(back.q[:, 0], log.q[-len(back.t) :, 0], atol=1e-12)
    np.testing.assert_allclose(back.tau[:, 0], log.tau[-len(back.t) :, 0], atol=1e-12)
    np.testing.assert_array_equal(back.contact[:, 0], log.contact[-len(back.t) :, 0])
    np.testing.assert_allclose(back.ref_p, log.ref_p[-len(back.t) :], atol=1e-8)
    np.testing.assert_allclose(back.ref_R_GI, log.ref_R_GI[-len(back.t) :], atol=1e-8)


def test_poses_have_foxgloves_published_fields_in_the_file_itself(files):
    export(files / "imu.parquet", files / "imu.mcap")
    published = {
        "foxglove_msgs/msg/PoseInFrame": ["timestamp", "frame_id", "pose"],
        "foxglove_msgs/msg/FrameTransform": [
            "timestamp",
            "parent_frame_id",
            "child_frame_id",
            "translation",
            "rotation",
        ],
    }
    with AnyReader([files / "imu.mcap"]) as bag:  # knows no types but those of the file
        kinds = {one.topic: one.msgtype for one in bag.connections}
        assert kinds["/imu"] == "foxglove_msgs/msg/PoseInFrame"
        assert kinds["/tf"] == "foxglove_msgs/msg/FrameTransform"
        places = []
        for connection, _, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            if connection.msgtype in published:
                own = [name for name in message.__dataclass_fields__ if not name.startswith("_")]
                assert own == published[connection.msgtype]
            if connection.topic == "/imu":
                p = message.pose.position
                places.append((p.x, p.y, p.z))
    np.testing.assert_array_equal(places, Trajectory.read(files / "imu.parquet").p_GI)


def test_text_keeps_every_digit_and_nothing_is_overwritten(files):
    log = Log.read(files / "log.parquet")
    export(files / "log.parquet", files / "log.csv")
    pd.testing.assert_frame_equal(
        pd.read_csv(files / "log.csv", float_precision="round_trip", dtype=float), log.frame
    )
    export(files / "log.parquet", files / "log.tum")
    table = np.loadtxt(files / "log.tum")
    np.testing.assert_allclose(table[:, 1:4], reference(log).p_GI, atol=1e-12)
    export(files / "imu.parquet", files / "imu.csv")
    assert "cov_0_0" in pd.read_csv(files / "imu.csv")
    refused("exists already", export, files / "log.parquet", files / "log.csv")
    refused(r"\.tum or \.csv or \.mcap", export, files / "log.parquet", files / "log.txt")
    refused("not a log, which is a Parquet file", export, files / "log.csv", files / "other.csv")
