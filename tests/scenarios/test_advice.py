"""Advice on an estimate that is not to be trusted names what is wrong with it."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import without

from surefoot.scenarios.cli.main import main
from surefoot.scenarios.estimate.advice import advice, likelihood, needs_advice
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.run import run_filter
from surefoot.scenarios.estimate.settings import (
    FilterSettings,
    NoiseSettings,
    StartSettings,
    StateSettings,
)
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk


@pytest.fixture(scope="module")
def walked() -> tuple[Log, Robot]:
    robot = Robot.load("spot_class")
    return walk(Scenario("advice", (Segment(3.0, 0.8, 0.0, 0.0),), Ground(0.8)), robot, 0), robot


def _advised(log: Log, robot: Robot, settings: FilterSettings) -> str:
    result = run_filter("leg", log, robot, settings=settings)
    assert needs_advice("leg", result.metrics, result.health)
    return advice("leg", log, robot, Learnt(), settings)


def test_a_good_estimate_needs_none(walked):
    log, robot = walked
    for some in (log, without(log, "ref_")):
        result = run_filter("leg", some, robot)
        assert not needs_advice("leg", result.metrics, result.health)


@pytest.mark.parametrize("cut", [("x_",), ("ref_",)], ids=["reference", "no reference"])
def test_contact_noise_that_is_too_small_is_sized_by_the_innovations(walked, cut):
    """Of feet that roll, while the filter takes them for points."""
    log, robot = walked
    log, robot = without(log, *cut), replace(robot, foot_radius=np.zeros(4))
    small = FilterSettings(noise=NoiseSettings(contact=2e-4, encoder=1e-4, kinematics=1e-4))
    said = _advised(log, robot, small)
    assert "filters.leg.contact=" in said
    value = float(said.partition("filters.leg.contact=")[2].partition(",")[0])
    mended = replace(small, filters={"leg": {"contact": value}})
    before, after = (run_filter("leg", log, robot, settings=s) for s in (small, mended))
    assert value > 4e-4
    assert likelihood(after.trajectory) > likelihood(before.trajectory)
    assert not after.health.lost


def test_contacts_that_come_late_are_found(walked):
    log, robot = walked
    names = [f"contact_{leg}" for leg in log.legs]
    rows = np.maximum(np.arange(len(log.t)) - round(0.04 * log.rate), 0)
    late = log.with_columns({name: log.frame[name].to_numpy()[rows] for name in names})
    said = _advised(late, robot, FilterSettings())
    assert "late = { contact = 0.04 }" in said


def test_contacts_of_a_dead_sensor_are_taken_from_another_quantity(walked):
    log, robot = walked
    dead = log.with_columns({"contact_FL": np.ones(len(log.t))})
    said = _advised(dead, robot, FilterSettings())
    assert 'of = "' in said
    assert "in [contact]" in said


def test_a_start_that_was_given_wrong_is_found(walked):
    log, robot = walked
    wrong = FilterSettings(start=StartSettings(b_g=1e-4), state=StateSettings(b_g=(0.05, 0.0, 0.0)))
    assert "of start and state" in _advised(log, robot, wrong)


def test_advice_that_mends_nothing_is_not_given(walked):
    log, robot = walked
    lost = log.with_columns({"gyro_x": 0.5 * log.t})
    assert "no single change" in _advised(lost, robot, FilterSettings())


def test_estimate_prints_it_and_the_imu_alone_is_not_silent(walked, tmp_path, capsys):
    log, _ = walked
    path = tmp_path / "walk.parquet"
    log.write(path)
    main(["estimate", str(path), "--filter", "leg"])
    shown = capsys.readouterr()
    assert "advice: " not in shown.err
    assert "no trajectory is kept" in shown.out
    main(["estimate", str(path), "--filter", "imu", "-o", str(tmp_path / "imu.parquet")])
    shown = capsys.readouterr()
    assert "advice: imu " in shown.err
    assert str(tmp_path / "imu.tum") in shown.out
