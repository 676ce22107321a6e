"""What the studies of measured machines fit, on machines whose answer is known."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import swung

from surefoot.estimator.evaluation.trajectory import reference
from surefoot.scenarios.studies.hardware import walks_by_feet
from surefoot.scenarios.studies.hardware.impulses import window_rows
from surefoot.scenarios.studies.hardware.servos import Servo, ceiling_table, fit_servo, with_play
from surefoot.scenarios.studies.hardware.shared_sizes import left_out_table, runs_left_out
from surefoot.scenarios.studies.hardware.walks_by_feet import (
    end_error,
    travel_share,
    with_share,
)
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import FixedBase, load_machine
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk


def off_zero(log: Log, by: float) -> Log:
    return replace(log, frame=log.frame.assign(q_shoulder=log.frame.q_shoulder + by))


def test_runs_share_their_sizes_and_have_zeros_of_their_own():
    machine, zeros = load_machine("ak80_pendulum"), (0.03, -0.02, 0.0)
    assert isinstance(machine, FixedBase)
    runs = {
        f"run {k}": [
            window_rows(
                off_zero(swung(friction=0.2, armature=0.02, seed=k, seconds=8.0), zero),
                machine,
                0.3,
            )
        ]
        for k, zero in enumerate(zeros)
    }
    for one, zero in zip(done := runs_left_out(runs), zeros, strict=True):
        found = dict(zip(one.others.keys, one.others.value, strict=True))
        assert found["dry friction", "shoulder"] == pytest.approx(0.2, abs=0.02)
        assert found["inertia about the hinge", "shoulder"] == pytest.approx(0.02, abs=2e-3)
        own, rest = one.rows[0].zeros[0, :, 0], one.others.left(one.rows)
        # What the zeros of the others have in common is as a mass beside the rod.
        common = (sum(zeros) - zero) / 2
        assert rest @ own / (own @ own) == pytest.approx(zero - common, abs=6e-3)
    table = left_out_table(done)
    assert np.all(table["left [% of zeros alone]"].to_numpy(float) < 30)


def test_a_log_stands_once_beside_what_was_found_in_it_twice(monkeypatch):
    said = [Finding(("t",), evidence, "lost rows") for evidence in ("at 2 s", "at 5 s")]
    monkeypatch.setattr(walks_by_feet, "check_log", lambda log: said)
    logs = [replace(swung(seconds=0.1), name=name) for name in ("walk", "sway")]
    assert walks_by_feet.findings_table(logs)["logs"].tolist() == ["walk, sway"]


def test_a_servo_is_found_again_from_what_it_was_asked_for():
    t = np.arange(0.0, 40.0, 0.02)
    asked = 0.1 * np.sin(2.0 * t) + 0.05 * np.sin(5.3 * t + 1.0)
    true = Servo(0.05, 0.06, float(np.radians(0.8)))
    log = swung(0.1)
    frame = log.frame.iloc[:0].reindex(range(len(t)))
    frame = frame.assign(t=t, q_shoulder=0.3 + true.angle(t, asked), q_des_shoulder=asked)
    run = replace(log, frame=frame[["t", "q_shoulder", "q_des_shoulder"]])
    found = fit_servo([run], 0)
    assert (found.delay, found.lag, found.play) == pytest.approx((true.delay, true.lag, true.play))
    (row,) = ceiling_table({"run": run}, [Servo(0.0, 0.0, 0.0)]).to_dict("records")
    shared, own = map(float, row["run"].split(" / "))
    assert own == 0.0 < 5.0 < shared


def test_play_holds_until_its_gears_touch():
    driven = np.array([0.0, 0.5, 1.5, 1.0, 0.0, -2.0])
    np.testing.assert_allclose(with_play(driven, 1.0), [0.0, 0.0, 0.5, 0.5, 0.5, -1.0])


def test_the_share_of_the_way_that_feet_do_not_give_is_found_and_taken_off():
    robot = Robot.load("spot_class")
    log = walk(Scenario("short", (Segment(6.0, 0.5, turn=0.1),), Ground(0.8)), robot, 3)
    points = replace(robot, foot_radius=np.zeros(4))
    columns = {
        f"foot_{leg}_{axis}": points.feet_I(log.q)[:, k, i]
        for k, leg in enumerate(log.legs)
        for i, axis in enumerate("xyz")
    }
    plain = replace(log, frame=log.frame.assign(**columns))
    share = travel_share([plain])
    longer = with_share(plain, 1.0 - 1.0 / 0.85)
    assert 1.0 - travel_share([longer]) == pytest.approx(0.85 * (1.0 - share), rel=0.02)
    np.testing.assert_allclose(with_share(longer, 0.15).foot_I, plain.foot_I, atol=1e-12)
    truth = reference(log)
    assert end_error(log, truth) == pytest.approx(0.0, abs=1e-9)
    half = replace(truth, p_GI=truth.p_GI[0] + 0.9 * (truth.p_GI - truth.p_GI[0]))
    assert 5.0 < end_error(log, half) < 10.5
