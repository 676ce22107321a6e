"""Large machines and slides: what they lack is named, and nothing where they lack nothing."""

import pytest
from machines import ARM, GANTRY, machine, moved

from surefoot.models.attribution.diagnose import logs_under_model
from surefoot.models.attribution.run_offsets import is_sampling_lag
from surefoot.models.attribution.sensor_noise import apparent_sizes, reading_noise
from surefoot.scenarios.trace.run import trace_logs
from surefoot.scenarios.trace.words import summary
from surefoot.sim.effects import effect

NOISE = {"x": 2.0, "z": 1.0, "shoulder": 0.5, "elbow": 0.3}  # N, N m


def test_noisy_torques_are_no_spring_and_half_a_step_is_no_effect(tmp_path):
    """The rates of semi-implicit Euler are half a step of 1 ms late."""
    gantry = machine(GANTRY, tmp_path)
    found = trace_logs([moved(gantry, NOISE)], gantry)
    assert found.verdict == "no_residual", summary(found)
    assert found.effects == ()
    (run,) = found.runs
    (lag,) = run.compensated
    assert (lag.name, lag.value) == ("rate_delay", pytest.approx(0.5e-3, rel=0.05))
    assert "rate_delay of +0.5 ms is compensated and not counted" in summary(found)


def test_the_size_of_a_spring_that_noise_alone_gives_is_known(tmp_path):
    """Springs of plastic gears are softer; without noise there is none."""
    arm = machine(ARM, tmp_path)
    sizes = []
    for noise in (1e-6, 0.3):
        cases = logs_under_model([moved(arm, {"shoulder": 0.5, "elbow": noise})], arm, ())
        sizes.append(apparent_sizes(cases, reading_noise(cases))["leg_compliance", "elbow"])
    assert abs(sizes[0]) < 0.01 * sizes[1]
    assert 0.0 < sizes[1] < 1e-3


def test_a_lag_counts_as_sampling_up_to_half_a_row():
    assert is_sampling_lag(effect("rate_delay", "all", 1e-3), 500.0)
    assert is_sampling_lag(effect("torque_delay", "all", -2e-3), 250.0)
    assert not is_sampling_lag(effect("rate_delay", "all", 2e-3), 500.0)
    assert not is_sampling_lag(effect("viscous_friction", "all", 1e-3), 500.0)


def test_dry_friction_of_a_slide_is_named_though_it_sticks_at_every_turn(tmp_path):
    gantry = machine(GANTRY, tmp_path)

    def rub(spec):
        spec.joint("x").frictionloss = 30.0

    log = moved(gantry, NOISE, rub)
    found = trace_logs([log], gantry)
    assert found.verdict == "attributed", summary(found)
    (one,) = found.effects
    assert (one.name, one.target) == ("coulomb_friction", "x")
    assert one.value == pytest.approx(30.0, rel=0.03)
    # Declared, it is part of the model, and nothing has changed.
    again = trace_logs([log], gantry, declared=found.effects)
    assert again.verdict == "no_residual", summary(again)
