"""The worked example of a package of one's own: gtsam's legged estimators beside ours."""

import shutil
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from given_feet import with_feet_for_joints
from processes import printed
from refusals import refused

import surefoot
from surefoot import Learnt, Scenario
from surefoot.extend import Beginning, Ground, NavState, Segment, samples
from surefoot.scenarios.estimate.bundled import Leg

pytest.importorskip("gtsam", reason="gtsam is not installed: the extra surefoot[gtsam]")
DOCS = Path(__file__).resolve().parents[2] / "docs"
EXAMPLE = DOCS / "examples" / "gtsam_legged"
sys.path[:0] = [str(DOCS), str(EXAMPLE)]

import gtsam_legged as example  # noqa: E402
import guide  # noqa: E402

ROBOT = surefoot.Robot.load("spot_class")
POINT_FEET = replace(ROBOT, foot_radius=np.zeros(4))
KNOWN_BIASES = np.diag([1e-4, 1e-4, 1e-6, *[1e-3] * 3, *[1e-6] * 3, *[1e-14] * 6])
"""Covariance (15, 15) of a beginning whose biases are as good as known, as they are to gtsam."""


@pytest.fixture(scope="module")
def log():
    course = (Segment(1.5, 0.5), Segment(1.5, 0.4, turn=0.5))
    return surefoot.walk(Scenario("short", course, Ground(0.8)), ROBOT, seed=0)


def ended(kind, log, robot, **more):
    """State and covariance at the end of a log, of an estimator with these parameters."""
    parameters = {one.name: one.default for one in kind.parameters} | {"kinematics": 3e-3} | more
    first = NavState(log.ref_R_GI[0], log.ref_v[0], log.ref_p[0])
    stream = kind().start(robot, Learnt(), parameters, Beginning(first, KNOWN_BIASES, log.rate))
    for sample in samples(log):
        stream.step(sample)
    return stream.state, stream.covariance


def test_told_the_same_it_says_what_the_leg_filter_says(log):
    """Two implementations, of right- and of left-invariant errors: they agree to a hundredth of the
    error that they share, which is that of taking feet that roll for points."""
    held = {"encoder": 1e-9, "accel_walk": 1e-12, "gyro_walk": 1e-12}
    walked = log.rows(slice(0, 1200))
    ours, our_cov = ended(Leg, walked, POINT_FEET, **held)
    theirs, their_cov = ended(example.GtsamLeg, walked, ROBOT)
    shared = np.abs(ours.p_GI - walked.ref_p[-1]).max()
    assert shared > 0.02
    np.testing.assert_allclose(theirs.p_GI, ours.p_GI, atol=0.01 * shared)
    np.testing.assert_allclose(theirs.v_GI, ours.v_GI, atol=1e-4)
    np.testing.assert_allclose(theirs.R_GI, ours.R_GI, atol=1e-6)
    sizes = np.sqrt(np.diag(our_cov)[:9])
    difference = (their_cov - our_cov)[:9, :9] / np.outer(sizes, sizes)
    assert np.abs(difference).max() < 0.01


def test_contacts_solved_together_are_a_little_elsewhere(log):
    filtered, _ = ended(example.GtsamLeg, log, ROBOT)
    iterated, covariance = ended(example.GtsamLegIterated, log, ROBOT)
    assert 1e-6 < np.abs(iterated.p_GI - filtered.p_GI).max() < 0.02
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_foot_positions_of_a_log_do_without_a_robot(log):
    given = with_feet_for_joints(log, ROBOT)
    stream = example.GtsamLeg().start(
        None,
        Learnt(),
        {one.name: one.default for one in example.GtsamLeg.parameters},
        Beginning(NavState(), KNOWN_BIASES, log.rate, feet=log.legs),
    )
    walked = list(samples(given))[:21]
    for sample in walked[:-1]:
        stream.step(sample)
    assert np.isfinite(stream.state.p_GI).all()
    lacking = walked[-1]._replace(foot_I=None)
    refused("lacks foot_I", stream.step, lacking)


def test_the_package_and_the_file_offer_the_same():
    points = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]["entry-points"]
    offered = {
        group: {name: getattr(example, value.partition(":")[2]) for name, value in names.items()}
        for group, names in points.items()
    }
    assert offered == example.PLUGINS


def test_they_stand_in_the_table_beside_ours(log, tmp_path, monkeypatch):
    log.write(tmp_path / "walk.parquet")
    for file in ("gtsam_legged.py", "pyproject.toml"):
        shutil.copy(EXAMPLE / file, tmp_path)
    monkeypatch.chdir(tmp_path)
    guide._write_entry_points()  # as `pip install .` would
    command = ("-m", "surefoot", "compare", "walk.parquet", "-o", "compared")
    printed(*command, env=guide._environment())
    table = pd.read_csv("compared/table.csv").set_index("filter")
    assert list(table.index) == ["leg", "leg_slip", "imu", "gtsam_leg", "gtsam_leg_iterated"]
    errors = table["APE_trans [m]"].to_dict()
    assert errors["leg"] < errors["gtsam_leg"] < errors["imu"]  # feet that roll, and no biases
    report = Path("compared/report.html").read_text()
    assert "LeggedInvariantEKF: a foothold a leg as states" in report
