"""What has changed on a chain of hinges, on chains whose changes are known."""

import mujoco
import numpy as np
import pandas as pd
import pytest

from studies.hardware import changes
from studies.hardware.changes import every_change, named_changes, with_change
from studies.hardware.impulses import as_published, window_rows
from studies.hardware.shared_sizes import runs_left_out, shared_calibration
from surefoot.sim.log import Log, Meta
from surefoot.sim.robot.machine import load_machine

CHAIN = """<mujoco model="chain"><compiler angle="radian"/><worldbody><body name="upper">
<joint name="top" type="hinge" axis="1 0 0"/>
<inertial pos="0 -0.02 -0.15" mass="0.4" diaginertia="0.003 0.003 0.001"/>
<body name="middle" pos="0.03 -0.02 -0.3"><joint name="mid" type="hinge" axis="1 0 0"/>
<inertial pos="0 0.01 -0.12" mass="1.5" diaginertia="0.01 0.01 0.002"/>
<body name="lower" pos="0.03 0 -0.05"><joint name="low" type="hinge" axis="1 0 0"/>
<inertial pos="0 0 -0.2" mass="0.3" diaginertia="0.003 0.003 0.001"/>
</body></body></body></worldbody></mujoco>"""
JOINTS = ("top", "mid", "low")
WINDOW = 0.3


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    file = tmp_path_factory.mktemp("chain") / "chain.xml"
    file.write_text(CHAIN)
    return load_machine(file)


def swing(seed: int, mass: float = 0.0, friction: float = 0.0, noise: float = 0.1) -> Log:
    """A swing of 4 s with stamps that are uneven; its lower link is heavier by `mass` [kg], and its
    middle joint has dry friction [N m]. noise: of torques [N m], and a tenth of it of rates."""
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
    tau[:, 1] += friction * np.tanh(dq[:, 1] / 0.02)
    tau += rng.normal(0.0, max(noise, 1e-12), q.shape)
    dq = dq + rng.normal(0.0, 0.1 * max(noise, 1e-12), q.shape)
    columns = {"t": t}
    for name, values in (("q", q), ("dq", dq), ("tau", tau)):
        columns |= {f"{name}_{joint}": values[:, j] for j, joint in enumerate(JOINTS)}
    return Log(pd.DataFrame(columns), Meta(rate=1 / 0.006), f"swing {seed}")


def test_the_integrated_balance_is_that_of_inverse_dynamics(machine):
    log = swing(0, noise=0.0)
    rows = window_rows(log, machine, WINDOW)
    assert np.abs(rows.rest).max() < 2e-3 < 1e-3 * np.abs(log.tau).max()


def test_terms_are_what_changed_masses_ask_for(machine):
    same, heavier = (window_rows(swing(1, mass=m, noise=0.0), machine, WINDOW) for m in (0.0, 0.2))
    asked = heavier.rest - same.rest
    np.testing.assert_allclose(0.2 * same.changes["link_mass", "low"], asked, atol=1e-3)
    # The same by what shows: the lower link's own, and the mass as a point at its hinge.
    own = {"first moment z": -0.2 * 0.2, "inertia about the hinge": 0.2 * 0.2**2}
    shown = sum(size * same.terms[name, "low"] for name, size in own.items())
    at = {"first moment z": -0.2 * 0.05, "inertia about the hinge": 0.2 * 0.05**2}
    shown = shown + sum(size * same.terms[name, "mid"] for name, size in at.items())
    at = {"first moment y": -0.2 * 0.02, "first moment z": -0.2 * 0.3}
    at["inertia about the hinge"] = 0.2 * (0.02**2 + 0.3**2)
    shown = shown + sum(size * same.terms[name, "top"] for name, size in at.items())
    np.testing.assert_allclose(shown, asked, atol=1e-3)
    assert ("link_com", "low_x") not in same.changes


