"""A drive whose logged rates are noise: its inverse dynamics takes the slopes of its angles."""

import numpy as np
import pandas as pd
import pytest
from pendulum import swung
from slopes import apart, regressor_of, slope_of, step_of

from surefoot.models.attribution.evidence import (
    all_keys,
    linearise,
    log_under_model,
    table_of,
)
from surefoot.models.attribution.model_error import OF_MEAN, at_middles
from surefoot.models.attribution.sensor_noise import reading_noise
from surefoot.models.attribution.weights import robust_weights
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.log import Log, Meta
from surefoot.sim.robot.machine import load_machine

PENDULUM = load_machine("ak80_pendulum")


def swinging(rate_noise):
    """5 s of a swing at 300 Hz with its rates' noise [rad/s]; None: no rates."""
    t = np.arange(0.0, 5.0, 1 / 300)
    rng = np.random.default_rng(0)
    columns = {"t": t, "q_shoulder": np.sin(3 * t) + rng.normal(0.0, 1e-3, len(t))}
    columns["tau_shoulder"] = np.cos(2 * t) + rng.normal(0.0, 0.05, len(t))
    if rate_noise is not None:
        columns["dq_shoulder"] = 3 * np.cos(3 * t) + rng.normal(0.0, rate_noise, len(t))
    return Log(pd.DataFrame(columns), Meta(rate=300.0, robot="ak80_pendulum"), "swing")


def test_angles_serve_where_rates_are_noisier_and_nowhere_else():
    noisy, quiet, none = (log_under_model(swinging(x), PENDULUM) for x in (1.0, 1e-3, None))
    assert noisy.motion.rates_of_angles
    assert not quiet.motion.rates_of_angles
    layout = layout_for(PENDULUM.limbs)
    torque, rate = layout.of("joint_torque"), layout.of("joint_rate")
    tables = [table_of(case, ()) for case in (noisy, none)]
    np.testing.assert_allclose(tables[0][:, torque], tables[1][:, torque], atol=1e-9)
    assert np.nanstd(tables[0][:, rate]) > 0.1  # the rates themselves are held against the angles


@pytest.mark.parametrize(
    "name",
    ["encoder_offset", "viscous_friction", "armature", "torque_bias", "torque_scale"],
)
def test_regressors_are_the_slopes_of_the_residual(name):
    case = log_under_model(swinging(1.0), PENDULUM)
    key = next(key for key in all_keys(case) if key[0] == name)
    slope = slope_of(case, key, step_of(key))
    torque = layout_for(PENDULUM.limbs).of("joint_torque")
    assert apart(regressor_of(case, key, slope), slope, torque) < 0.03


def test_the_floor_of_readings_is_what_their_noise_leaves():
    """An encoder's rounding stays for a whole bin only where the joint hardly moves."""
    case = log_under_model(swung(), PENDULUM)
    left = table_of(case, ())[:, layout_for(PENDULUM.limbs).of("joint_torque", "joint_rate")]
    floor = reading_noise([case])[layout_for(PENDULUM.limbs).of("joint_torque", "joint_rate")]
    np.testing.assert_allclose(floor, np.nanstd(left, axis=0), rtol=0.15)


def test_pushes_have_no_weight_though_all_sizes_together_could_explain_them():
    """A scale of the torques and the masses at -100 % leave nothing of any reading."""
    pushes = (1.0, 3.5, 6.0, 8.5)
    case = log_under_model(swung(scale=1.1, pushes=pushes), PENDULUM)
    known = at_middles(linearise([case], (), all_keys(case), evaluation_channels=False))
    weights = robust_weights(known, OF_MEAN * reading_noise([case]))
    weight = weights.weight[:, known.layout.of("joint_torque")[0]]
    weight, t = weight[weight > 0.0], known.t[weight > 0.0]
    nearest = [weight[np.argmin(np.abs(t - one - 0.075))] for one in pushes]
    assert max(nearest) < 0.1
    assert np.median(weight) == 1.0
