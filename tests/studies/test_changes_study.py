"""Changes and faults that are put into runs of a chain of hinges, and how their traces count."""

from dataclasses import replace

import mujoco
import numpy as np
import pandas as pd
import pytest

from studies.hardware import changes
from studies.hardware.changes import ChangeCase, outcome_of, with_change, with_fault
from surefoot.sim.log import Log, Meta
from surefoot.sim.robot.machine import load_machine

CHAIN = """<mujoco model="chain"><compiler angle="radian"/><worldbody><body name="upper">
<joint name="hook" type="hinge" axis="1 0 0"/>
<inertial pos="0 -0.02 -0.15" mass="0.4" diaginertia="0.003 0.003 0.001"/>
<body name="middle" pos="0.03 -0.02 -0.3"><joint name="tail" type="hinge" axis="1 0 0"/>
<inertial pos="0 0.01 -0.12" mass="1.5" diaginertia="0.01 0.01 0.002"/>
<body name="lower" pos="0.03 0 -0.05"><joint name="phi" type="hinge" axis="1 0 0"/>
<inertial pos="0 0 -0.2" mass="0.3" diaginertia="0.003 0.003 0.001"/>
</body></body></body></worldbody></mujoco>"""
JOINTS = ("hook", "tail", "phi")


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    file = tmp_path_factory.mktemp("chain") / "chain.xml"
    file.write_text(CHAIN)
    return load_machine(file)


