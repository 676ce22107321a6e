"""A log that starts in motion is said to; filters then start from gravity and legs."""

import re

import numpy as np
import pytest
from synthetic import without

from surefoot.estimator.initial import MOVING_WINDOW, initial_state, start_of, starts_in_motion
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.estimate.contract import samples
from surefoot.scenarios.estimate.inputs import start_note
from surefoot.scenarios.estimate.run import run_filter
from surefoot.scenarios.estimate.streaming import StreamingEstimator
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log, reference_velocity
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

ROBOTS = ("spot_class", "v60_class")


@pytest.fixture(scope="module", params=ROBOTS)
def walked(request) -> tuple[Log, Robot]:
    """Two seconds of walking after one of standing."""
    robot = Robot.load(request.param)
    course = Scenario("start", (Segment(2.0, 0.6, 0.0, 0.0),), Ground(0.8))
    return walk(course, robot, 0), robot


CUTS = {
    "as recorded": ("x_",),
    "without a reference": ("ref_",),
    "without contacts": ("ref_", "contact_"),
    "without logged rates": ("ref_", "dq_"),
}


@pytest.mark.parametrize("cut", CUTS)
def test_only_logs_that_start_in_motion_are_said_to(walked, cut):
    log, _ = walked
    log = without(log, *CUTS[cut])
    for start in (0.0, 0.3, 0.6):  # it stands for one second
        rest = log.rows(log.t >= start)
        for rows in (slice(None), slice(0, 3), slice(0, None, 25)):
            assert not starts_in_motion(rest.rows(rows))
            assert start_note(rest.rows(rows)) == ""
    for start in (1.6, 1.77, 2.03, 2.31):
        moving = log.rows(log.t >= start)
        for some in (moving, moving.rows(slice(0, 3)), moving.rows(slice(0, None, 5))):
            assert starts_in_motion(some)
        said = start_note(moving)
        if cut == "without contacts":
            assert "legs" not in said
            assert " 0.00 ± 1.00 m/s" in said
            continue
        assert ("the reference" if cut == "as recorded" else "legs") in said
        speed, doubt = map(float, re.findall(r"at ([\d.]+) ± ([\d.]+) m/s", said)[0])
        truth = np.linalg.norm(walked[0].ref_v[walked[0].t >= start][0])
        assert speed == pytest.approx(truth, abs=max(2.0 * doubt, 0.02))


def test_logs_without_an_imu_start_no_filter_and_those_of_an_imu_alone_are_judged_by_it(walked):
    log, _ = walked
    moving = log.rows(log.t >= 1.6)
    assert start_note(without(moving, "gyro_", "accel_")) == ""
    alone = without(moving, "ref_", "q_", "dq_", "contact_")
    still = alone.with_columns({f"gyro_{axis}": np.full(len(alone.t), 0.02) for axis in "xyz"})
    assert not starts_in_motion(still)
    assert starts_in_motion(alone.with_columns({"gyro_z": np.full(len(alone.t), 0.5)}))


def test_estimate_and_compare_say_how_they_start_where_the_robot_moves(walked, tmp_path, capsys):
    log, _ = walked
    moving, path = log.rows((log.t >= 1.6) & (log.t < 3.0)), tmp_path / "moving.parquet"
    moving.write(path)
    main(["info", str(path)])
    assert capsys.readouterr().out.count("start: ") == 1
    leg = ["estimate", str(path), "--filter", "leg"]
    for options, said in (
        ([], "the reference"), (["--start", "moving"], "legs"), (["--start", "rest"], "at rest"),
    ):  # fmt: skip
        main([*leg, *options])
        (note,) = [one for one in capsys.readouterr().err.splitlines() if "start: " in one]
        assert said in note
    without(moving, "ref_").write(path, force=True)
    for options, count in (
        ([], 1), (["--set", "start.velocity=0.7"], 0), (["--set", "state.v_GI=[0.6,0,0]"], 0)
    ):  # fmt: skip
        main([*leg, *options])
        assert capsys.readouterr().err.count("note: moving: start: ") == count
    main(["compare", str(path), "-o", str(tmp_path / "compared")])
    assert "moving: start: " in capsys.readouterr().out
    log.rows(log.t < 0.9).write(path, force=True)
    main(leg)
    assert "start: " not in capsys.readouterr().err


@pytest.mark.parametrize("begin", [1.6, 1.83, 2.31])
@pytest.mark.parametrize("cut", ["as recorded", "without logged rates"])
def test_gravity_and_velocity_of_a_moving_robot_are_found_by_its_legs(walked, cut, begin):
    log, robot = walked
    moving = without(log.rows(log.t >= begin), *CUTS[cut])
    up, v_I = log.ref_R_GI[log.t >= begin][0, 2], _velocity(log.rows(log.t >= begin))
    state, std = initial_state(moving, "moving", robot.feet)
    assert np.arccos(state.R_GI[2] @ up) < 2.0 * std.tilt
    assert np.linalg.norm(state.R_GI.T @ state.v_GI - v_I) < 2.0 * std.velocity < 0.5
    assert start_of(without(moving, "ref_")) == "moving"
    alone, std = initial_state(moving, "moving")
    assert not alone.v_GI.any()
    assert std.velocity > np.linalg.norm(v_I)


def _velocity(log: Log) -> np.ndarray:
    return log.ref_R_GI[0].T @ reference_velocity(log)[0]


def test_a_stream_that_starts_in_motion_is_that_of_its_log(walked):
    log, robot = walked
    moving = without(log.rows(log.t >= 1.6), "ref_")
    online = StreamingEstimator("leg", robot)
    states = [online.step(sample) for sample in samples(moving)]
    waited = moving.t[[state is None for state in states]]
    assert waited[-1] - waited[0] == pytest.approx(MOVING_WINDOW, abs=0.01)
    assert online.start == "moving"
    expected = run_filter("leg", moving, robot).trajectory
    last = states[int(np.searchsorted(moving.t, expected.t[-1] - 1e-9))]
    assert last is not None
    np.testing.assert_allclose(last.p_GI, expected.p_GI[-1], atol=1e-9)
