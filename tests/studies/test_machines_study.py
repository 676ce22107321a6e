"""What the studies of measured machines fit, on machines whose answer is known."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from pendulum import swung

from studies.hardware import walks_by_feet
from studies.hardware.creeping_feet import (
    forces_table,
    lost_by_turning,
    lost_way_table,
    single_stances_table,
    stance_travel,
    travel_share,
    turning_of_feet,
    with_share,
)
from studies.hardware.walks_by_feet import end_error
from surefoot.estimator.evaluation.trajectory import reference
from surefoot.sim.log import Log
from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.robot import Robot


def test_a_log_stands_once_beside_what_was_found_in_it_twice(monkeypatch):
    said = [Finding(("t",), evidence, "lost rows") for evidence in ("at 2 s", "at 5 s")]
    monkeypatch.setattr(walks_by_feet, "check_log", lambda log: said)
    logs = [replace(swung(seconds=0.1), name=name) for name in ("walk", "sway")]
    assert walks_by_feet.findings_table(logs)["logs"].tolist() == ["walk, sway"]


def test_the_share_of_the_way_that_feet_do_not_give_is_found_and_taken_off(log):
    points = replace(Robot.load("spot_class"), foot_radius=np.zeros(4))
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


LEG_SPEED = 0.4
LOST = 0.25


def creeping(swing: float, sticks: bool = False) -> Log:
    """A trot along x whose body yaws to and fro by a rate that grows from `swing` [rad/s] to twice
    as much, and goes LOST metres less than the legs for each radian.

    The legs do not yaw, so standing feet turn over the ground; those that stick turn the other way
    in I.
    """
    t = 0.01 * np.arange(601)
    rate = swing * (1.0 + t / t[-1]) * np.cos(4.0 * np.pi * t)
    yaw = np.concatenate([[0.0], np.cumsum(0.005 * (rate[1:] + rate[:-1]))])
    v = LEG_SPEED - LOST * np.abs(rate)
    x = np.concatenate([[0.0], np.cumsum(0.005 * (v[1:] + v[:-1]))])
    first = t % 0.5 < 0.25 - 1e-9
    ahead = 0.05 - LEG_SPEED * (t % 0.25)
    columns = {"gyro_x": 0.0, "gyro_y": 0.0, "gyro_z": rate}
    columns |= {"accel_x": 0.0, "accel_y": 0.0, "accel_z": 9.81}
    columns |= {"ref_p_x": x, "ref_p_y": 0.0, "ref_p_z": 0.3}
    columns |= {"ref_q_w": np.cos(yaw / 2), "ref_q_x": 0.0, "ref_q_y": 0.0}
    columns["ref_q_z"] = np.sin(yaw / 2)
    for leg, middle in {
        "FL": (0.25, 0.15),
        "FR": (0.25, -0.15),
        "RL": (-0.25, 0.15),
        "RR": (-0.25, -0.15),
    }.items():
        stands = first if leg in ("FL", "RR") else ~first
        foot = np.column_stack([np.where(stands, ahead, -ahead), 0.0 * t]) + middle
        if sticks:
            c, s = np.cos(yaw), np.sin(yaw)
            foot = np.column_stack(
                [c * foot[:, 0] + s * foot[:, 1], c * foot[:, 1] - s * foot[:, 0]]
            )
        columns |= {f"foot_{leg}_x": foot[:, 0], f"foot_{leg}_y": foot[:, 1]}
        columns |= {f"foot_{leg}_z": np.where(stands, -0.3, -0.27), f"contact_{leg}": 1.0 * stands}
    log = swung(seconds=0.1)
    meta = replace(log.meta, robot=None, effects=())
    return replace(log, frame=pd.DataFrame({"t": t, **columns}), meta=meta)


def test_way_lost_by_turning_is_found_where_walks_turn_by_different_amounts():
    calm, wild = creeping(0.2), creeping(0.4)
    # The mean of |cos| is 2 / pi, a little less without the exchanges; the rate grows by half on
    # the mean.
    assert turning_of_feet(calm) == pytest.approx(0.3 * 2.0 / np.pi / LEG_SPEED, rel=0.03)
    assert turning_of_feet(creeping(0.4, sticks=True)) < 0.02 * turning_of_feet(wild)
    assert travel_share([wild]) == pytest.approx(2.0 * travel_share([calm]), rel=0.03)
    size = lost_by_turning([calm, wild])
    assert size == pytest.approx(LOST, rel=0.03)
    left = stance_travel(with_share(wild, size * turning_of_feet(wild))).lost
    assert abs(left.sum()) < 0.05 * stance_travel(wild).lost.sum()
    (row,) = lost_way_table([calm]).to_dict("records")
    assert row["lost for each radian [mm]"] == f"{1e3 * lost_by_turning([calm]):.0f}"
    assert float(row["lost at each stance of FL, RR [mm]"]) == pytest.approx(12.0, abs=1.0)
    assert float(row["lost at each stance of FR, RL [mm]"]) == pytest.approx(12.0, abs=1.0)
    pairs = single_stances_table([calm, wild]).set_index("standing")["lost for each radian [mm]"]
    for pair in ("FL, RR", "FR, RL"):
        slope, half_width = map(float, pairs[pair].split(" ± "))
        assert slope == pytest.approx(1e3 * LOST, rel=0.05)
        assert half_width < 20.0


def test_forces_tell_feet_that_slide_from_legs_that_yield():
    log = creeping(0.3)
    feet = {leg: log.legs.index(leg) for leg in ("RL", "RR")}
    v_x = np.gradient(log.ref_p[:, 0], log.t)
    columns = {}
    for leg, k in feet.items():
        stands = log.contact[:, k]
        slip_x = (
            v_x - log.gyro[:, 2] * log.foot_I[:, k, 1] + np.gradient(log.foot_I[:, k, 0], log.t)
        )
        load = 11.0 + 50.0 * np.roll(stands, 4)
        columns[f"x_toe_force_{leg}_z"] = load
        columns[f"x_toe_force_{leg}_x"] = np.where(
            stands, -80.0 * slip_x, -0.4 * load * np.sign(slip_x)
        )
        columns[f"x_toe_force_{leg}_y"] = 0.1
    (row,) = forces_table([replace(log, frame=log.frame.assign(**columns))]).to_dict("records")
    assert row["contacts after load, level by feet [ms]"] == "-40"
    assert row["contacts after load, level by accelerometer [ms]"] == "-40"
    assert float(row["friction of scraping toes"]) == pytest.approx(0.4, abs=0.03)
    assert float(row["force against slip, fore-aft"]) > 0.9
    assert abs(float(row["its rate against slip, fore-aft"])) < 0.3