def swing(seed: int, mass: float = 0.0) -> Log:
    """A swing of 4 s without noise, with stamps that are uneven; its lower link is heavier by
    `mass` [kg].
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 4.0, 0.006) + rng.uniform(0.0, 0.002, 667)
    rate, phase = rng.uniform(2.0, 6.0, (2, 3, 1)), rng.uniform(0.0, 6.0, (2, 3, 1))
    angle = (rate * t + phase)[..., None, :]
    waves = 0.5 * np.stack([np.sin(angle), np.cos(angle), -np.sin(angle)])[:, :, :, 0]
    speed = np.stack([np.ones_like(rate), rate, rate**2])
    q, dq, ddq = np.moveaxis((waves * speed).sum(axis=1), 1, 2)
    spec = mujoco.MjSpec.from_string(CHAIN)
    spec.body("lower").mass += mass
    model = spec.compile()
    data, tau = mujoco.MjData(model), np.empty_like(q)
    for k in range(len(t)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], dq[k], ddq[k]
        mujoco.mj_inverse(model, data)
        tau[k] = data.qfrc_inverse
    columns = {"t": t}
    for name, values in (("q", q), ("dq", dq), ("tau", tau)):
        columns |= {f"{name}_{joint}": values[:, j] for j, joint in enumerate(JOINTS)}
    return Log(pd.DataFrame(columns), Meta(rate=1 / 0.006), f"swing {seed}")


def test_a_change_put_into_a_log_is_the_one_that_inverse_dynamics_asks_for(machine):
    plain, heavier = swing(5), swing(5, mass=0.2)
    mine = with_change(plain, machine, ("link_mass", "phi"), 0.2)
    inner = slice(20, -20)  # the kernel has no readings beyond the ends
    np.testing.assert_allclose(mine.tau[inner], heavier.tau[inner], atol=0.02)
    turned = with_change(plain, machine, ("encoder_offset", "tail"), 0.1)
    np.testing.assert_allclose(turned.q - plain.q, [[0.0, 0.1, 0.0]] * len(plain.t), atol=1e-12)
    np.testing.assert_array_equal(turned.tau, plain.tau)


@pytest.mark.parametrize("fault", changes.FAULTS)
def test_a_fault_is_in_the_readings_of_its_sensor_alone(fault):
    rows = swing(1).frame
    case = ChangeCase("run", None, fault, 0.05)
    off = with_fault(rows, case, np.random.default_rng(0)) - rows
    changed = {str(name) for name in off if np.abs(off[name]).max() > 0.0}
    if fault == "encoder held":
        (name,) = changed
        assert name in ("q_tail", "q_phi")
        kept = np.diff(with_fault(rows, case, np.random.default_rng(0))[name]) == 0.0
        assert kept.mean() == pytest.approx(changes.SHARE_HELD, abs=0.01)
    elif fault == "gyro scaled":
        assert changed == {"q_hook", "dq_hook"}
        attitude = rows["q_hook"] + rows["q_tail"]
        assert np.polyfit(attitude, off["q_hook"], 1)[0] == pytest.approx(0.05)
        assert np.polyfit(rows["dq_hook"] + rows["dq_tail"], off["dq_hook"], 1)[0] == pytest.approx(
            0.05
        )
    else:
        assert changed == {"q_hook"}
        assert off["q_hook"].iloc[-1] == pytest.approx(0.05)
        assert off["q_hook"].iloc[0] == pytest.approx(0.05 if fault == "attitude off" else 0.0)


HEAVIER = ChangeCase("run", ("link_mass", "phi"), size=0.2, least=0.1)
ZERO = ChangeCase("run", ("encoder_offset", "tail"), size=0.2, least=0.1)
FAULTY = ChangeCase("run", None, "attitude off", 0.05)


def said(verdict, *named, rivals=(), reasons=()):
    effects = [{"name": n, "target": t, "value": 0.1} for n, t in named]
    others = [{"name": n, "target": t} for n, t in rivals]
    return {"verdict": verdict, "effects": effects, "rivals": others, "reasons": list(reasons)}


MASS, OTHER, OFF = ("link_mass", "phi"), ("link_mass", "tail"), ("encoder_offset", "tail")


@pytest.mark.parametrize(
    ("case", "row", "outcome"),
    [
        (HEAVIER, said("attributed", MASS), "right"),
        (HEAVIER, said("attributed", ("link_com", "phi_z")), "right"),
        (HEAVIER, said("confounded", MASS, rivals=[OTHER]), "not alone"),
        (HEAVIER, said("confounded", OTHER, rivals=[MASS]), "not alone"),
        (HEAVIER, said("attributed", OTHER), "wrong"),
        (HEAVIER, said("unchanged"), "nothing"),
        (HEAVIER, said("not_identifiable", reasons=["q_phi is off"]), "not identifiable"),
        (ZERO, said("attributed", OFF), "right"),
        (ZERO, said("not_identifiable", reasons=["q_tail is off by +0.2"]), "right"),
        (ZERO, said("not_identifiable", reasons=["q_tail and dq_tail contradict"]), "right"),
        (ZERO, said("not_identifiable", reasons=["too short"]), "not identifiable"),
        (ZERO, said("attributed", OTHER), "wrong"),
        (FAULTY, said("attributed", ("encoder_offset", "hook")), "right"),
        (FAULTY, said("not_identifiable"), "not identifiable"),
        (FAULTY, said("attributed", MASS), "wrong"),
        (FAULTY, said("attributed", ("coulomb_friction", "hook")), "wrong"),
        (replace(FAULTY, fault=""), said("attributed", OFF), "wrong"),
        (replace(FAULTY, fault=""), said("unchanged"), "nothing"),
    ],
)
def test_an_outcome_is_right_on_its_body_and_a_sensor_is_no_mass(case, row, outcome):
    assert outcome_of(case, row) == outcome


def test_drawn_changes_are_of_every_kind_and_no_centre_of_mass_is_beyond_its_link():
    targets = [*JOINTS, *(f"{joint}_{axis}" for joint in JOINTS for axis in "yz")]
    least = [
        {"name": kind, "target": target, "value": 0.2}
        for kind in changes.KINDS
        for target in targets
        if (kind == "link_com") == ("_" in target)
    ]
    drawn = changes.drawn_changes(
        [(ChangeCase("run"), {"least": least})], JOINTS, 5, np.random.default_rng(0)
    )
    assert {case.change[0] for case in drawn if case.change} == set(changes.KINDS)
    assert all(0.5 <= case.ratio <= 5.0 for case in drawn)
    com = [abs(case.size) for case in drawn if case.change and case.change[0] == "link_com"]
    assert max(com) <= changes.FARTHEST_COM
    assert all(case.size > 0.0 for case in drawn if case.change and case.change[0] == "link_mass")


def test_cases_are_tried_once_and_kept(machine, tmp_path, monkeypatch):
    """Runs of an exact machine: what is put in is named, and rows come back without a trace."""
    files = {}
    for k in range(4):
        file = tmp_path / f"r{k}.csv"
        noise = np.random.default_rng(k).normal(0.0, 0.02, (667, 6))
        frame = swing(k).frame
        frame.iloc[:, 4:] += noise
        frame.to_csv(file, index=False)
        files[f"r{k}"] = [file]
    runs = changes.Runs(files, "ricmonk_swing", machine, tmp_path / "out", tmp_path / "kept", {})
    monkeypatch.setattr(changes, "KINDS", ("link_mass",))
    monkeypatch.setattr(changes, "FAULTS", ("attitude off",))
    tried = changes.tried_cases(runs, each=1, faults=1)
    assert [outcome_of(case, row) for case, row in tried[:4]] == ["nothing"] * 4
    counted = changes.counts_table(tried).set_index("put in")
    assert counted.cases.sum() == len(tried) == 8
    assert counted.wrong.sum() == 0
    above = counted.iloc[0]
    assert above.right == above.cases >= 1
    monkeypatch.setattr(changes, "traced", None)  # nothing is traced again
    again = changes.tried_cases(runs, each=1, faults=1)
    assert changes.cases_table(again).equals(changes.cases_table(tried))
    assert list(changes.unchanged_table(tried)["run"]) == ["r0", "r1", "r2", "r3"]
    assert {"r0", "r1", "r2", "r3"} < set(changes.least_table(tried))
