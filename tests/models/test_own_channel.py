"""Channels and columns of a user's own: traced, drawn, kept and asked for."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from own_package import found
from synthetic import synthetic_walk, without

from surefoot.models.attribution.data import _misnamed_channels, data_notes, readings
from surefoot.models.attribution.evidence import all_keys, linearise, log_under_model
from surefoot.models.attribution.model_error import ModelError
from surefoot.models.attribution.noise_floor import NoiseFloor
from surefoot.models.residuals.channels import BUNDLED_CHANNELS, CHANNELS, channels
from surefoot.scenarios.trace.report import over_floor
from surefoot.scenarios.trace.run import trace
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.plugins import plugins
from surefoot.sim.effects import add, effect
from surefoot.sim.effects.base import Effect, Traced
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import LogError
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

LEGS = ("q_", "dq_", "tau_", "contact_", "slip_", "mu_")


def test_a_channel_of_a_package_is_traced_and_drawn(robot, tmp_path):
    course = (Segment(8.0, 0.5, turn=0.3), Segment(6.0, 0.4, turn=-0.3))
    loaded = [effect("payload", "all", 6.0)]
    log = walk(Scenario("plain", course, Ground(0.8)), robot, 3, loaded, declared=False)
    log = without(log, *LEGS)
    with found("own_channel"):
        case = log_under_model(log, robot)
        keys = [("accel_bias", "z"), ("payload", "all"), ("gyro_bias", "x")]
        data = linearise([case], (), keys)
        column = data.layout.names.index("support")
        assert data.layout.columns[column].unit == "N"
        # Regressors by the chain rule know nothing of it, yet it answers to readings and the robot.
        (by_bias,), (by_payload,), by_gyro = (
            [np.mean(one.values[:, k]) for k in np.flatnonzero(one.columns == column)]
            for one in data.X
        )
        assert by_bias == pytest.approx(-robot.mass, rel=0.02)
        assert by_payload == pytest.approx(9.81, rel=0.02)
        assert by_gyro == []
        figure = over_floor(trace([log], robot, tmp_path / "out").channels)
    titles = [one.get_text() for ax in figure.axes for one in ax.get_yticklabels()]
    assert "force of all feet" in titles

    seen = json.loads((tmp_path / "out" / "trace.json").read_text())
    level = seen["channels"]["support_force"]
    assert level["unit"] == "N"
    # 6 kg that the model lacks, beside what walks of the model leave, which have the channel too.
    assert level["before"] == pytest.approx(np.hypot(6.0 * 9.81, level["noise_floor"]), rel=0.1)
    assert seen["verdict"] == "none_of_these"
    assert any(form["channel"] == "support_force" for form in seen["remainder"])


def test_without_the_package_there_are_the_bundled_channels_alone():
    assert list(channels()) == [kind.name for kind in BUNDLED_CHANNELS]


def test_what_is_no_channel_is_refused_in_a_line(tmp_path, monkeypatch):
    (tmp_path / "own_thing.py").write_text(
        "class Mine:\n    name = unit = 'mine'\n    needs = ()\n"
    )
    info = tmp_path / "own-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[surefoot.channels]\nmine = own_thing:Mine\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "own_thing", raising=False)
    plugins.cache_clear()
    try:
        with pytest.raises(SurefootError, match=r"plugin mine .*must be a subclass of Channel"):
            CHANNELS["mine"]
        assert list(channels.__wrapped__()) == [kind.name for kind in BUNDLED_CHANNELS]
        robot = Robot.load("spot_class")
        case = log_under_model(synthetic_walk(0, 6.0), robot)
        none = ModelError(0, (), np.zeros(0), np.zeros((0, 0)), {}, {})
        no_floor = NoiseFloor(np.zeros(0), (), "", none)
        (note,) = [n for n in data_notes([case], no_floor) if "mine" in n]
        assert note.startswith("plugin mine = own_thing:Mine (surefoot.channels): ")
    finally:
        plugins.cache_clear()


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
