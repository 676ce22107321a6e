"""Bins of a residual: rates of change over them, and which of them count."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from synthetic import synthetic_walk

from surefoot.models.residuals import feet
from surefoot.models.residuals.binning import BIN, angles_are_quieter, mean_rate_of_change
from surefoot.models.residuals.channels import CHANNELS, STANCE_BINS, CommandedTorque
from surefoot.models.residuals.feet import level_ground
from surefoot.models.residuals.torques import dynamics_inputs
from surefoot.sim.log import Log, Meta
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import GivenFeet
from surefoot.sim.sensors.streams import Sensors

RATE = 500.0
T = 7.0 + np.arange(200) / RATE
FIRST = np.arange(0, 200, 10)


def binned(moved: bool) -> Any:
    """What of a reference's motion concerns its bins, of a walk or of a fixed base."""
    return SimpleNamespace(
        first=FIRST, count=np.full(20, 10), moved=np.array([moved]), ok=np.ones(200, dtype=bool)
    )


@pytest.mark.parametrize("moved", [True, False])
def test_the_rate_of_change_of_what_grows_evenly_is_its_slope(moved):
    x = np.outer(T, [3.0, -2.0])
    found = mean_rate_of_change(x, T, binned(moved))
    np.testing.assert_allclose(found[1:-1], np.tile([3.0, -2.0], (18, 1)), rtol=1e-9)


@pytest.mark.parametrize(("angles", "rates", "quieter"), [(1e-5, 0.3, True), (1e-2, 0.3, False)])
def test_the_quieter_of_angles_and_rates_is_known(angles, rates, quieter):
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((2, len(T)))
    frame = pd.DataFrame({"t": T, "q_a": angles * noise[0], "dq_a": rates * noise[1]})
    motion = binned(True)
    assert angles_are_quieter(Log(frame, Meta(RATE)), motion) is quieter
    assert not angles_are_quieter(Log(frame.drop(columns="dq_a"), Meta(RATE)), motion)


def test_noise_is_that_of_means_of_rows():
    """Four times the rows, half the noise; a stance's mean is that of its bins, and what a foot
    moves within it that mean times its time."""
    sensors = Sensors()
    noise = {
        name: [CHANNELS[name]().noise(sensors, rate, 0.0) for rate in (500.0, 2000.0)]
        for name in ("leg_velocity", "stance_velocity", "joint_rate", "joint_torque", "base_wrench")
    }
    for name, (at_500, at_2000) in noise.items():
        assert at_2000 == pytest.approx(0.5 * at_500), name
    stance = noise["stance_velocity"][0]
    assert stance == pytest.approx(noise["leg_velocity"][0] / np.sqrt(STANCE_BINS))
    moved = CHANNELS["stance_displacement"]().noise(sensors, 500.0, 0.0)
    assert moved == pytest.approx(stance * STANCE_BINS * BIN)


@pytest.mark.parametrize(("height", "level"), [(0.0057, True), (0.0063, False)])
@pytest.mark.parametrize("rows", [100, 99])
def test_ground_is_level_to_six_millimetres(height, level, rows, monkeypatch):
    """Half of the heights that high, half as low, in an order that no plane follows: the standard
    deviation of normal ones of that median is 1.4826 times as large."""
    up = np.tile([1.0, -1.0, -1.0, 1.0], 25)[:rows] * height / 1.4826
    monkeypatch.setattr(feet, "foot_heights", lambda bins, robot: up[:, None])
    p = np.column_stack([np.repeat(np.arange(25), 4), np.tile(np.arange(4), 25)])[:rows]
    bins: Any = SimpleNamespace(p_GI=np.column_stack([p, 0.0 * up]))
    assert level_ground(bins, bins) is (level and rows == 100)


@pytest.mark.parametrize(("off", "whole"), [(0.24, True), (0.26, False)])
def test_bins_beside_a_gap_are_not_whole(off, whole):
    t = BIN * np.arange(9.0)
    t[4:] += off * BIN
    q, none = np.zeros((9, 2)), np.zeros((9, 0), dtype=bool)
    bins: Any = SimpleNamespace(t=t, standing=none, lifted=none, q=q)
    found = dynamics_inputs(bins, GivenFeet(Limbs((), (), ()))).swings[:, 0]
    # Nor is a bin that the smoothing takes from such a one.
    assert np.flatnonzero(~found).tolist() == ([0, 1, 7, 8] if whole else [0, 1, 2, 3, 4, 5, 7, 8])


@pytest.mark.parametrize("lacks", ["tau_", "tau_ff_"])
def test_without_torques_or_commands_nothing_is_left_of_them(lacks):
    log = synthetic_walk(0, 1.0, robot="spot_class")
    joints = [str(c)[2:] for c in log.frame if str(c).startswith("q_")]
    commands = {f"tau_ff_{joint}": np.zeros(len(log.t)) for joint in joints}
    kept = {n: x for n, x in log.columns.items() if not n.startswith(("tau_",))}
    torques = {f"tau_{joint}": np.zeros(len(log.t)) for joint in joints}
    frame = pd.DataFrame(kept | (torques if lacks == "tau_ff_" else commands))
    extras = SimpleNamespace(command_late=0.0)
    inputs: Any = SimpleNamespace(
        log=Log(frame, log.meta), robot=SimpleNamespace(extras=extras), motion=binned(True)
    )
    assert CommandedTorque().residual(inputs) is None
