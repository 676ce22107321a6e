"""What resists a drive's motion is no difference between what it was asked for and what it did."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import synthetic_walk

from surefoot.models.attribution.evidence import linearise, log_under_model, table_of
from surefoot.models.attribution.metric import metric_of
from surefoot.models.attribution.noise_floor import noise_floor
from surefoot.models.residuals.channels import commanded_torque
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

ROBOT = Robot.load("spot_class")
COURSE = Scenario("stiff", (Segment(6.0, 0.5, turn=0.3), Segment(6.0, 0.6)), Ground(0.8))
STIFF = effect("viscous_friction", "FR_thigh", 0.8)


@pytest.fixture(scope="module")
def log():
    return walk(COURSE, ROBOT, 2, [STIFF], declared=False)


@pytest.mark.parametrize("with_ahead", [True, False])
@pytest.mark.parametrize("with_rates", [True, False])
def test_a_motors_law_asks_for_what_it_says(with_ahead, with_rates):
    """kp (q_des - q) + kd (dq_des - dq) + tau_ff, of what the log has."""
    rng, log = np.random.default_rng(8), synthetic_walk(0, 1.0, robot="spot_class")
    n, joints = len(log.t), log.joints
    q_des, dq_des, ahead = rng.normal(size=(3, n, 12))
    columns = {f"q_des_{j}": q_des[:, i] for i, j in enumerate(joints)}
    if with_rates:
        columns |= {f"dq_des_{j}": dq_des[:, i] for i, j in enumerate(joints)}
    if with_ahead:
        columns |= {f"tau_ff_{j}": ahead[:, i] for i, j in enumerate(joints)}
    kp, kd = 20.0 + np.arange(12.0), 1.0 + 0.1 * np.arange(12.0)
    meta = replace(log.meta, motor_law={"kp": list(kp), "kd": list(kd)})
    asked = commanded_torque(replace(log, frame=log.frame.assign(**columns), meta=meta))
    assert asked is not None
    law = kp * (q_des - log.q) + kd * (with_rates * dq_des - log.dq)
    np.testing.assert_allclose(asked, law + with_ahead * ahead, atol=1e-9)


@pytest.mark.parametrize(
    "name", ["viscous_friction", "coulomb_friction", "load_friction", "armature"]
)
@pytest.mark.parametrize("by_law", [False, True])
def test_what_a_drive_takes_is_taken_of_what_was_asked_too(log, name, by_law):
    if by_law:
        # Only what a motor's law asks for was logged.
        frame = log.frame.drop(columns=[c for c in log.frame if str(c).startswith("tau_ff_")])
        desired = {f"q_des_{j}": log.columns[f"q_{j}"] + 0.1 for j in log.joints}
        law = {gain: [20.0] * len(log.joints) for gain in ("kp", "kd")}
        log = replace(log, frame=frame.assign(**desired), meta=replace(log.meta, motor_law=law))
    less, _ = effect(name, "FR_thigh", 0.3).compensate(log, ROBOT)
    assert np.abs(less.tau - log.tau).max() > 0.05
    before, after = (one.tau - commanded_torque(one) for one in (log, less))
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_friction_of_a_robot_that_logs_its_commands_is_measured(log):
    case = log_under_model(log, ROBOT)
    key = (STIFF.name, STIFF.target)
    evidence = linearise([case], [], [key])
    assert "command" in evidence.layout
    assert size_of(case, evidence) == pytest.approx(STIFF.value, rel=0.02)


@pytest.mark.long
def test_a_share_of_the_torque_that_a_gear_loses_is_measured_on_a_walk():
    lost = effect("load_friction", "FR_calf", 0.15)
    case = log_under_model(walk(COURSE, ROBOT, 2, [lost], declared=False), ROBOT)
    evidence = linearise([case], [], [(lost.name, lost.target)])
    assert size_of(case, evidence) == pytest.approx(lost.value, rel=0.1)


@pytest.mark.parametrize("late", [3e-4, pytest.param(3.1e-3, marks=pytest.mark.long)])
def test_a_command_delay_is_measured_below_a_row_too(late):
    walked = walk(COURSE, ROBOT, 2, [effect("command_delay", "all", late)], declared=False)
    case, key = log_under_model(walked, ROBOT), ("command_delay", "all")
    known = [effect(*key, 0.9 * late)]
    evidence = linearise([case], known, [key])
    assert known[0].value + size_of(case, evidence) == pytest.approx(late, rel=0.03)
    # The step of a microsecond gives the slope that a hundred of them give.
    narrow, wide = (slope_over(case, key, late, step) for step in (1e-6, 1e-4))
    np.testing.assert_allclose(narrow, wide, atol=1e-6 * np.abs(narrow).max())


def size_of(case, evidence):
    """Size of the only candidate of an evidence."""
    every = np.ones(len(evidence.t), dtype=bool)
    error = replace(
        noise_floor([case]).error, keys=(), mean=np.zeros(0), covariance=np.zeros((0, 0))
    )
    S = metric_of([case], evidence, error, every).S
    return S[1, 0] / S[1, 1]


def slope_over(case, key, late: float, step: float) -> np.ndarray:
    """What a second of the effect adds to the table, by a difference over this step."""
    name, target = key
    ahead, behind = (table_of(case, [effect(name, target, late + s)]) for s in (step, -step))
    return np.nan_to_num((behind - ahead) / (2.0 * step))
