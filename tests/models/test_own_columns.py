"""A column `x_<name>` that an effect of one's own reads is kept for it, and asked for."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic import synthetic_walk

from surefoot.models.attribution.data import _misnamed_channels, readings
from surefoot.models.attribution.evidence import all_keys, log_under_model
from surefoot.models.residuals.channels import channels
from surefoot.sim.effects import add
from surefoot.sim.effects.base import Effect, Traced
from surefoot.sim.log import LogError
from surefoot.sim.robot import Robot


class GyroByTemperature(Effect):
    """A gyro whose bias goes with the temperature."""

    name = "gyro_by_temperature"
    unit = "rad/s/K"
    bounds = (-1.0, 1.0)
    targets = ("x",)
    traced = Traced(channels=("imu_gyro",), step=1e-3, needs=("imu", "x_temperature"))

    def compensate(self, log, robot):
        gyro = log.frame["gyro_x"] - self.value * log.frame["x_temperature"]
        return replace(log, frame=log.frame.assign(gyro_x=gyro)), robot


def test_a_channel_that_there_is_not_is_noted(catalogue):
    assert not _misnamed_channels()

    @add
    class Misspelt(GyroByTemperature):
        name = "misspelt"
        traced = replace(GyroByTemperature.traced, channels=("imu_gyr",))

    (note,) = _misnamed_channels()
    assert "misspelt" in note
    assert "did you mean 'imu_gyro'" in note


def test_it_is_read_and_its_effect_a_candidate_where_the_log_has_it(catalogue):
    plain, robot = synthetic_walk(0, 6.0), Robot.load("spot_class")
    log = replace(plain, frame=plain.frame.assign(x_temperature=np.linspace(20.0, 30.0, 3000)))
    assert "x_temperature" not in readings(log).frame
    add(GyroByTemperature)
    assert "x_temperature" in readings(log).frame
    key = ("gyro_by_temperature", "x")
    assert key in all_keys(log_under_model(readings(log), robot))
    assert key not in all_keys(log_under_model(readings(plain), robot))


def test_a_column_is_a_group_of_a_log_by_itself():
    log = synthetic_walk(0, 1.0)
    assert not log.has("x_temperature")
    with pytest.raises(LogError, match=r"lacks x_temperature"):
        log.require("x_temperature")


def test_events_alone_stay_where_a_body_changes():
    of_events = {name for name, one in channels().items() if one.of_events}
    assert of_events == {"stance_displacement", "contact_timing"}
