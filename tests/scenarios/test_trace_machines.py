"""Traces of machines that are bolted down: drives, links, slides and loads."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from driven import driven
from machines import ARM, GANTRY, machine, moved
from pendulum import swung as pushed_pendulum
from refusals import refused

from surefoot.models.attribution.diagnose import logs_under_model
from surefoot.models.attribution.effect_sizes import Found, is_sampling_lag
from surefoot.models.attribution.sensor_noise import apparent_sizes, reading_noise
from surefoot.models.residuals.layout import layout_for
from surefoot.scenarios.trace.report import beyond_bounds, headline, summary
from surefoot.scenarios.trace.run import TraceOptions, trace_logs
from surefoot.sim.effects import effect
from surefoot.sim.effects.file import load_effects, save_effects
from surefoot.sim.importing.columns import ColumnEntry, Entries, read_columns
from surefoot.sim.log import Log, Meta
from surefoot.sim.robot import Robot
from surefoot.sim.robot.machine import FixedBase, Modelled, load_machine, machine_for_log

NOISE = {"x": 2.0, "z": 1.0, "shoulder": 0.5, "elbow": 0.3}  # N, N m


@pytest.mark.parametrize("substeps", [4, pytest.param(16, marks=pytest.mark.long)])
def test_noisy_torques_are_no_spring_and_half_a_step_is_no_effect(tmp_path, monkeypatch, substeps):
    """The rates of semi-implicit Euler are half a step late, also of a short one."""
    monkeypatch.setattr("machines.SUBSTEPS", substeps)
    gantry = machine(GANTRY, tmp_path)
    found = trace_logs([moved(gantry, NOISE)], gantry)
    assert found.verdict == "no_residual", summary(found)
    assert found.effects == ()
    (run,) = found.runs
    (lag,) = run.compensated
    step = 4e-3 / substeps
    assert (lag.name, lag.value) == ("rate_delay", pytest.approx(0.5 * step, rel=0.05))
    said = f"rate_delay of {1e3 * lag.value:+.2g} ms is compensated"
    assert any(said in note for note in found.notes)


def test_noisy_torques_of_a_joint_that_rubs_are_no_spring(tmp_path):
    """Where it sticks, springs show most in the regressor, and fits do not look."""
    arm = machine(ARM.replace('armature=".1"', 'armature=".1" frictionloss=".3"'), tmp_path)
    found = trace_logs([moved(arm, {"shoulder": 0.5, "elbow": 0.1}, seconds=40.0)], arm)
    assert (found.verdict, found.effects) == ("no_residual", ()), summary(found)


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


def test_slides_are_imported_in_units_of_distance_and_force():
    units = {"q_x": "mm", "dq_x": "mm/s", "tau_x": "kN"}
    columns: Entries = {name: ColumnEntry(name, unit) for name, unit in units.items()}
    scales = [one.scale for one in read_columns("columns", columns, ()).values()]
    assert scales == [1e-3, 1e-3, 1e3]


PLANAR_ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody>
<body name="upper" pos="0 0 1">
<joint name="shoulder" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1.5"/>
<body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.025" mass="0.8"/></body></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Modelled:
    file = tmp_path_factory.mktemp("arm") / "arm.xml"
    file.write_text(PLANAR_ARM)
    return load_machine(file)


@pytest.mark.parametrize(
    ("name", "target", "value"),
    [
        ("link_mass", "elbow", 0.1),
        pytest.param("link_com", "elbow_z", -0.02, marks=pytest.mark.long),
        pytest.param("link_inertia", "elbow", 0.01, marks=pytest.mark.long),
    ],
)
def test_a_wrong_link_of_an_arm_is_named_with_its_size(arm, name, target, value):
    found = trace_logs([driven(arm, [effect(name, target, value)])], arm)
    assert found.verdict == "attributed"
    assert [(e.name, e.target) for e in found.effects] == [(name, target)]
    assert found.effects[0].value == pytest.approx(value, rel=0.05)


def test_mass_and_place_of_one_link_are_told_apart_where_it_moves_fast(arm):
    put_in = [effect("link_mass", "elbow", 0.2), effect("link_com", "elbow_z", -0.03)]
    found = trace_logs([driven(arm, put_in)], arm)
    sizes = {(e.name, e.target): e.value for e in found.effects}
    assert sizes.keys() == {("link_mass", "elbow"), ("link_com", "elbow_z")}
    for one in put_in:
        assert sizes[one.name, one.target] == pytest.approx(one.value, rel=0.05)


def test_a_wrong_zero_of_a_last_link_is_not_told_from_its_centre_of_mass(arm):
    log = driven(arm)
    found = trace_logs([log.with_columns({"q_elbow": log.q[:, 1] + 0.08})], arm)
    assert found.verdict == "confounded"
    named = {(e.name, e.target) for e in found.effects} | {
        (one["name"], one["target"]) for one in found.rivals
    }
    assert named >= {("encoder_offset", "elbow"), ("link_com", "elbow_x")}


def test_a_heavier_pendulum_is_named_and_no_encoder_scale_stands_in_for_it():
    """A torque scale nearly can: what a pendulum's mass weighs and what it resists grow alike."""
    pendulum = load_machine("ak80_pendulum")
    found = trace_logs([driven(pendulum, [effect("link_mass", "shoulder", 0.1)])], pendulum)
    assert [e.name for e in found.effects] == ["link_mass"]
    assert found.effects[0].value == pytest.approx(0.1, rel=0.02)
    assert {name for (name, _), _ in found.rivals} <= {"torque_scale"}


