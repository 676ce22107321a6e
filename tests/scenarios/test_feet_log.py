"""A log that says where its feet are needs neither joint angles nor a robot."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from estimates import metrics_of
from given_feet import with_feet_for_joints
from processes import ended
from refusals import refused
from synthetic import without
from written import written

from studies.measured import measured_folder
from surefoot import Learnt, Log, Robot, import_log, read_recording
from surefoot.estimator.evaluation.trajectory import Trajectory, with_mounting
from surefoot.estimator.run import every_row
from surefoot.scenarios.cli.estimate import NOT_TRUSTED
from surefoot.scenarios.estimate.estimators import estimator_named
from surefoot.scenarios.estimate.run import (
    begin,
    estimated,
    estimated_in_chunks,
    joined_trajectory,
    run_filter,
    stepped,
)
from surefoot.scenarios.estimate.settings import FilterSettings, tuned
from surefoot.sim.importing.map import ImportMap

SCALER = measured_folder() / "scaler_trot"
NAMES = {"FL": "a", "FR": "b", "RL": "c_1", "RR": "d"}


@pytest.fixture(scope="module")
def point_feet():
    """Its feet are points: nothing in foot positions says how a foot turns while it rolls."""
    return replace(Robot.load("spot_class"), foot_radius=np.zeros(4))


@pytest.fixture(scope="module")
def log(log):
    """A few seconds of the walk that all tests share."""
    return log.rows(slice(0, 3000))


@pytest.fixture(scope="module")
def feet(log, point_feet) -> Log:
    """The walk as a robot of legs a, b, c_1 and d would log it that hides its joints."""
    feet = with_feet_for_joints(log, point_feet)
    renamed = {n: re.sub("FL|FR|RL|RR", lambda m: NAMES[m[0]], n) for n in feet.frame}
    return replace(feet, frame=feet.frame.rename(columns=renamed))


@pytest.mark.parametrize("name", ["leg", "leg_slip"])
def test_foot_positions_say_what_joint_angles_do(name, log, feet, point_feet):
    """Where the error of a foot does not come from its joints, whose arms only the angles tell."""
    one = estimator_named(name)
    values = FilterSettings(filters={name: tuned(None).of(one) | {"encoder": 1e-9}})
    plain = replace(log, meta=replace(log.meta, effects=()))
    by_joints = estimated(one, plain, point_feet, Learnt(), values)
    by_feet = estimated(one, feet, None, Learnt(), values)
    for field in ("R_GI", "v_GI", "p_GI", "b_a", "b_g", "covariance"):
        np.testing.assert_allclose(getattr(by_feet, field), getattr(by_joints, field), atol=1e-9)


def test_a_sample_at_a_time_and_pieces_give_the_same_numbers(feet):
    one = estimator_named("leg_slip")
    whole = estimated(one, feet, None, Learnt())
    cut = [feet.rows(slice(0, 501)), feet.rows(slice(501, len(feet.t)))]
    joined = joined_trajectory(estimated_in_chunks(one, cut, None, Learnt()))
    alone = stepped(begin(one, feet, None, Learnt()), feet, every_row(feet.t))
    steps = with_mounting(alone, tuned(None).mounting)
    for other in (joined, steps):
        for field in ("p_GI", "covariance"):
            np.testing.assert_allclose(getattr(other, field), getattr(whole, field), atol=1e-9)


def test_joint_angles_of_a_known_robot_come_first(log, feet, point_feet):
    """Foot positions that somebody adds to a log do not change what is estimated."""
    wrong = feet.frame.filter(like="foot_").rename(
        columns={f"foot_{b}_{x}": f"foot_{a}_{x}" for a, b in NAMES.items() for x in "xyz"}
    )
    more = replace(log, frame=pd.concat([log.frame, 2.0 * wrong], axis=1))
    same, as_it_was = (run_filter("leg", one, point_feet).trajectory for one in (more, log))
    np.testing.assert_array_equal(same.p_GI, as_it_was.p_GI)


def test_three_legs_are_three(feet):
    three = without(feet, "contact_d", "foot_d")
    assert three.legs == ("a", "b", "c_1")
    assert three.foot_I.shape == (len(feet.t), 3, 3)
    assert metrics_of("leg", three, None).ape_trans < 0.3


def test_commands_run_without_a_robot_and_say_what_needs_one(tmp_path, capsys, feet):
    path = tmp_path / "feet.parquet"
    feet.write(path)
    assert ended(f"compare {path} -o {tmp_path}/compared") is None
    said = capsys.readouterr().out
    assert "coverage, coverage_gml, coverage_persistent, velocity" in said
    assert said.count("radar_leg (the log names no robot: say which)") == 1
    assert "No recording" in (tmp_path / "compared" / "report.html").read_text()
    assert ended(f"trace {path} -o {tmp_path}/traced") is None
    assert "too short" in capsys.readouterr().out
    said = str(ended(f"loop {path} -o {tmp_path}/looped"))
    assert "its foot positions suffice for estimate, compare, align and trace" in said


def test_what_is_missing_is_one_line(tmp_path, log, feet):
    bare = without(feet, "foot")
    refused(r"lacks foot \(foot_a_x, .*\) and q \(q_<joint>\)", run_filter, "leg", bare, None)
    declared = ({"name": "gyro_bias", "target": "x", "value": 0.01, "unit": "rad/s"},)
    declaring = replace(feet, meta=replace(feet.meta, effects=declared))
    assert metrics_of("leg", declaring, None)
    path = tmp_path / "feet.parquet"
    named = with_feet_for_joints(log, Robot.load("spot_class"))
    replace(named, meta=replace(named.meta, robot="spot_class")).write(path)
    said = str(ended(f"train {path} -o {tmp_path}/observer"))
    assert "lacks q (q_" in said
    assert "\n" not in said


def test_a_map_takes_feet_in_millimetres_and_says_which_bodies_they_are(tmp_path):
    rows = pd.DataFrame({"t": [0.0, 0.01, 0.02], "p": [100.0, 110.0, 120.0], "n": [1.0, 2.0, 3.0]})
    rows.to_csv(tmp_path / "robot.csv", index=False)
    feet = "".join(f'foot_left_{x} = {{ column = "p", unit = "mm" }}\n' for x in "xyz")
    force = "".join(f'force_left_{x} = {{ column = "n", unit = "kN" }}\n' for x in "xyz")
    robot = '[robot]\nname = "spot_class"\nfeet = { left = "sole" }\n'
    text = f'[columns]\nt = "t"\n{feet}{force}{robot}'
    log = import_log(tmp_path / "robot.csv", written(tmp_path / "map.toml", text))
    assert log.legs == ("left",)
    np.testing.assert_allclose(log.foot_I[:, 0, 1], [0.10, 0.11, 0.12])
    np.testing.assert_allclose(log.force_I[:, 0, 2], [1e3, 2e3, 3e3])
    log.write(tmp_path / "log.parquet")
    assert Log.read(tmp_path / "log.parquet").meta.model["feet"] == {"left": "sole"}
    (tmp_path / "map.toml").write_text(text.replace('"mm"', '"in"', 1))
    refused(r"columns.foot_left_x\] unit 'in'", ImportMap.read, tmp_path / "map.toml")


@pytest.mark.skipif(not SCALER.is_dir(), reason=f"the measured walks are not here ({SCALER})")
def test_the_leg_filter_runs_on_a_measured_walk_of_five_bar_legs(tmp_path):
    """Whose clock and axes are not those of its motion capture, so that this is left out."""
    recording = read_recording(SCALER / "logs" / "scaler_06.csv", "scaler_trot")
    log = recording.without_reference().log()
    assert log.foot_I.shape == (len(log.t), 4, 3)
    assert log.meta.robot is None
    log.write(tmp_path / "scaler.parquet")
    line = f"estimate {tmp_path}/scaler.parquet --filter leg -o {tmp_path}/estimate.parquet"
    assert ended(line) in (None, NOT_TRUSTED)
    path = Trajectory.read(tmp_path / "estimate.parquet").p_GI
    assert 1.0 < np.linalg.norm(path[-1, :2] - path[0, :2]) < 3.0
