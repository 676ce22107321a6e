"""Sensors: contact that is late and wrong as often as told, an IMU's low-pass, encoder offsets."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from surefoot.sim.common.series import low_pass, without_low_pass
from surefoot.sim.sensors.streams import SensorErrors, Sensors, Streams

WEIGHT = 300.0  # N
RATE = 500.0  # Hz


@pytest.fixture
def streams():
    """A robot that trots in place: each foot loaded for every other quarter of a second."""
    t = np.arange(1, 20001) / RATE
    stands = (4 * t[:, None]).astype(int) % 2 == [0, 1, 1, 0]
    still = np.zeros((len(t), 12))
    return Streams(
        t=t,
        gyro=np.sin(2 * np.pi * 40.0 * t)[:, None] * np.ones(3),
        accel=np.tile([0.0, 0.0, 9.81], (len(t), 1)),
        q=still,
        dq=still,
        tau=still,
        tau_ff=still,
        force=np.where(stands, 0.5 * WEIGHT, 0.0),
    )


def read(streams, sensors, weight=WEIGHT):
    """Readings with errors, and contacts."""
    shape = len(streams.t), streams.q.shape[1], streams.force.shape[1]
    rng = np.random.default_rng(5)
    return SensorErrors(sensors, rng, shape, streams.rate, weight).apply(streams)


@pytest.mark.parametrize("rows", [0, 10])
def test_contact_is_a_threshold_that_is_told_late(streams, rows):
    _, contact = read(streams, Sensors(contact_delay=rows / RATE))
    assert_array_equal(contact[rows:], (streams.force > 0.08 * WEIGHT)[: len(contact) - rows])


def test_contact_is_wrong_as_often_as_told(streams):
    stands = streams.force > 0
    sensors = Sensors(contact_missed=0.05, contact_false=0.01)
    _, contact = read(streams, sensors)
    # 40000 samples of each kind: three standard deviations of the counts.
    assert (~contact[stands]).mean() == pytest.approx(0.05, abs=3 * np.sqrt(0.05 * 0.95 / 4e4))
    assert contact[~stands].mean() == pytest.approx(0.01, abs=3 * np.sqrt(0.01 * 0.99 / 4e4))


def test_contacts_of_a_light_robot_do_not_flicker(streams):
    _, contact = read(replace(streams, force=0.1 * streams.force), Sensors(), 0.1 * WEIGHT)
    assert_array_equal(contact, streams.force > 0)


def test_encoders_err_by_a_constant_and_white_noise_and_leave_the_other_sensors_alone(streams):
    errors: tuple[dict[str, float], ...] = {}, {"encoder_offset": 0.02}, {"encoder_noise": 1e-3}
    exact, shifted, noisy = (read(streams, Sensors(encoder_step=0.0, **one))[0] for one in errors)
    offset = shifted.q[0] - exact.q[0]
    assert 0.005 < np.std(offset) < 0.05
    assert_allclose(shifted.q - exact.q, np.tile(offset, (len(exact.t), 1)), atol=1e-12)
    noise = noisy.q - exact.q
    assert noise.std() == pytest.approx(1e-3, rel=0.02)
    assert abs(np.mean(noise[1:] * noise[:-1])) < 0.02 * 1e-3**2
    for name in ("gyro", "accel", "dq", "tau", "force"):
        for one in (shifted, noisy):
            assert_array_equal(getattr(one, name), getattr(exact, name))


@pytest.mark.parametrize("frequency", [2.0, 20.0, 60.0])
def test_low_pass_has_the_gain_of_its_bandwidth(frequency):
    """1 / sqrt(1 + (f tau 2 pi)^2), far below half the sampling rate."""
    rate, time = 20000.0, 1 / (2 * np.pi * 20.0)
    t = np.arange(0, 2.0, 1 / rate)
    wave = low_pass(np.sin(2 * np.pi * frequency * t)[:, None], time, rate)
    gain = np.sqrt(2) * wave[len(t) // 2 :].std()
    assert gain == pytest.approx(1 / np.hypot(1.0, frequency / 20.0), rel=0.01)


@pytest.mark.parametrize("time", [0.0, 0.002, 0.02])
def test_readings_before_a_low_pass_are_had_back(time):
    x = np.random.default_rng(0).normal(size=(200, 3))
    assert_allclose(without_low_pass(low_pass(x, time, RATE), time, RATE), x, atol=1e-9)


def test_low_pass_starts_at_rest():
    assert_allclose(low_pass(np.full((50, 3), 9.81), 0.01, RATE), 9.81)
    x = np.random.default_rng(0).normal(size=(50, 3))
    assert_array_equal(low_pass(x, 0.0, RATE), x)


def test_imu_bandwidth_takes_vibration_away_and_leaves_the_mean(streams):
    narrow, wide = (read(streams, Sensors(imu_bandwidth=f))[0] for f in (10.0, 0.0))
    assert narrow.gyro.std() < 0.4 * wide.gyro.std()
    assert_allclose(narrow.accel.mean(0), wide.accel.mean(0), atol=2e-3)
    assert_array_equal(narrow.q, wide.q)