PENDULUM = load_machine("ak80_pendulum")


def _long(*values):
    return pytest.param(*values, marks=pytest.mark.long)


def swung(seconds=12.0, name="", size=0.0, **read) -> Log:
    """The pendulum, with an effect of this name in its MjSpec."""
    effects = [effect(name, "shoulder", size)] if name else []
    return driven(PENDULUM, effects, seconds, **read)


@pytest.mark.parametrize(
    ("made", "name", "size"),
    [
        ({"name": "coulomb_friction", "size": 0.2}, "coulomb_friction", 0.2),
        ({"scale": 0.1}, "torque_scale", 0.1),
        _long({"name": "viscous_friction", "size": 0.1}, "viscous_friction", 0.1),
        _long({"load": 0.15}, "load_friction", 0.15),
        _long({"name": "armature", "size": 0.02}, "armature", 0.02),
    ],
)
def test_what_one_drive_lacks_is_named_with_its_size(made, name, size):
    found = trace_logs([swung(**made)], PENDULUM)
    assert (found.effects[0].name, found.effects[0].target) == (name, "shoulder")
    assert found.effects[0].value == pytest.approx(size, rel=0.1)
    assert found.channels["joint_torque"].after < 0.3 * found.channels["joint_torque"].before
    assert "imu_gyro" not in summary(found), "a fixed base has no use for it"


def test_a_drive_as_declared_lacks_nothing():
    """Its noise is that of its readings, rates among them: inertia makes torque of theirs."""
    found = trace_logs([swung(4.0)], PENDULUM)
    assert found.verdict == "no_residual"
    assert found.effects == ()


@pytest.mark.parametrize("hidden", [_long({}), {"friction": 0.3}])
def test_pushes_are_said_with_their_times_and_make_no_effect(hidden):
    pushes = (2.0, 5.0, 9.0)
    found = trace_logs([pushed_pendulum(pushes=pushes, **hidden)], PENDULUM)
    assert [one.name for one in found.effects] == ["coulomb_friction"] * len(hidden)
    assert found.verdict == ("attributed" if hidden else "not_identifiable")
    said = [*found.reasons, *found.notes]
    named = [line for line in said if "outside forces" in line]
    assert len(named) == len(pushes)
    for line, begin in zip(named, pushes, strict=True):
        first, last = re.findall(r"(\d+\.\d) ", line.partition("from")[2].replace(" to ", " "))[:2]
        assert float(first) - 0.3 < begin < float(last) + 0.3


