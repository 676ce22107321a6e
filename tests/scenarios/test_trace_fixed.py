"""One drive on a bench: what its rigid model lacks is found from torque, angle and rate alone."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from driven import driven
from pendulum import swung as pushed_pendulum

from surefoot.models.attribution.effect_sizes import Found
from surefoot.models.residuals.layout import layout_for
from surefoot.scenarios.trace.run import trace_logs
from surefoot.scenarios.trace.words import summary
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import effect
from surefoot.sim.effects.file import load_effects, save_effects
from surefoot.sim.log import Log, Meta
from surefoot.sim.robot import Robot
from surefoot.sim.robot.machine import FixedBase, load_machine, machine_for_log

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
    said = summary(found)
    assert "command: not used, the log lacks tau_ff" in said
    assert "imu_gyro" not in said, "a fixed base has no use for it"


@pytest.mark.parametrize("seconds", [4.0, _long(12.0)])
def test_a_drive_as_declared_lacks_nothing(seconds):
    """Its noise is that of its readings, rates among them: inertia makes torque of theirs."""
    found = trace_logs([swung(seconds)], PENDULUM)
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
    (line,) = (line for line in summary(found).splitlines() if "coulomb_friction" in line)
    assert "bounds are 0 and 2e+03" in line


@pytest.mark.long
def test_the_dry_friction_of_a_large_gear_is_named():
    """Far beyond what drives of legs have."""
    log = swung()
    rubbing = log.tau[:, 0] + 15.0 * np.tanh(log.dq[:, 0] / 0.03)
    found = trace_logs([log.with_columns({"tau_shoulder": rubbing})], PENDULUM)
    (one,) = (one for one in found.effects if one.name == "coulomb_friction")
    assert one.value == pytest.approx(15.0, rel=0.02)


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
    assert "coulomb_friction cart +3 N (95 % interval" in summary(found)
    save_effects(tmp_path / "effects.toml", found.effects, limbs=found.limbs)
    assert 'value = 3.0\nunit = "N"\n' in (tmp_path / "effects.toml").read_text()
    assert load_effects(tmp_path / "effects.toml") == found.effects
    units = {c.name: c.unit for c in layout_for(found.limbs).columns}
    assert (units["torque_cart"], units["torque_pole"]) == ("N", "N m")
    assert (units["rate_cart"], units["rate_pole"]) == ("m/s", "rad/s")


def test_too_short_a_log_is_not_identifiable():
    found = trace_logs([swung(1.0)], PENDULUM)
    assert found.verdict == "not_identifiable"
    assert "too short: 1.0 s where 3 s are needed" in summary(found)


def test_logs_of_one_drive_that_are_short_each_add_up():
    found = trace_logs(
        [swung(2.6, name="armature", size=0.02), swung(2.4, name="armature", size=0.02)], PENDULUM
    )
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
    with pytest.raises(SurefootError, match="joint elbow is not one of ak80_pendulum's: shoulder"):
        machine_for_log(Log(renamed, log.meta, "x"))
