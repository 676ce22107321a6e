"""`surefoot score`: an estimate is judged alike in whatever form it comes."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest
from synthetic import synthetic_walk

from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.estimator.metrics import evaluate, vector_jacobian
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.estimate.other_estimates import of_imu, read_estimate
from surefoot.scenarios.score import LEVEL, QUANTITIES, scored
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.robot import Robot

PARTS = {"p": "position", "v": "velocity", "q": "attitude"}
UPPER = [(i, j) for i in range(3) for j in range(i, 3)]


@pytest.fixture(scope="module")
def log():
    return synthetic_walk(0, 12.0, noise=0.0, robot="spot_class")


@pytest.fixture(scope="module")
def drifting(log):
    """An estimate off by errors that grow, with a covariance that correlates its parts."""
    rng = np.random.default_rng(0)
    truth, rows = reference(log), slice(0, None, 5)
    root = 0.05 * rng.standard_normal((15, 15))
    S = np.broadcast_to(root @ root.T + 1e-3 * np.eye(15), (len(truth.t), 15, 15))
    drift = (truth.t - truth.t[0])[:, None] * [0.01, -0.02, 0.005]
    turn = Rotation.from_rotvec(0.1 * drift).as_matrix()
    moved = replace(
        truth, p_GI=truth.p_GI + drift, R_GI=turn @ truth.R_GI, v_GI=truth.v_GI + 0.01, covariance=S
    )
    return moved.rows(rows)


def table(estimate: Trajectory, parts: str = "", velocity: bool = True) -> pd.DataFrame:
    """The columns of another program; `parts` are those with a covariance in the world."""
    q = quaternion_from_matrix(estimate.R_GI)
    columns = {"t": estimate.t}
    columns |= {f"q_{axis}": q[:, k] for k, axis in enumerate("wxyz")}
    for k, axis in enumerate("xyz"):
        columns |= {f"p_{axis}": estimate.p_GI[:, k]}
        columns |= {f"v_{axis}": estimate.v_GI[:, k]} if velocity else {}
    assert estimate.covariance is not None
    S = estimate.covariance[:, :9, :9]
    J = {"p": vector_jacobian(estimate.p_GI, 6), "v": vector_jacobian(estimate.v_GI, 3)}
    J["q"] = np.broadcast_to(np.eye(3, 9), J["p"].shape)
    for part in parts:
        C = J[part] @ S @ J[part].swapaxes(1, 2)
        columns |= {f"cov_{part}_{'xyz'[i]}{'xyz'[j]}": C[:, i, j] for i, j in UPPER}
    return pd.DataFrame(columns)


@pytest.mark.parametrize("parts", ["pvq", "p", ""])
def test_a_table_is_judged_as_the_same_trajectory(parts, log, drifting, tmp_path):
    path = tmp_path / "mine.csv"
    table(drifting, parts).to_csv(path, index=False)
    found = scored(read_estimate(path), log, "mine").metrics
    wanted = evaluate(reference(log), drifting)
    assert found.ape_trans == pytest.approx(wanted.ape_trans, rel=1e-6)
    assert found.velocity == pytest.approx(wanted.velocity, rel=1e-6)
    for part, name in PARTS.items():
        nees = getattr(found, f"nees_{name}")
        if part in parts:
            assert nees == pytest.approx(getattr(wanted, f"nees_{name}"), rel=1e-5)
        else:
            assert np.isnan(nees)


@pytest.mark.parametrize("header", ["", "# timestamp tx ty tz qx qy qz qw\n"])
def test_tum_text_has_the_same_poses(log, drifting, tmp_path, header):
    drifting.write_tum(tmp_path / "mine.tum")
    text = (tmp_path / "mine.tum").read_text()
    (tmp_path / "mine.tum").write_text(header + text)
    found = scored(read_estimate(tmp_path / "mine.tum"), log, "mine").metrics
    assert found.rpe_trans == pytest.approx(evaluate(reference(log), drifting).rpe_trans, rel=1e-6)


def test_stamps_may_lie_between_those_of_the_log(log, drifting, tmp_path):
    t = drifting.t[:-1] + 0.0007
    moved = [np.interp(t, drifting.t, x) for x in drifting.p_GI.T]
    later = replace(drifting.rows(slice(0, -1)), t=t, p_GI=np.column_stack(moved))
    table(later).to_csv(tmp_path / "later.csv", index=False)
    found = scored(read_estimate(tmp_path / "later.csv"), log, "later").metrics
    assert found.samples > 1000
    assert found.ape_trans == pytest.approx(evaluate(reference(log), drifting).ape_trans, rel=0.02)


def test_poses_of_the_base_become_those_of_the_imu(log):
    robot = Robot.for_log(log)
    truth = reference(log)
    R_GB = truth.R_GI @ robot.R_BI.T
    lever = np.cross(log.gyro @ robot.R_BI.T, robot.p_BI)
    base = replace(
        truth,
        R_GI=R_GB,
        p_GI=truth.p_GI - R_GB @ robot.p_BI,
        v_GI=truth.v_GI - np.einsum("nij,nj->ni", R_GB, lever),
    )
    assert np.abs(base.p_GI - truth.p_GI).max() > 0.01, "the IMU is not at the base's origin"
    back = of_imu(base, log, robot)
    for name in ("R_GI", "p_GI", "v_GI"):
        np.testing.assert_allclose(getattr(back, name), getattr(truth, name), atol=1e-9)


def test_the_share_inside_is_the_level_where_the_claim_is_right(log, tmp_path):
    rng = np.random.default_rng(1)
    truth = reference(log).rows(slice(0, None, 5))
    n, std = len(truth.t), np.array([0.01, 0.02, 0.03])
    errors = {part: rng.normal(0.0, std, (n, 3)) for part in PARTS}
    for one in errors.values():
        one[0] = 0.0  # the sample at which the estimate is aligned
    off = replace(
        truth,
        p_GI=truth.p_GI + errors["p"],
        v_GI=truth.v_GI + errors["v"],
        R_GI=Rotation.from_rotvec(errors["q"]).as_matrix() @ truth.R_GI,
    )
    columns = table(replace(off, covariance=np.zeros((n, 15, 15))))
    for part in PARTS:
        for i, j in UPPER:
            columns[f"cov_{part}_{'xyz'[i]}{'xyz'[j]}"] = std[i] ** 2 * (i == j)
    columns.to_csv(tmp_path / "right.csv", index=False)
    found = scored(read_estimate(tmp_path / "right.csv"), log, "right")
    for name in QUANTITIES:
        low, high = binomtest(round(found.inside[name] * n), n).proportion_ci(0.999)
        assert low <= LEVEL <= high, name


def test_the_command_writes_a_page_and_names_what_is_wrong(log, drifting, tmp_path, capsys):
    log.write(tmp_path / "walk.parquet")
    drifting.write(tmp_path / "mine.parquet")
    drifting.write_tum(tmp_path / "mine.tum")
    after = f"--log {tmp_path}/walk.parquet -o {tmp_path}/scored"
    main(f"score {tmp_path}/mine.parquet {tmp_path}/mine.tum {after} --json".split())
    rows = json.loads(capsys.readouterr().out)
    assert [row["estimate"] for row in rows] == ["mine.parquet", "mine.tum"]
    assert rows[0]["APE_trans [m]"] == pytest.approx(rows[1]["APE_trans [m]"], rel=1e-6)
    assert rows[1]["NEES_pos"] is None
    page = (tmp_path / "scored" / "report.html").read_text()
    assert "mine.tum" in page
    good = table(drifting, "pvq")
    bad = {
        "p_y": good.drop(columns="p_y"),
        "line 7": good.assign(q_w=good["q_w"].where(good.index != 5, 3.0)),
        "t must increase": good.assign(t=good["t"].where(good.index != 5, 0.0)),
        "cov_v_xy": good.drop(columns="cov_v_xy"),
        "cov_p": good.assign(cov_p_xx=-good["cov_p_xx"]),
        "do not overlap": good.assign(t=good["t"] + 1e9),
    }
    for words, columns in bad.items():
        columns.to_csv(tmp_path / "bad.csv", index=False)
        with pytest.raises(SystemExit) as refused:
            main(f"score {tmp_path}/bad.csv --log {tmp_path}/walk.parquet -o {tmp_path}/n".split())
        assert words in str(refused.value)
        assert "bad" in str(refused.value)
        assert not (tmp_path / "n").exists()
