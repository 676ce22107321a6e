"""The loop: what a trace found is put into the simulation, and what is learnt there is worth it."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from refusals import refused
from synthetic import synthetic_walk, without

from surefoot import Robot, Scenario, TrainSettings, calibrate, train
from surefoot.extend import Ground, Segment, declared_model, effect, prediction_errors
from surefoot.scenarios.datasets import kept_walks
from surefoot.scenarios.datasets.as_walked import load_as_walked
from surefoot.scenarios.settings import LoopSettings
from surefoot.scenarios.trace import realism
from surefoot.scenarios.trace.loop import RECIPE, inputs_of, loop
from surefoot.scenarios.trace.observer_errors import (
    ERROR_PARTS,
    excess,
    root_mean_square,
    split_errors,
    tuned_on_measured,
)
from surefoot.scenarios.trace.realism import choose_gait
from surefoot.scenarios.trace.training_walks import (
    NEAREST,
    TrainingPlan,
    TrainingWalks,
    WalkedStyle,
    beyond_simulated,
    drawn_sizes,
    rates_as_of,
    simulate_training,
    simulated_robot,
    style_that_walks,
    with_style_share,
)
from surefoot.sim.common.files import bundled
from surefoot.sim.gait.options import GaitOptions
from surefoot.sim.walk import Fallen, walk
from surefoot.sim.walking.imitation import walking_style

pytestmark = pytest.mark.usefixtures("own_cache")
SHORT = TrainingPlan(walks=1, seconds=4.0, calibration=4.0)


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


def test_training_walks_have_the_effects_and_are_seen_by_a_model_that_knows_them(robot, log):
    shown = walking_style(log, robot)
    plain = simulate_training(TrainingWalks(shown, robot), 0, SHORT)
    offset = effect("encoder_offset", "FR_thigh", 0.05)
    with_offset = simulate_training(TrainingWalks(shown, robot, [offset]), 0, SHORT)
    assert [len(with_offset[0]), len(plain[0])] == [1, 1]
    # An encoder's offset changes readings alone; undone, the walk is the one without it but for the
    # encoder's step.
    np.testing.assert_allclose(with_offset[1].q, plain[1].q, atol=5e-4)
    stretched = TrainingWalks(shown, robot, [effect("link_length", "FR_thigh", 0.03)])
    longer = simulate_training(stretched, 0, SHORT)
    assert np.abs(longer[1].q - plain[1].q).max() > 0.01


def test_after_a_fall_another_walk_is_drawn_before_a_slower_one(robot, log, monkeypatch):
    tried = []

    def falls_at_first(scenario, robot, seed, *others):
        tried.append((sum(abs(one.forward) for one in scenario.segments), seed))
        if len(tried) < 5:
            raise Fallen("the robot fell", 1.0, "tilted")
        return walk(scenario, robot, seed, *others)

    monkeypatch.setattr(kept_walks, "walk", falls_at_first)
    simulate_training(TrainingWalks(walking_style(log, robot), robot), 0, replace(SHORT, walks=0))
    speeds, seeds = np.array(tried).T
    assert list(seeds) == [0, 1, 2, 0, 1]
    np.testing.assert_allclose(speeds[3:], 0.8 * speeds[:2])
    assert len(set(speeds[:3])) == 3  # another course each time


SPREAD_HIPS = np.tile([0.4, 0.0, 0.0], 4)
"""Shift of a posture [rad] with which the robot falls."""


def test_a_robot_that_falls_with_the_logs_style_walks_with_the_nearest(robot, log):
    shown = walking_style(log, robot)
    upright = {"before": TrainingWalks(shown, robot)}
    assert style_that_walks(upright, 0, SHORT) == WalkedStyle()
    style = replace(shown, q_stance=shown.q_stance + SPREAD_HIPS)
    found = style_that_walks({"before": TrainingWalks(style, robot)}, 0, SHORT)
    assert 0.0 < found.share < 1.0
    assert f"{100 * found.share:.0f} % of the log's" in found.words
    walks = TrainingWalks(style, robot)
    for share, falls in ((found.share, False), (found.share + NEAREST, True)):
        nearer = with_style_share(walks, share)
        expected = robot.q_home + share * (style.q_stance - robot.q_home)
        np.testing.assert_allclose(nearer.style.q_stance, expected)
        if falls:
            refused("falls", simulate_training, nearer, 0, SHORT)
        else:
            simulate_training(nearer, 0, SHORT)


def test_a_world_in_which_it_falls_with_any_style_has_no_observers(robot, log, monkeypatch):
    def falls_if_heavy(scenario, robot, seed, effects, *others):
        if effects:
            raise Fallen("the robot fell", 1.0, "tilted")
        return walk(scenario, robot, seed, effects, *others)

    monkeypatch.setattr(kept_walks, "walk", falls_if_heavy)
    shown, heavy = walking_style(log, robot), [effect("payload", "all", 1.0)]
    walks = {"before": TrainingWalks(shown, robot), "after": TrainingWalks(shown, robot, heavy)}
    found = style_that_walks(walks, 0, replace(SHORT, walks=0))
    assert found == WalkedStyle(1.0, ("after",))
    assert style_that_walks({"after": walks["after"]}, 0, SHORT).fallen == ("after",)


def test_sizes_are_drawn_for_each_walk_and_compensated_as_found(robot, log):
    """A walk whose encoder is off by another angle than was found keeps the difference."""
    found, deviation = effect("encoder_offset", "FR_thigh", 0.05), 0.01
    spread = {("encoder_offset", "FR_thigh"): deviation}
    shown = walking_style(log, robot)
    plan = replace(SHORT, walks=3)
    as_found = simulate_training(TrainingWalks(shown, robot, [found]), 0, plan)
    drawn = simulate_training(TrainingWalks(shown, robot, [found], spread=spread), 0, plan)
    off = []
    for one, other in zip([*as_found[0], as_found[1]], [*drawn[0], drawn[1]], strict=True):
        difference = other.q - one.q
        joint = one.joints.index("FR_thigh")
        off.append(np.median(difference[:, joint]))
        assert np.abs(difference[:, joint] - off[-1]).max() < 5e-4  # steps of the encoder
        assert np.abs(np.delete(difference, joint, axis=1)).max() == 0.0
    assert len(np.unique(off)) == 4
    assert 0.0 < np.abs(off).max() < 4 * deviation
    known = effect("link_length", "FR_thigh", 0.01)
    assert drawn_sizes([found, known], spread, np.random.default_rng(0))[1] == known


def test_training_walks_say_how_the_imu_is_mounted_that_their_observer_learns_with(robot, log):
    declared = replace(robot, p_BI=np.array([0.1, 0.0, 0.02]))
    turned = effect("mounting_rotation", "x", 0.05)
    walks = TrainingWalks(walking_style(log, robot), declared, [turned])
    _, calibration = simulate_training(walks, 0, SHORT)
    known = Robot.for_log(calibration)
    np.testing.assert_allclose(known.p_BI, declared.p_BI)
    np.testing.assert_allclose(known.R_BI, turned.compensate(log, declared)[1].R_BI, atol=1e-12)


def test_rates_are_those_that_a_filter_has_of_the_measured_log(log):
    assert rates_as_of(log, log) is log
    bare = without(log, "dq_")
    derived = rates_as_of(log, bare)
    assert not np.array_equal(derived.dq, log.dq)
    # Of the past alone: what comes later changes nothing.
    early = rates_as_of(log.rows(slice(0, 1000)), bare)
    np.testing.assert_array_equal(early.dq, derived.dq[:1000])


def test_errors_are_split_into_what_they_were_made_of():
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(3000)
    motion = rng.normal(size=(3000, 4))
    phase, moves = (t / 0.5) % 1.0, t > 1.0
    made = {
        "constant": np.tile([0.1, 0.0, -0.05], (3000, 1)),
        "with the motion": motion @ np.full((4, 3), 0.02),
        "slow": 0.05 * np.sin(2 * np.pi * t / 7.0)[:, None] * np.ones(3),
        "with the stride": 0.04 * np.sin(4 * np.pi * phase)[:, None] * np.ones(3),
    }
    errors = sum(made.values()) + rng.normal(0.0, 0.01, (3000, 3))
    parts = split_errors(errors, motion, phase, moves)
    assert tuple(parts) == tuple(ERROR_PARTS)
    np.testing.assert_allclose(sum(parts.values()), errors[moves], atol=1e-12)
    for name, true in made.items():
        assert np.sqrt(((parts[name] - true[moves]) ** 2).mean()) < 0.01, name
    # A log without contacts has no phase: nothing is said of the stride.
    assert not split_errors(errors, motion, None, moves)["with the stride"].any()


def test_what_measured_errors_have_beyond_simulated_ones_is_shared_by_squares():
    still = {name: [0.01, 0.02, 0.01] for name in ERROR_PARTS}
    more = still | {"constant": [0.01, 0.04, 0.01], "fast": [0.05, 0.02, 0.01], "slow": [0.0] * 3}
    shares = excess(still, more)
    assert list(shares)[:2] == ["fast", "constant"]
    assert shares["fast"] == pytest.approx(2 * shares["constant"])
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["slow"] == 0.0


def test_the_gait_that_is_more_like_the_logs_is_taken(robot, log, monkeypatch):
    counts = {"the plain gait": (9, 17), "the gait as walked": (12, 3)}

    def compared(log, robot, simulating, seed, progress):
        like, unlike = counts[simulating.words]
        rows = SimpleNamespace(counts={"like": like, "unlike": unlike}, rows=())
        return SimpleNamespace(words=simulating.words, card=rows)

    monkeypatch.setattr(realism, "compare_walks", compared)
    assert choose_gait(log, robot, (), 0).gait == load_as_walked().gait
    counts["the plain gait"] = (12, 3)
    assert choose_gait(log, robot, (), 0).gait == GaitOptions()


def test_a_log_without_contacts_is_imitated_in_the_plain_gait(robot, log):
    assert choose_gait(without(log, "contact_"), robot, (), 0).gait == GaitOptions()


@pytest.mark.parametrize(
    ("dropped", "inputs"), [((), "gyro,contact,feet"), (("contact_", "force_"), "gyro,feet")]
)
def test_an_observer_reads_what_the_measured_log_has(log, dropped, inputs):
    assert inputs_of(without(log, *dropped)) == inputs


def test_another_loops_folder_is_left_alone(robot, log, tmp_path):
    (tmp_path / RECIPE).write_text(json.dumps({"log": "another"}))
    refused("not empty", loop, log, robot, LoopSettings(tmp_path))
    refused("ref", loop, without(log, "ref_"), robot, LoopSettings(tmp_path / "new"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "target", "value"),
    [("link_length", "RL_thigh", 0.03), ("encoder_offset", "FL_calf", 0.06)],
)
def test_the_loop_recovers_most_of_what_knowing_the_effect_would_gain(
    name, target, value, robot, tmp_path
):
    course = Scenario.load(bundled("surefoot.scenarios", "courses") / "demo" / "walk.toml")
    hidden = effect(name, target, value)
    measured = walk(course, robot, 11, [hidden], declared=False)
    out = tmp_path / "loop"
    loop(measured, robot, LoopSettings(out))
    worlds = json.loads((out / "loop.json").read_text())["worlds"]
    rmse = {
        world_name: np.linalg.norm(world["observer_errors"]["measured"]["all"])
        for world_name, world in worlds.items()
    }
    walks = TrainingWalks(walking_style(measured, robot), robot, [hidden])
    training, _ = simulate_training(walks, 0)
    declared = replace(measured, meta=replace(measured.meta, effects=(hidden.as_dict(),)))
    trained = train(training, settings=TrainSettings(inputs=inputs_of(measured)))
    errors = prediction_errors(trained, *declared_model(declared, robot))[1]
    known = np.linalg.norm(np.sqrt((errors**2).mean(axis=0)))
    gain = rmse["before"] - known
    print(f"\n{name} {target}: {rmse} m/s, {known:.4f} with the true effect")
    assert rmse["after"] <= 1.1 * known
    # An observer may have learnt to live with what it was not told: then there is nothing to gain.
    if name == "link_length":
        assert gain > 0.3 * rmse["before"]
        assert rmse["before"] - rmse["after"] >= 0.8 * gain


def test_an_observer_tuned_on_half_a_walk_is_judged_on_the_other():
    how = TrainSettings(inputs="q,dq", model="mlp", steps=150)
    robot = Robot.load("spot_class")
    observer = train(synthetic_walk(0, 48.0, robot="spot_class"), robot, how)
    bounds = calibrate(observer, synthetic_walk(1, 48.0, robot="spot_class"))
    measured = synthetic_walk(2, 48.0, robot="spot_class")
    frame = measured.frame.copy()
    frame[[name for name in frame if name.startswith("dq_")]] *= 0.8  # joints report too little
    measured = replace(measured, frame=frame)
    found = tuned_on_measured(observer, bounds, measured, robot, how)
    errors = prediction_errors(observer, measured, robot)[1]
    assert np.linalg.norm(found.rmse) < 0.8 * np.linalg.norm(root_mean_square(errors))
    untuned = np.all(np.abs(errors) <= bounds.epsilon, axis=1).mean()
    assert found.held is not None
    assert abs(found.held - bounds.gamma) < 0.15 < bounds.gamma - untuned
