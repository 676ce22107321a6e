"""Noise floors of channels, and the forms of what is left above them."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import without

from surefoot.models.attribution.diagnose import DiagnosisOptions, diagnose
from surefoot.models.attribution.evidence import log_under_model
from surefoot.models.attribution.noise_floor import ground_of, noise_floor
from surefoot.models.attribution.sensor_noise import reading_noise
from surefoot.models.attribution.unexplained import regressor_library, sparse_regression
from surefoot.models.attribution.weights import RobustWeights
from surefoot.models.residuals.binning import BIN
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.streams import Sensors
from surefoot.sim.walk import walk

GO1 = Robot.load("go1")


@pytest.mark.long
@pytest.mark.parametrize("speed", [0.1, 0.3])
def test_nothing_is_missed_on_a_straight_walk_of_the_declared_robot(speed):
    """Feet are steadier in the first seconds than in the rest of a walk."""
    log = walk(Scenario("straight", (Segment(20.0, speed),), Ground(0.8), stand=0.5), GO1, 2)
    assert diagnose([log], GO1).verdict == "no_residual"


@pytest.mark.long
def test_what_bumps_seem_to_be_is_known_from_the_walks_though_some_count_as_level():
    """On rough ground the torques seem to lack rotor inertia, as in the walks of the floor."""
    course = (Segment(8.0, 0.3), Segment(6.0, 0.4))
    rough = Scenario("rough", course, ground_of(course, 0.01, 0.8), stand=0.5)
    case = log_under_model(walk(rough, GO1, 3), GO1)
    floor = noise_floor([case])
    assert not case.motion.level
    assert not any(one.case.motion.level for one in floor.walks)
    assert "armature" in {name for name, _ in floor.error.keys}


ROBOT = Robot.load("spot_class")
TURNS = Scenario("turns", (Segment(6.0, 0.6, turn=0.3), Segment(6.0, 0.5, turn=-0.3)), Ground(0.8))


@lru_cache
def case():
    return log_under_model(walk(TURNS, ROBOT, 2), ROBOT)


@pytest.mark.parametrize("rate", [500, 250])
def test_walks_of_the_floor_have_joints_as_noisy_as_the_log(rate):
    log, rng, added = case().log, np.random.default_rng(1), {"q": 1e-3, "dq": 0.04, "tau": 0.5}
    finer = np.sqrt(500 / rate)  # as much over a second
    log = log.rows(slice(None, None, round(log.rate) // rate))
    columns = {
        f"{group}_{joint}": log.columns[f"{group}_{joint}"]
        + rng.normal(0.0, finer * size, len(log.t))
        for group, size in added.items()
        for joint in log.joints
    }
    cases = [log_under_model(one, ROBOT) for one in (log, log.with_columns(columns))]
    quiet, noisy = (plan.sensors for one in cases if (plan := noise_floor([one]).plan))
    assert quiet == Sensors(rate=0.0 if rate == 500 else rate)
    assert noisy.rate == quiet.rate
    assert noisy.encoder_noise == pytest.approx(1e-3 * finer, rel=0.2)
    assert noisy.velocity_noise == pytest.approx(np.hypot(0.01, 0.04 * finer), rel=0.15)
    assert noisy.torque_noise == pytest.approx(np.hypot(0.1, 0.5 * finer), rel=0.15)


def test_held_out_logs_are_judged_where_the_floor_is_known():
    """Dry friction holds a part of the load of a robot that stands, which looks like a wrench."""
    options = DiagnosisOptions(holdout=(walk(TURNS, ROBOT, 3),))
    held_out = diagnose([case().log], ROBOT, options).held_out
    assert held_out is not None
    wrench = held_out.channels["base_wrench"]
    assert wrench.after == pytest.approx(wrench.noise_floor, rel=0.2)


def test_readings_of_a_walk_are_as_noisy_as_its_reference():
    """The floor of legged machines that cannot walk in simulation."""
    log, rng, angle = case().log, np.random.default_rng(2), 1e-3
    seen = Rotation.from_matrix(log.ref_R_GI)
    seen *= Rotation.from_rotvec(rng.normal(0.0, angle, (len(log.t), 3)))
    q = seen.as_quat(scalar_first=True)
    p = log.ref_p + rng.normal(0.0, 3e-4, log.ref_p.shape)
    columns = {f"ref_q_{a}": q[:, i] for i, a in enumerate("wxyz")}
    columns |= {f"ref_p_{a}": p[:, i] for i, a in enumerate("xyz")}
    measured = log_under_model(without(log.with_columns(columns), "ref_v"), ROBOT)
    sigma = reading_noise([measured])
    gyro = layout_for(ROBOT.limbs).of("imu_gyro")
    # A bin's mean rate is the rotation between its ends.
    np.testing.assert_allclose(sigma[gyro], np.sqrt(2.0) * angle / BIN, rtol=0.1)


def formed(signal=None, column=1):
    """The form of white noise, with `signal` (a regressor's name) on one column of the gyro."""
    bins = len(case().motion.t)
    left = 1e-3 * np.random.default_rng(0).normal(size=(bins, 52))
    if signal:
        names, values = regressor_library([case()])
        left[:, column] += 2e-3 * values[:, names.index(signal)]
    trusted = RobustWeights(
        np.ones(52), np.ones((bins, 52)), np.zeros((bins, 4), bool), 0.0, np.ones(52)
    )
    seen = (case().motion.t // 2).astype(int) % 2 == 0
    return sparse_regression([case()], left, trusted, ["imu_gyro"], seen, ~seen)


@pytest.mark.parametrize("signal", ["time", "force_z", "rate_x", "torque_FL_calf"])
def test_a_rest_that_goes_with_a_reading_is_named(signal):
    (one,) = formed(signal)
    assert one.channel == "imu_gyro"
    assert one.column == "gyro_y"
    assert one.regressors == (signal,)
    # Four fifths of the variance over the log; single blocks excite it more or less.
    assert 0.5 < one.share < 0.95


def test_white_noise_has_no_form_but_its_channel_and_loudest_column():
    (one,) = formed()
    assert one.channel == "imu_gyro"
    assert one.regressors == ()
    assert one.share == 0.0
