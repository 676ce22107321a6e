"""Large machines and slides: what they lack is named, and nothing where they lack nothing."""

import numpy as np
import pytest
from machines import ARM, GANTRY, machine, moved

from surefoot.models.attribution.diagnose import logs_under_model
from surefoot.models.attribution.effect_sizes import is_sampling_lag, plausible_size
from surefoot.models.attribution.sensor_noise import apparent_sizes, reading_noise
from surefoot.scenarios.trace.run import TraceOptions, trace_logs
from surefoot.scenarios.trace.words import summary
from surefoot.sim.effects import effect, known_effects
from surefoot.sim.importing.columns import ColumnEntry, Entries, read_columns
from surefoot.sim.robot.limbs import QUADRUPED

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
    again = trace_logs([log], gantry, TraceOptions(declared=found.effects))
    assert again.verdict == "no_residual", summary(again)


@pytest.mark.long
def test_a_load_on_a_link_is_its_mass_and_where_it_is(tmp_path):
    arm = machine(ARM, tmp_path)

    def tie(spec):
        load = spec.joint("elbow").parent.add_geom()
        load.size, load.mass, load.pos = np.array([0.04, 0, 0]), 2.0, np.array([0.25, 0, 0.05])

    found = trace_logs([moved(arm, NOISE, tie)], arm)
    sizes = {(e.name, e.target): e.value for e in found.effects}
    assert {target.split("_")[0] for _, target in sizes} == {"elbow"}, summary(found)
    assert {name for name, _ in sizes} <= {"link_mass", "link_com", "link_inertia"}


@pytest.mark.long
def test_large_loads_rotors_and_frictions_of_slides_are_within_bounds(tmp_path):
    """A gantry of 26 kg: 12 kg on its ram, and a viscous belt."""
    gantry = machine(GANTRY, tmp_path)

    def change(spec):
        load = spec.joint("z").parent.add_geom()
        load.size, load.mass = np.array([0.05, 0, 0]), 12.0
        spec.joint("x").damping[0] = 250.0

    found = trace_logs([moved(gantry, NOISE, change)], gantry)
    sizes = {(e["name"], e["target"]): (e["value"], e["unit"]) for e in found.as_dict()["effects"]}
    assert set(sizes) == {("link_mass", "z"), ("viscous_friction", "x")}, summary(found)
    assert sizes["link_mass", "z"] == (pytest.approx(12.0, rel=0.02), "kg")
    assert sizes["viscous_friction", "x"] == (pytest.approx(250.0, rel=0.02), "N s/m")


def test_sizes_are_plausible_for_the_machine_and_for_legs_as_published(tmp_path):
    gantry, legs = machine(GANTRY, tmp_path).limbs, QUADRUPED
    assert gantry.slides == ("x", "z")
    assert gantry.mass == pytest.approx(26.0)
    assert gantry.inertia == pytest.approx((26.0, 6.0))
    assert plausible_size("link_mass", "z", gantry) == pytest.approx(0.4 * 26.0)
    assert plausible_size("armature", "all", gantry) == pytest.approx(26.0)
    for name, target in (("link_mass", "FL_calf"), ("armature", "all")):
        assert plausible_size(name, target, legs) == known_effects()[name].size_prior().within
    kind = known_effects()["link_mass"]
    assert kind.bounds_on(legs) == (-0.5, 5.0)
    assert kind.bounds_on(gantry) == kind.bounds
    assert known_effects()["armature"].unit_on("all", gantry) == "kg"
    assert known_effects()["armature"].unit_on("all", legs) == "kg m^2"


def test_slides_are_imported_in_units_of_distance_and_force():
    entries = {"q_x": ("mm", 1e-3), "dq_x": ("mm/s", 1e-3), "tau_x": ("kN", 1e3)}
    columns: Entries = {name: ColumnEntry(name, unit) for name, (unit, _) in entries.items()}
    read = read_columns("columns", columns, ())
    assert {name: one.scale for name, one in read.items()} == {
        n: f for n, (_, f) in entries.items()
    }
