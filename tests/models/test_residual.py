"""Residual channels: the sensors' own noise without an effect, and each effect's signature."""

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from surefoot.models.residuals.binning import STANCE_MARGIN, reference_motion
from surefoot.models.residuals.channels import JointTorque
from surefoot.models.residuals.layout import ResidualTable, layout_for, residual
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import LogError
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import QUADRUPED
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.stances import inside_stances
from surefoot.sim.sensors.streams import Sensors
from surefoot.sim.walk import walk

ROBOT = Robot.load("spot_class")
COURSE = (Segment(4.0, 0.6), Segment(4.0, 0.4, turn=0.6), Segment(2.0, 0.5, turn=-0.6))
EFFECTS = [
    ("encoder_offset", "FL_thigh", 0.03),
    ("link_length", "RR_calf", 0.008),
    ("foot_rolling", "all", 0.008),
    ("imu_rotation", "y", 0.04),
    ("gyro_scale", "x", 0.03),
    ("joint_delay", "all", 0.005),
]


@lru_cache
def log_with(*one):
    effects = [effect(*one)] if one else []
    scenario = Scenario("turns", COURSE, Ground(0.8), stand=0.5)
    return walk(scenario, ROBOT, seed=5, effects=effects, declared=False)


def rms(values):
    return np.sqrt(np.nanmean((values - np.nanmean(values, axis=0)) ** 2))


@dataclass(frozen=True)
class Left:
    """The channels of a residual by name; a foot's velocity is (M, 4, 3)."""

    parts: ResidualTable

    def __getattr__(self, name):
        columns = {"gyro": slice(0, 3), "accel": slice(3, 6), "leg": slice(6, 18)}[name]
        values = self.parts.table[:, columns]
        return values.reshape(-1, 4, 3) if name == "leg" else values

    @property
    def t(self):
        return self.parts.t


def residual_of(log, robot=ROBOT, explained=()):
    frame = reference_motion(log, ROBOT.limbs)
    for one in explained:
        log, robot = one.compensate(log, robot)
    return Left(residual(log, robot, frame))


def test_torques_are_compared_where_the_leg_swings():
    swings = np.ones((9, 2), dtype=bool)
    swings[4:, 1] = False
    steps = SimpleNamespace(swings=swings, bins=SimpleNamespace(tau=np.full((9, 2), 5.0)))
    inputs = SimpleNamespace(
        steps=steps, inverse_dynamics=SimpleNamespace(torque=np.full((9, 2), 3.0))
    )
    left = JointTorque().residual(inputs)  # pyright: ignore[reportArgumentType]
    assert left is not None
    assert_allclose(left[swings], 2.0)
    assert np.isnan(left[~swings]).all()


