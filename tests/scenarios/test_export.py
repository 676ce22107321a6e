"""What is exported is read back: by pandas, by evo's format of poses, and as a bag by a map."""

import numpy as np
import pandas as pd
import pytest
from refusals import refused
from rosbags.highlevel import AnyReader

from surefoot import Robot, import_log, run_filter
from surefoot.extend import Trajectory, reference
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.export import export
from surefoot.sim.log import LEGS, Log


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
    for name in ("gyro", "q", "tau", "contact", "ref_p", "ref_R_GI"):
        of_log, read = (getattr(one, name)[-len(back.t) :] for one in (log, back))
        kept = np.s_[:, :1] if name in ("q", "tau", "contact") else ...
        np.testing.assert_allclose(read[kept], of_log[kept], atol=1e-8, err_msg=name)


def test_poses_have_foxgloves_published_fields_in_the_file_itself(files):
    export(files / "imu.parquet", files / "imu.mcap")
    frames = "timestamp parent_frame_id child_frame_id translation rotation"
    published = {
        "/imu": ("foxglove_msgs/msg/PoseInFrame", "timestamp frame_id pose"),
        "/tf": ("foxglove_msgs/msg/FrameTransform", frames),
    }
    found, places = {}, []
    with AnyReader([files / "imu.mcap"]) as bag:  # knows no types but those of the file
        for connection, _, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            names = [name for name in message.__dataclass_fields__ if not name.startswith("_")]
            found[connection.topic] = connection.msgtype, " ".join(names)
            if connection.topic == "/imu":
                p = message.pose.position
                places.append((p.x, p.y, p.z))
    assert published.items() <= found.items()
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
