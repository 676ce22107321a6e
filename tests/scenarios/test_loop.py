"""The loop: what a trace found is put into the simulation, and what is learnt there is worth it."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from refusals import refused
from synthetic import synthetic_walk, without

from surefoot import CalibrateSettings, Robot, Scenario, TrainSettings, calibrate, train
from surefoot.extend import Ground, Segment, effect, prediction_errors
from surefoot.models.observer import training
from surefoot.models.observer.observer import log_digest
from surefoot.models.registry import LOSSES
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.settings import LoopSettings
from surefoot.scenarios.trace import loop as loop_module
from surefoot.scenarios.trace import loop_report
from surefoot.scenarios.trace.loop import (
    RECIPE,
    ends,
    loop,
    seen_as_measured,
    with_rates,
)
from surefoot.scenarios.trace.realism import beyond_simulated, simulated_robot
from surefoot.scenarios.training.many_walks import DrawnWalks, OwnEffects
from surefoot.sim.common.files import bundled
from surefoot.sim.walk import walk

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def log(robot):
    segments = (Segment(4.0, 0.6), Segment(4.0, 0.5, 0.0, 0.4))
    return walk(Scenario("measured", segments, Ground(0.8), "spot_class"), robot, 3)


def test_the_simulated_robot_has_the_files_feet_and_the_declared_mounting(robot):
    declared = replace(robot, foot_radius=np.zeros(4), p_BI=np.array([0.1, 0.0, 0.02]))
    simulated = simulated_robot(declared)
    np.testing.assert_array_equal(simulated.foot_radius, robot.foot_radius)
    np.testing.assert_array_equal(simulated.p_BI, declared.p_BI)
    # Point feet of which 30 mm were found lacking roll at 30 mm, whatever the file's radius is.
    (added,) = beyond_simulated([effect("foot_rolling", "all", 0.03)], declared, simulated)
    assert added.value == pytest.approx(0.03 - robot.foot_radius.mean())
    same = [effect("link_length", "FL_calf", 0.01)]
    assert beyond_simulated(same, declared, simulated) == tuple(same)


def test_a_drawn_walk_has_the_machines_effects_in_place_of_those_of_its_kind(robot):
    """Walk 1 is of a robot with encoder offsets of its kind; the machine's own is known."""
    number = next(
        k
        for k in range(20)
        if any(e.name == "encoder_offset" for e in _drawn(robot, k, OwnEffects()).effects)
    )
    own = effect("encoder_offset", "FR_thigh", 0.05)
    found = _drawn(robot, number, OwnEffects([own])).effects
    assert [e for e in found if e.name == "encoder_offset"] == [own]
    others = {e.name for e in _drawn(robot, number, OwnEffects()).effects}
    assert {e.name for e in found} == others


def test_sizes_are_drawn_for_each_walk_from_their_intervals(robot):
    own, known = effect("encoder_offset", "FR_thigh", 0.05), effect("link_mass", "FR_calf", 0.1)
    spread = {("encoder_offset", "FR_thigh"): 0.01}
    drawn = [_drawn(robot, k, OwnEffects([own, known], spread)).effects[-2:] for k in range(40)]
    assert {effects[1] for effects in drawn} == {known}
    sizes = np.array([effects[0].value for effects in drawn])
    # Of 40 draws the mean is within three of its standard errors, the deviation within a half.
    assert abs(sizes.mean() - 0.05) < 3 * 0.01 / np.sqrt(40)
    assert 0.005 < sizes.std() < 0.015
    # A foot that is said to lift off before it does cannot be simulated.
    late, wide = effect("contact_delay", "liftoff", 0.01), {("contact_delay", "liftoff"): 0.1}
    delays = [_drawn(robot, k, OwnEffects([late], wide)).effects[-1].value for k in range(20)]
    assert min(delays) == 0.0 < max(delays)
    # Nor can a foot with a radius below zero: the sizes that are left are of one distribution.
    smaller = effect("foot_rolling", "all", -0.9 * robot.foot_radius[0])
    own = OwnEffects([smaller], {("foot_rolling", "all"): 0.5 * robot.foot_radius[0]})
    radii = [robot.foot_radius[0] + _drawn(robot, k, own).effects[-1].value for k in range(40)]
    assert 0.0 < min(radii) < 0.2 * robot.foot_radius[0] < max(radii)
    assert len(set(radii)) == 40


def _drawn(robot, number, own):
    return DrawnWalks(robot, "train", 0, own=own).walk(number, 0)


def test_a_simulated_walk_is_seen_with_the_effects_compensated_as_found(robot, log):
    """A walk whose encoder is off by another angle than was found keeps the difference."""
    found = effect("encoder_offset", "FR_thigh", 0.05)
    shifted = log.frame.assign(q_FR_thigh=log.frame["q_FR_thigh"] + 0.06)
    seen = seen_as_measured([found], robot, True, replace(log, frame=shifted))
    off = np.median(seen.q - log.q, axis=0)
    assert off[log.joints.index("FR_thigh")] == pytest.approx(0.01)
    assert np.count_nonzero(np.abs(off) > 1e-6) == 1