def test_an_effect_outside_its_bounds_is_mentioned_and_not_named():
    """A brake that was left on."""
    log = swung()
    rubbing = log.tau[:, 0] + 3000.0 * np.tanh(log.dq[:, 0] / 0.03)
    found = trace_logs([log.with_columns({"tau_shoulder": rubbing})], PENDULUM)
    assert found.verdict == "none_of_these"
    assert "coulomb_friction" not in {one.name for one in found.effects}
    (line,) = (line for line in beyond_bounds(found) if "coulomb_friction" in line)
    assert "bounds are 0 and 2e+03" in line


def test_what_a_slide_lacks_is_in_metres_and_newtons(tmp_path):
    """A cart that carries a pendulum."""
    (tmp_path / "cart.xml").write_text(
        '<mujoco><worldbody><body><joint name="cart" type="slide" axis="1 0 0"/>'
        '<geom size=".1" mass="1"/><body><joint name="pole" type="hinge" axis="0 1 0"/>'
        '<geom size=".1" pos="0 0 .5" mass="1"/></body></body></worldbody></mujoco>'
    )
    t = np.arange(0.0, 1.0, 0.01)
    columns = {f"{kind}_{joint}": np.sin(t) for kind in ("q", "tau") for joint in ("cart", "pole")}
    log = Log(pd.DataFrame({"t": t} | columns), Meta(100.0), "short")
    found = trace_logs([log], load_machine(tmp_path / "cart.xml"))
    assert found.limbs.slides == ("cart",)
    named = tuple(
        Found(effect("coulomb_friction", joint, 3.0), (2.0, 4.0)) for joint in ("cart", "pole")
    )
    found = replace(found, found=named)
    assert [one["unit"] for one in found.as_dict()["effects"]] == ["N", "N m"]
    assert "coulomb_friction cart +3 N and coulomb_friction pole +3 N m" in headline(
        replace(found, verdict="attributed")
    )
    save_effects(tmp_path / "effects.toml", found.effects, limbs=found.limbs)
    assert load_effects(tmp_path / "effects.toml") == found.effects
    units = {c.name: c.unit for c in layout_for(found.limbs).columns}
    assert (units["torque_cart"], units["rate_cart"]) == ("N", "m/s")


def test_too_short_a_log_is_not_identifiable():
    found = trace_logs([swung(1.0)], PENDULUM)
    assert found.verdict == "not_identifiable"
    assert "too short: 1.0 s where 3 s are needed" in summary(found)


def test_logs_of_one_drive_that_are_short_each_add_up():
    logs = [swung(seconds, name="armature", size=0.02) for seconds in (2.6, 2.4)]
    found = trace_logs(logs, PENDULUM)
    assert [(e.name, e.target) for e in found.effects] == [("armature", "shoulder")]
    assert found.effects[0].value == pytest.approx(0.02, rel=0.1)


def test_inverse_dynamics_is_the_pendulum_s_equation():
    """I q'' + m g l sin q, with the published mass and the inertia of rod and point mass."""
    dynamics = PENDULUM.dynamics
    q, ddq = np.array([[0.3], [-1.1]]), np.array([[2.0], [-0.5]])
    _, torque = dynamics.inverse(q, np.zeros((2, 1)), ddq)
    inertia = 0.546 * 0.25 + 0.13 * (0.24**2 + 0.48**2 / 12)
    assert torque == pytest.approx(inertia * ddq + 0.676 * 9.81 * 0.45 * np.sin(q), rel=1e-3)


def test_machines_are_told_from_robots_and_joints_are_checked():
    assert isinstance(PENDULUM, FixedBase)
    assert isinstance(load_machine("spot_class"), Robot)
    log = swung(1.0)
    assert machine_for_log(log).joint_names == ("shoulder",)
    renamed = log.frame.rename(columns=lambda n: n.replace("shoulder", "elbow"))
    other = Log(renamed, log.meta, "x")
    refused("joint elbow is not one of ak80_pendulum's: shoulder", machine_for_log, other)
