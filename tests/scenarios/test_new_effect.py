"""`none_of_these` goes on, as docs/guides/own_effect.md describes it: the form that trace names is
enough to write a class, and with the class the same log is attributed. Of the log the IMU is kept,
so that it is quick."""

from dataclasses import replace

import numpy as np
import pytest
from processes import printed
from refusals import refused
from synthetic import without

from studies.blind.outside_effects import ThermalGyroDrift
from surefoot.models.attribution.diagnose import diagnose
from surefoot.sim.effects import CATALOGUE, add
from surefoot.sim.effects.base import AXES, Effect, Traced, with_columns
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

ROBOT = Robot.load("spot_class")
SIZE = 0.015  # rad/s


class GyroWarming(Effect):
    """A gyro's bias grows to this size while it warms up, with a time constant of 16 s."""

    name = "gyro_warming"
    unit = "rad/s"
    bounds = (-0.5, 0.5)
    targets = AXES
    traced = Traced(channels=("imu_gyro", "leg_velocity"), step=1e-3, needs=("imu",))

    def alter_streams(self, streams, robot):
        gyro = streams.gyro.copy()
        gyro[:, AXES.index(self.target)] += self.value * settled(streams.t)
        return replace(streams, gyro=gyro)

    def compensate(self, log, robot):
        column = f"gyro_{self.target}"
        reading = log.frame[column].to_numpy() - self.value * settled(log.t)
        return with_columns(log, {column: reading}), robot


def settled(t):
    return 1.0 - np.exp(-(t - t[0]) / 16.0)


@pytest.fixture(scope="module")
def log():
    course = (Segment(10.0, 0.6, turn=0.3), Segment(10.0, 0.5, turn=-0.4), Segment(10.0, 0.6))
    warm = [ThermalGyroDrift("y", SIZE)]
    walked = walk(Scenario("warm", course, Ground(0.8)), ROBOT, 5, warm, declared=False)
    return without(walked, "q_", "dq_", "tau_", "contact_", "slip_", "mu_")


def test_the_form_that_is_left_becomes_an_effect(log, catalogue):
    before = diagnose([log], ROBOT)
    assert before.verdict == "none_of_these"
    form = before.unexplained[0]
    assert (form.channel, form.column) == ("imu_gyro", "gyro_y")
    assert form.regressors[0] in {"settling_8_s", "settling_16_s", "settling_32_s"}

    add(GyroWarming)
    after = diagnose([log], ROBOT)
    assert after.verdict == "attributed"
    assert [(e.name, e.target) for e in after.effects] == [("gyro_warming", "y")]
    assert after.effects[0].value == pytest.approx(SIZE, rel=0.1)
    level = after.channels["imu_gyro"]
    assert level.noise_floor is not None
    assert level.after < 1.1 * level.noise_floor < 0.2 * level.before


def test_a_class_that_says_too_little_or_takes_a_name_is_not_added(catalogue):
    class Nameless(Effect):
        unit = "m"
        bounds = (0.0, 1.0)
        targets = AXES

    refused("Nameless: lacks name", add, Nameless)
    refused("GyroWarming: must be a class, is GyroWarming", add, GyroWarming("x", 0.01))

    class Taken(GyroWarming):
        name = "gyro_bias"

    refused("gyro_bias: the catalogue has one of that name", add, Taken)
    assert not any(k.__qualname__.endswith(("Nameless", "Taken")) for k in CATALOGUE.values())


ADDED = """
from surefoot.scenarios.stages import processes, stage
from surefoot.sim.effects import add, effect
from surefoot.sim.effects.imu import GyroBias


@add
class Own(GyroBias):
    name = "own"


def known(_):
    return effect("own", "x", 0.1).name


if __name__ == "__main__":
    with processes(2) as pool:
        print(stage(pool, "", {1: (known, 1)}))
"""


def test_an_effect_that_a_script_adds_is_known_to_processes_that_it_spawns(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(ADDED)
    assert printed(script).strip() == "{1: 'own'}"