def test_what_is_published_counts_the_links_beyond(machine):
    found = as_published(machine, "mid")
    assert found["first moment z"] == pytest.approx(-1.5 * 0.12 - 0.3 * 0.05)
    assert found["first moment y"] == pytest.approx(1.5 * 0.01)
    inertia = 0.01 + 1.5 * (0.12**2 + 0.01**2) + 0.3 * 0.05**2
    assert found["inertia about the hinge"] == pytest.approx(inertia)


@pytest.fixture(scope="module")
def runs():
    return {f"run {k}": [swing(k, friction=0.3)] for k in range(4)}


def test_a_change_is_named_on_its_link_and_nothing_where_nothing_changed(machine, runs):
    before = shared_calibration(
        {r: [window_rows(x, machine, WINDOW) for x in own] for r, own in runs.items()}
    )
    at = before.keys.index(("dry friction", "mid"))
    assert before.value[at] == pytest.approx(0.3, abs=0.05)

    def found(log: Log):
        return named_changes(every_change(before, [window_rows(log, machine, WINDOW)]))

    assert found(swing(9, friction=0.3)) == ()
    (heavier,) = found(swing(9, friction=0.3, mass=0.15))
    assert heavier.key == ("link_mass", "low")
    assert heavier.size == pytest.approx(0.15, abs=4 * heavier.deviation)
    (rougher,) = found(swing(9, friction=0.8))
    assert rougher.key == ("coulomb_friction", "mid")


def test_a_change_put_into_a_log_is_the_one_that_inverse_dynamics_asks_for(machine):
    plain, heavier = swing(5, noise=0.0), swing(5, mass=0.2, noise=0.0)
    mine = with_change(plain, machine, ("link_mass", "low"), 0.2)
    inner = slice(20, -20)  # the kernel has no readings beyond the ends
    np.testing.assert_allclose(mine.tau[inner], heavier.tau[inner], atol=0.02)
    turned = with_change(plain, machine, ("encoder_offset", "mid"), 0.1)
    np.testing.assert_allclose(turned.q - plain.q, [[0.0, 0.1, 0.0]] * len(plain.t), atol=1e-12)
    np.testing.assert_array_equal(turned.tau, plain.tau)


def test_half_of_the_changes_at_the_threshold_are_named_by_chance():
    least = {"key": ("link_mass", "low"), "size": 1.0, "least": 1.0}
    at = {**least, "size": changes.NAMED / (changes.NAMED + changes.SURE)}
    unchanged = {"key": None, "size": 0.0, "least": None}
    chances = [changes.chance_of_a_name(row) for row in (least, at, unchanged)]
    assert chances == pytest.approx([0.95, 0.5, 0.0], abs=1e-3)


def test_drawn_changes_are_tried_once_and_kept(machine, runs, tmp_path, monkeypatch):
    done = runs_left_out(
        {r: [window_rows(x, machine, WINDOW) for x in own] for r, own in runs.items()}
    )
    monkeypatch.setattr(changes, "KINDS", ("link_mass", "coulomb_friction"))
    kept = changes.KeptRows(tmp_path, {})
    rows = changes.tried_changes(runs, machine, done, WINDOW, kept, each=1)
    assert [row["run"] for row in rows if row["key"] is None] == list(runs)
    counted = changes.counts_table(rows).set_index("changed")
    assert counted.cases.sum() == len(rows)
    assert counted.loc["nothing", "nothing"] == len(runs)
    assert counted.wrong.sum() == 0
    assert counted.iloc[0].right == counted.iloc[0].cases >= 3
    monkeypatch.setattr(changes, "window_rows", None)  # nothing is judged again
    again = changes.tried_changes(runs, machine, done, WINDOW, kept, each=1)
    assert changes.changes_table(again).equals(changes.changes_table(rows))
    assert list(changes.unchanged_table({WINDOW: done})) == ["run", f"{WINDOW:g} s"]
    assert len(changes.least_table(done)) == len(done[0].rows[0].changes)