def test_it_says_how_the_imu_is_mounted_that_its_observer_learns_with(robot, log):
    declared = replace(robot, p_BI=np.array([0.1, 0.0, 0.02]))
    turned = effect("mounting_rotation", "x", 0.05)
    seen = seen_as_measured([turned], declared, True, log)
    known = Robot.for_log(seen)
    np.testing.assert_allclose(known.p_BI, declared.p_BI)
    np.testing.assert_allclose(known.R_BI, turned.compensate(log, declared)[1].R_BI, atol=1e-12)


def test_rates_are_those_that_a_filter_has_of_the_measured_log(log):
    assert with_rates(log, True) is log
    derived = with_rates(log, False)
    assert not np.array_equal(derived.dq, log.dq)
    # Of the past alone: what comes later changes nothing.
    early = with_rates(log.rows(slice(0, 1000)), False)
    np.testing.assert_array_equal(early.dq, derived.dq[:1000])


def test_another_loops_folder_is_left_alone(robot, log, tmp_path):
    (tmp_path / RECIPE).write_text(json.dumps({"log": "another"}))
    refused("not empty", loop, log, robot, LoopSettings(tmp_path))
    refused("ref", loop, without(log, "ref_"), robot, LoopSettings(tmp_path / "new"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "target", "value"),
    [("link_length", "RL_thigh", 0.03), ("encoder_offset", "FL_calf", 0.06)],
)
def test_the_loop_finds_what_was_hidden_and_the_filters_gain(name, target, value, robot, tmp_path):
    course = Scenario.load(bundled("surefoot.scenarios", "courses") / "demo" / "walk.toml")
    measured = walk(course, robot, 11, [effect(name, target, value)], declared=False)
    loop(measured, robot, LoopSettings(tmp_path / "loop", walks=8))
    found = json.loads((tmp_path / "loop" / "loop.json").read_text())
    steps = {step: values["filters"] for step, values in found["steps"].items()}
    assert [(e["name"], e["target"]) for e in found["trace"]["effects"]] == [(name, target)]
    errors = {step: filters["leg"]["ape_trans"] for step, filters in steps.items()}
    assert errors["after"] < 0.5 * errors["before"]
    observers = {(o["step"], o["loss"]): o["norm [m/s]"] for o in found["observers"]}
    assert observers["after", "gml"] < observers["before", "gml"]


def test_an_observer_tuned_on_one_end_is_judged_on_the_other(tmp_path, monkeypatch):
    how = TrainSettings(inputs="q,dq", model="mlp", steps=150)
    robot = Robot.load("spot_class")
    observers = tuple(
        train(synthetic_walk(0, 48.0, robot="spot_class"), robot, replace(how, loss=loss))
        for loss in LOSSES
    )
    unseen = synthetic_walk(1, 48.0, robot="spot_class")
    learnt = Learnt(
        observers, tuple(calibrate(one, unseen, CalibrateSettings(K=50)) for one in observers)
    )
    measured = synthetic_walk(2, 60.0, robot="spot_class")
    frame = measured.frame.copy()
    frame[[name for name in frame if name.startswith("dq_")]] *= 0.8  # joints report too little
    measured = replace(measured, frame=frame)
    first, last = ends(measured)
    assert first.t[-1] < last.t[0] - 0.15 * (measured.t[-1] - measured.t[0])
    tuned = loop_module._tuned(learnt, measured, robot, tmp_path, how)
    trained_on = [one.observers[0].logs[-1].sha256 for one in tuned]
    assert trained_on == [log_digest(last), log_digest(first)]
    rows = [
        _error(one.observers[0], end, robot) for one, end in zip(tuned, (first, last), strict=True)
    ]
    assert np.mean(rows) < 0.8 * np.mean(
        [_error(observers[0], end, robot) for end in (first, last)]
    )
    # A second run takes what the first one made.
    monkeypatch.setattr(training, "train", None)
    again = loop_module._tuned(learnt, measured, robot, tmp_path, how)
    assert [one.observers[0].hash for one in again] == [one.observers[0].hash for one in tuned]


def _error(observer, log, robot):
    return np.linalg.norm(prediction_errors(observer, log, robot)[1], axis=1).mean()


def test_the_findings_name_the_filters_that_distrust_themselves():
    def said(**lost: str) -> str:
        steps: Any = [SimpleNamespace(name=name, ends=[ends(of)]) for name, of in lost.items()]
        return loop_report._distrusted(steps)

    def ends(lost: str) -> SimpleNamespace:
        ran = [SimpleNamespace(filter=f, health=SimpleNamespace(lost=f in lost)) for f in "abc"]
        return SimpleNamespace(results=ran)

    assert "b, c (before); b (tuned)" in said(before="bc", after="", tuned="b")
    assert said(before="", after="") == ""
