"""Links that weigh something else than their file says, on fixed bases: named, not stood in for."""

import pytest
from driven import driven

from surefoot.scenarios.trace.run import trace_logs
from surefoot.sim.effects import effect
from surefoot.sim.robot.machine import Modelled, load_machine

ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="upper" pos="0 0 1">
<joint name="shoulder" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1.5"/>
<body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.025" mass="0.8"/></body></body>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Modelled:
    file = tmp_path_factory.mktemp("arm") / "arm.xml"
    file.write_text(ARM)
    return load_machine(file)


@pytest.mark.parametrize(
    ("name", "target", "value"),
    [
        ("link_mass", "elbow", 0.1),
        pytest.param("link_mass", "shoulder", 0.2, marks=pytest.mark.long),
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


def test_a_heavier_pendulum_is_named_and_no_encoder_scale_stands_in_for_it():
    """A torque scale nearly can: what a pendulum's mass weighs and what it resists grow alike."""
    pendulum = load_machine("ak80_pendulum")
    found = trace_logs([driven(pendulum, [effect("link_mass", "shoulder", 0.1)])], pendulum)
    assert [e.name for e in found.effects] == ["link_mass"]
    assert found.effects[0].value == pytest.approx(0.1, rel=0.02)
    assert {name for (name, _), _ in found.rivals} <= {"torque_scale"}


def test_an_arm_as_declared_lacks_nothing(arm):
    assert trace_logs([driven(arm, [])], arm).effects == ()
