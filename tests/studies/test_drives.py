"""The balance of a drive's torques against simulated drives whose hidden parts are known."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from pendulum import swung

from studies.hardware.drives import (
    EFFECTS,
    balance,
    fit_sizes,
    left,
    ranges,
    rms,
    select,
)
from surefoot.sim.robot.machine import load_machine


@pytest.fixture(scope="module")
def machine():
    return load_machine("ak80_pendulum")


def test_what_a_drive_hides_is_named_and_sized_and_told_of_another_run(machine):
    hidden = {"scale": 1.15, "friction": 0.2, "armature": 0.012}
    seen = [balance(swung(**hidden, seed=s), machine, 0.04) for s in (1, 2)]
    unseen = balance(swung(**hidden, seed=3), machine, 0.04)
    names = select(seen, 0, tuple(EFFECTS))
    assert set(names) == {"torque_scale", "coulomb_friction", "armature"}
    sizes = fit_sizes(seen, 0, names, np.random.default_rng(0))
    # What the drive reports is scaled, its own friction and rotor too.
    truth = {"torque_scale": 0.15, "coulomb_friction": 1.15 * 0.2, "armature": 1.15 * 0.012}
    for name, value in zip(sizes.names, sizes.values, strict=True):
        assert value == pytest.approx(truth[name], rel=0.1), name
    before, after = rms(left(unseen, 0)), rms(left(unseen, 0, sizes))
    assert after < 0.35 * before
    assert after < 2.0 * unseen.floor[0]


def test_a_drive_that_hides_nothing_is_given_nothing(machine):
    one = balance(swung(seed=4), machine, 0.04)
    assert select([one], 0, tuple(EFFECTS)) == ()
    assert rms(left(one, 0)) < 2.0 * one.floor[0]


def test_intervals_hold_the_truth_about_as_often_as_they_say(machine):
    """95 % intervals of dry friction over eight runs: fewer than three misses (binomial: 6e-3)."""
    missed = 0
    for seed in range(8):
        one = balance(swung(friction=0.15, seed=10 + seed, seconds=8.0), machine, 0.04)
        low, high = fit_sizes([one], 0, ["coulomb_friction"], np.random.default_rng(0)).interval[0]
        missed += not low - 0.01 <= 0.15 <= high + 0.01
    assert missed < 3


def test_a_hand_on_the_rod_is_left_out_and_changes_nothing(machine):
    free = balance(swung(friction=0.2, seed=5), machine, 0.04)
    pushed = balance(swung(friction=0.2, seed=5, push=6.0), machine, 0.04)
    touched = (pushed.t > 6.0) & (pushed.t < 6.15)
    assert not pushed.good[touched, 0].any()
    assert pushed.good.mean() > 0.85
    rng = np.random.default_rng(0)
    one, other = (fit_sizes([b], 0, ["coulomb_friction"], rng).values[0] for b in (free, pushed))
    assert other == pytest.approx(one, abs=0.03)


def test_a_heavier_rod_looks_exactly_like_a_torque_scale_with_armature(machine):
    """Both are combinations of gravity and inertia: no data of one joint tells them apart."""
    one = balance(swung(scale=1.2, armature=0.01, seed=6), machine, 0.04)
    rng = np.random.default_rng(0)
    rests = [
        left(one, 0, fit_sizes([one], 0, names, rng))
        for names in (("torque_scale", "armature"), ("gravity", "inertia"))
    ]
    np.testing.assert_allclose(rests[0][one.good[:, 0]], rests[1][one.good[:, 0]], atol=1e-3)


def test_rows_near_a_stop_are_not_believed(machine, tmp_path):
    text = machine.file.read_text().replace(
        'axis="0 -1 0"', 'axis="0 -1 0" limited="true" range="-0.9 3.0"'
    )
    (tmp_path / "stopped.xml").write_text(text)
    stopped = replace(machine, file=tmp_path / "stopped.xml")
    log = swung(seed=7)
    one = balance(log, stopped, 0.04, stops=0.1)
    q = np.interp(one.t, log.t, log.q[:, 0])
    assert (q < -0.8).any()
    assert not one.good[q < -0.81, 0].any()
    assert one.good[(q > -0.3) & (q < 0.3), 0].mean() > 0.3
    model = mujoco.MjModel.from_xml_path(str(stopped.file))
    assert [float(x[0]) for x in ranges(model, np.array([0]))] == [-0.9, 3.0]
