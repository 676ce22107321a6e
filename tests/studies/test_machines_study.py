"""What the studies of measured machines fit, on machines whose answer is known."""

from dataclasses import replace

import numpy as np
import pytest
from creeping import LOST, creeping
from pendulum import swung

from studies.hardware import walks_by_feet
from studies.hardware.creeping_feet import forces_table, lost_way_table, single_stances_table
from studies.hardware.walks_by_feet import end_error
from surefoot.estimator.evaluation.trajectory import reference
from surefoot.sim.plausibility.finding import Finding


def test_a_log_stands_once_beside_what_was_found_in_it_twice(monkeypatch):
    said = [Finding(("t",), evidence, "lost rows") for evidence in ("at 2 s", "at 5 s")]
    monkeypatch.setattr(walks_by_feet, "check_log", lambda log: said)
    logs = [replace(swung(seconds=0.1), name=name) for name in ("walk", "sway")]
    assert walks_by_feet.findings_table(logs)["logs"].tolist() == ["walk, sway"]


def test_the_end_error_is_a_share_of_the_path(log):
    truth = reference(log)
    assert end_error(log, truth) == pytest.approx(0.0, abs=1e-9)
    half = replace(truth, p_GI=truth.p_GI[0] + 0.9 * (truth.p_GI - truth.p_GI[0]))
    assert 5.0 < end_error(log, half) < 10.5


def test_way_lost_by_turning_is_seen_from_stance_to_stance():
    calm, wild = creeping(0.2), creeping(0.4)
    (row,) = lost_way_table([calm]).to_dict("records")
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
