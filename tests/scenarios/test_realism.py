"""The realism card as a command: a log beside simulated walks in its manner, as files."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from refusals import refused
from synthetic import without

from surefoot import Robot, Scenario, walk
from surefoot.extend import Ground, Segment, Sensors, effect
from surefoot.models.realism import card
from surefoot.models.realism.card import tolerances
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.datasets.as_walked import load_as_walked
from surefoot.scenarios.trace import realism as module
from surefoot.sim.gait.controller import gait_for
from surefoot.sim.gait.options import GaitOptions

DRAWN = module.SimulatedRobot("as drawn")


@pytest.fixture(scope="module")
def measured(robot):
    """A walk with a long duty factor and jitter, logged at 400 Hz."""
    gait = GaitOptions(duty=0.72, unloading=0.05, period_jitter=0.04)
    course = (Segment(4.0, 0.4), Segment(4.0, 0.7, 0.0, 0.2))
    scenario = Scenario(
        "own", course, Ground(0.8), "spot_class", gait=gait, sensors=Sensors(rate=400.0)
    )
    return walk(scenario, robot, 7)


@pytest.fixture(autouse=True)
def one_walk(monkeypatch, own_cache):
    monkeypatch.setattr(module, "WALKS_EACH", 1)
    monkeypatch.setattr(card, "DRAWS", 60)


def test_the_command_writes_the_card_and_the_pictures(measured, tmp_path):
    measured.write(tmp_path / "own.parquet")
    main(f"realism {tmp_path}/own.parquet -o {tmp_path}/out --page {tmp_path}/realism.md".split())
    drawn = json.loads((tmp_path / "out" / "realism.json").read_text())["as drawn"]
    rows = {row["quantity"]: row for row in drawn["rows"]}
    assert set(rows) | set(drawn["missing"]) == set(tolerances())
    assert rows["stride period"]["verdict"] == "like"
    assert rows["duty factor"]["verdict"] == "unlike"
    assert rows["duty factor"]["difference"] < -0.05
    report = (tmp_path / "out" / "report.html").read_text()
    assert report.count("data:image/png") == 3
    drift = pd.read_csv(tmp_path / "out" / "drift.csv")
    np.testing.assert_allclose(drift["ratio"], drift["simulated"] / drift["measured"], rtol=1e-3)
    assert "| digest | `" in (tmp_path / "realism.md").read_text()


def test_a_robot_that_walks_as_the_measured_one_is_more_like_it(measured, robot):
    drawn = module.compare_walks(measured, robot, DRAWN)
    gait = GaitOptions(duty=0.72, unloading=0.05, period_jitter=0.04)
    walked = replace(load_as_walked(), gait=gait, sensors={}, size=())
    alike = module.compare_walks(measured, robot, module.SimulatedRobot("as walked", walked=walked))
    verdicts = [{r.quantity: r.verdict for r in c.card.rows} for c in (drawn, alike)]
    assert verdicts[0]["duty factor"] == "unlike"
    assert verdicts[1]["duty factor"] == "like"
    assert alike.card.counts["unlike"] < drawn.card.counts["unlike"]


def test_the_drift_of_the_leg_filter_tells_what_the_legs_lack(measured, robot):
    """By a model with points for feet, and by the file's; on feet that roll less than it says."""
    points, less = replace(robot, foot_radius=np.zeros(4)), robot.foot_radius.mean() - 0.01
    rolls = module.SimulatedRobot("simulated", [effect("foot_rolling", "all", less)])
    whole, alike, other = (
        module.drift_row(module.compare_walks(measured, model, simulating))
        for model, simulating in ((robot, DRAWN), (points, DRAWN), (points, rolls))
    )
    assert alike["measured"] == other["measured"] > 5.0 * whole["measured"]
    assert alike["ratio"] == pytest.approx(1.0, abs=0.15)
    assert other["ratio"] < 0.8 * alike["ratio"]
    assert (alike["within 15 %"], other["within 15 %"]) == ("yes", "no")
    # Student's t of two degrees of freedom: 4.303 standard errors.
    _, low, high = module.ratio_of_drifts(0.1, (0.09, 0.10, 0.11))
    np.testing.assert_allclose(
        [low, high], 1.0 + 0.1 * 4.303 / np.sqrt(3.0) * np.array([-1, 1]), rtol=1e-3
    )
    assert np.isnan(module.ratio_of_drifts(0.1, (0.09,))[1:]).all()


def test_another_robot_is_judged_by_what_is_carried_to_its_size(measured, robot):
    walker = Robot.load("v60_class")
    found = module.compare_walks(measured, robot, replace(DRAWN, walker=walker))
    unscaled = module.compare_walks(measured, robot, DRAWN)
    assert {one.robot.name for one in found.simulated} == {"v60_class"}
    rows, plain = ({r.quantity: r for r in c.card.rows} for c in (found, unscaled))
    longer = walker.leg_length / robot.leg_length
    slower = gait_for(walker, 0.0).period / plain["stride period"].measured
    for name, factor in (
        ("stride period", slower),
        ("foothold jitter, forward", longer),
        ("forward speed", longer / slower),
        ("duty factor", 1.0),
    ):
        assert rows[name].measured == pytest.approx(factor * plain[name].measured)
        assert rows[name].tolerance == pytest.approx(factor * plain[name].tolerance)
    assert rows["forward speed"].simulated == pytest.approx(rows["forward speed"].measured, rel=0.2)


def test_a_simulated_log_is_seen_with_the_measured_ones_columns(measured, robot):
    seen = module.seen_as(measured, without(measured, "dq_", "tau_", "ref_v_"), [0])
    assert not any(seen.has(group) for group in ("dq", "tau", "ref_v"))
    assert seen.has("force")


def test_a_fall_is_one_clear_line(measured, robot):
    """A robot that nothing holds level, with a load before its feet."""
    soft = [effect("payload", "all", 30.0), effect("com_offset", "x", 0.2)]
    heavy = replace(load_as_walked(), gait=GaitOptions(level=0.0, duty=0.4), size=())
    falling = module.SimulatedRobot("falling", soft, heavy)
    said = "spot_class falls in simulation with the stride"
    refused(said, module.compare_walks, measured, robot, falling)


def test_a_missing_column_is_one_clear_line(measured, tmp_path):
    without(measured, "contact_").write(tmp_path / "bare.parquet")
    line = f"realism {tmp_path}/bare.parquet -o {tmp_path}/out"
    refused("bare: the log lacks contact", main, line.split(), error=SystemExit)
    assert not (tmp_path / "out").exists()