def test_leg_velocity_is_the_rigid_body_formula():
    """Against the plain vector formula with numpy, foot by foot, on random motions."""
    rng = np.random.default_rng(0)
    q, dq, omega = rng.normal(size=(5, 12)), rng.normal(size=(5, 12)), rng.normal(size=(5, 3))
    up = rng.normal(size=(5, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    turned = replace(ROBOT, R_BI=np.linalg.qr(rng.normal(size=(3, 3)))[0])
    got = turned.feet.imu_velocity(q, dq, omega, up, np.ones((5, 4), bool))
    arm = turned.foot_radius[:, None] * up[:, None]
    jdq = np.einsum("nlij,nlj->nli", turned.feet_jacobian_I(q), dq.reshape(5, 4, 3))
    rolling = np.cross(omega[:, None] + turned.feet.rates_I(q, dq), arm)
    expected = -jdq - np.cross(omega[:, None], turned.feet_I(q)) + rolling
    assert_allclose(got, expected, atol=1e-12)


def test_a_walk_as_declared_leaves_the_noise_of_its_imu():
    """Bins of 20 ms of white noise: density over the root of the bin, and the ADC's rounding."""
    left, s = residual_of(log_with()), Sensors()
    steps = np.hypot(s.gyro_noise / np.sqrt(0.02), s.gyro_range / 2**15 / np.sqrt(12 * 10))
    assert rms(left.gyro) == pytest.approx(steps, rel=0.08)
    assert rms(left.accel) == pytest.approx(s.accel_noise / np.sqrt(0.02), rel=0.08)
    assert np.abs(np.nanmean(left.gyro, axis=0)).max() < 5 * s.gyro_turn_on
    assert np.abs(np.nanmean(left.accel, axis=0)).max() < 5 * s.accel_turn_on


def test_standing_feet_of_a_walk_as_declared_agree_with_the_reference():
    assert rms(residual_of(log_with()).leg) < 3.5e-3


@pytest.mark.parametrize("one", EFFECTS, ids=[name for name, *_ in EFFECTS])
def test_each_effect_shows_and_explaining_it_brings_the_floor_back(one):
    clean, hurt = residual_of(log_with()), residual_of(log_with(*one))
    healed = residual_of(log_with(*one), explained=[effect(*one)])
    channel = {"imu_rotation": "accel", "gyro_scale": "gyro"}.get(one[0], "leg")
    floor = rms(getattr(clean, channel))
    assert rms(getattr(hurt, channel)) > 1.2 * floor
    # A longer leg or a larger foot also lands otherwise, which no correction of readings undoes.
    assert rms(getattr(healed, channel)) < 1.2 * floor


def test_an_encoder_offset_shows_on_its_own_foot_alone():
    change = (
        residual_of(log_with("encoder_offset", "FL_thigh", 0.03)).leg - residual_of(log_with()).leg
    )
    assert rms(change[:, 0]) > 4e-3
    assert_allclose(change[:, 1:], np.where(np.isfinite(change[:, 1:]), 0.0, np.nan), atol=1e-12)


def test_foot_rolling_shows_as_speed_of_every_foot():
    """A radius 8 mm larger at about 0.5 m/s over a leg of 0.55 m: about 7 mm/s too slow."""
    hurt = residual_of(log_with("foot_rolling", "all", 0.008)).leg
    clean = residual_of(log_with()).leg
    slower = np.nanmean(clean[..., 0], axis=0) - np.nanmean(hurt[..., 0], axis=0)
    assert np.all((slower > 4e-3) & (slower < 14e-3))


def test_stance_edges_are_left_out():
    t = 0.01 * np.arange(100)
    contact = np.zeros((100, 4), bool)
    contact[20:60, 0] = True
    contact[:, 1] = True
    inside = inside_stances(t, contact, STANCE_MARGIN, STANCE_MARGIN)
    assert np.flatnonzero(inside[:, 0]).tolist() == list(range(23, 57))
    assert inside[:, 1].all()
    assert not inside[:, 2:].any()


def test_rows_without_a_reference_do_not_count():
    log = log_with()
    frame = log.frame.copy()
    ok = np.ones(len(frame))
    ok[1000:1500] = 0.0
    frame["ref_ok"] = ok
    frame.loc[1000:1499, ["ref_p_x", "ref_v_x"]] += 5.0
    left, plain = residual_of(replace(log, frame=frame)), residual_of(log)
    outside = (left.t < log.t[999]) | (left.t > log.t[1500])
    assert_allclose(left.leg[outside], plain.leg[outside])
    assert np.isnan(left.gyro[101:149]).all()
    assert np.isnan(left.leg[101:149]).all()
    assert rms(left.accel) == pytest.approx(rms(plain.accel), rel=0.05)


def test_without_a_velocity_the_reference_is_differentiated():
    log = log_with()
    names = [n for n in log.frame if not str(n).startswith("ref_v")]
    left = residual_of(replace(log, frame=log.frame[names]))
    assert rms(left.leg) < 2e-2


def test_without_a_reference_there_is_no_residual():
    log = log_with()
    names = [n for n in log.frame if not str(n).startswith("ref_")]
    with pytest.raises(LogError, match="reference"):
        reference_motion(replace(log, frame=log.frame[names]), ROBOT.limbs)


def test_without_noise_the_torques_are_those_of_the_motion():
    """Averages over a bin must not look like an effect: they did, by 0.5 N m and 2.4 N."""
    ends = ("_noise", "_instability", "_turn_on", "_step")
    quiet = Sensors(**{part.name: 0.0 for part in fields(Sensors) if part.name.endswith(ends)})
    scenario = Scenario("turns", COURSE[:2], Ground(0.8), sensors=quiet, stand=0.5)
    log = walk(scenario, ROBOT, seed=5)
    left = residual(log, ROBOT, reference_motion(log, ROBOT.limbs)).table
    assert np.sqrt(np.nanmean(left[:, layout_for(QUADRUPED).channels["joint_torque"]] ** 2)) < 0.15
    assert (
        np.sqrt(np.nanmean(left[:, layout_for(QUADRUPED).channels["base_wrench"]][:, :3] ** 2))
        < 0.4
    )
