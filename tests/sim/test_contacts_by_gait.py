"""Contacts by which legs swing together, and streams that are moved to when they were."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from refusals import refused
from written import written

from surefoot.sim.importing.contacts import feet_that_stand, legs_in_phase, up_by_feet, up_in_imu
from surefoot.sim.importing.recording import import_log
from surefoot.sim.importing.sections import ContactTable
from surefoot.sim.log import Log
from surefoot.sim.plausibility import check_log
from surefoot.sim.robot import Robot

GAIT = ContactTable(on=0.0, off=0.0, of="gait")


@pytest.fixture(scope="module")
def trot(log) -> Log:
    """A trot as a robot logs it that knows where its feet are and not which of them stand."""
    feet = Robot.load("spot_class").feet_I(log.q)
    kept = [c for c in log.frame if c == "t" or c.startswith(("gyro", "accel", "contact"))]
    columns = {
        f"foot_{leg}_{axis}": feet[:, k, i]
        for k, leg in enumerate(log.legs)
        for i, axis in enumerate("xyz")
    }
    frame = log.frame[kept].assign(**columns)
    return replace(log, frame=frame, meta=replace(log.meta, robot=None, effects=()))


@pytest.mark.parametrize("up", [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [-0.6, 0.0, -0.8]])
def test_upward_is_what_an_accelerometer_at_rest_says_however_it_is_mounted(up):
    t = 0.01 * np.arange(50)
    accel = np.tile(9.81 * np.array(up), (50, 1))
    np.testing.assert_allclose(up_in_imu(t, np.zeros((50, 3)), accel), np.tile(up, (50, 1)))


def test_the_lower_diagonal_of_a_trot_stands(trot):
    up = up_in_imu(trot.t, trot.gyro, trot.accel)
    diagonals = np.array([0, 1, 1, 0])
    together = legs_in_phase(trot.t, trot.foot_I, up)
    np.testing.assert_array_equal(together, diagonals == diagonals[:, None])
    found = feet_that_stand(trot, GAIT)
    assert "contact from gait" in found.meta.derived
    walks = trot.t > trot.t[0] + 1.5
    single = walks & (trot.contact.sum(axis=1) == 2)
    # A foot that has landed is pressed down for some rows more before it is the lower one.
    assert np.mean(found.contact[single] == trot.contact[single]) > 0.93
    np.testing.assert_array_equal(found.contact[:, 0], found.contact[:, 3])
    np.testing.assert_array_equal(found.contact[walks, 0], ~found.contact[walks, 1])


def test_a_biased_accelerometer_does_not_move_the_exchange_of_feet(trot):
    """A bias of 1.5 m/s^2 tilts the accelerometer's upward direction by 9 degrees."""
    frame = trot.frame.assign(accel_x=trot.frame.accel_x + 1.5)
    found = feet_that_stand(replace(trot, frame=frame), GAIT)
    np.testing.assert_array_equal(found.contact, feet_that_stand(trot, GAIT).contact)


def test_upward_is_across_the_plane_of_the_feet_and_the_accelerometers_for_two_feet():
    t = 0.01 * np.arange(300)
    still, accel = np.zeros((300, 3)), np.tile([2.0, 0.0, 9.6], (300, 1))
    square = np.array(
        [[0.3, 0.2, -0.5], [0.3, -0.2, -0.5], [-0.3, 0.2, -0.56], [-0.3, -0.2, -0.56]]
    )
    feet_I = np.tile(square, (300, 1, 1))
    across = np.array([-0.1, 0.0, 1.0]) / np.sqrt(1.01)
    np.testing.assert_allclose(up_by_feet(t, still, accel, feet_I), np.tile(across, (300, 1)))
    by_accelerometer = up_in_imu(t, still, accel)
    np.testing.assert_array_equal(up_by_feet(t, still, accel, feet_I[:, :2]), by_accelerometer)
    in_line = feet_I * [1.0, 0.1, 1.0]
    np.testing.assert_array_equal(up_by_feet(t, still, accel, in_line), by_accelerometer)


def test_legs_that_all_swing_together_have_no_gait(trot):
    one = {
        f"foot_{leg}_{axis}": trot.frame[f"foot_FL_{axis}"] for leg in trot.legs for axis in "xyz"
    }
    together = replace(trot, frame=trot.frame.assign(**one))
    refused("all legs swing together", feet_that_stand, together, GAIT)


def test_import_says_how_to_mend_rates_that_come_late_and_its_line_mends_them(tmp_path):
    t = np.arange(0.0, 8.0, 0.004)
    late = t - 0.012
    q = np.sin(9.0 * t) + 0.3 * np.sin(23.0 * t)
    dq = 9.0 * np.cos(9.0 * late) + 6.9 * np.cos(23.0 * late)
    pd.DataFrame({"t": t, "q": q, "dq": dq}).to_csv(tmp_path / "log.csv", index=False)
    text = '[columns]\nt = "t"\nq_a = "q"\ndq_a = "dq"\n'
    (found,) = check_log(import_log(tmp_path / "log.csv", written(tmp_path / "map.toml", text)))
    late = found.changes["even"]["late"]["dq"]
    assert late == pytest.approx(0.012, abs=1e-3)
    line, _, section = found.map_line.partition(" in ")
    (tmp_path / "map.toml").write_text(f"{text}{section}\n{line}")
    mended = import_log(tmp_path / "log.csv", tmp_path / "map.toml")
    assert check_log(mended) == ()
    assert f"dq ({1e3 * late:g} ms earlier)" in mended.meta.derived


def test_upward_is_first_the_mean_of_the_seconds_in_which_it_settles():
    """One reading that is struck sideways turns it by a hundredth of what it would alone."""
    t = 0.01 * np.arange(800)
    accel = np.tile([0.0, 0.0, 9.81], (len(t), 1))
    accel[0, 0] = 9.81
    up = up_in_imu(t, np.zeros_like(accel), accel)
    assert 0.0 < up[0, 0] < 0.01


@pytest.mark.parametrize("derived", [False, True])
def test_late_contacts_are_moved_to_when_they_were(log, tmp_path, derived):
    """As logged, or found from a force; flags stay flags."""
    rows, quantity = 15, "force" if derived else "contact"
    before = log.rows(slice(0, 2000))
    after = before.frame.filter(regex="^(t|q_[FR]..*|contact_.*)$").copy()
    flags = [f"contact_{leg}" for leg in log.legs]
    after[flags] = after[flags].shift(rows, fill_value=1.0)
    after.to_csv(tmp_path / "run.csv", index=False)
    named = {name: name.replace("contact", quantity) for name in after}
    contact = "".join(f'{ours} = "{theirs}"\n' for theirs, ours in named.items())
    contact += "[contact]\non = 0.5\noff = 0.5\n" if derived else ""
    text = f"[columns]\n{contact}[even]\nlate = {{ contact = {rows / log.rate} }}\n"
    found = import_log(tmp_path / "run.csv", written(tmp_path / "map.toml", text))
    assert len(found.t) == len(after) - rows
    # Rows that [even] makes may be a rounding error before those of the file.
    assert np.mean(found.contact != before.contact[: len(found.t)]) < 0.01
    assert f"contact ({1e3 * rows / log.rate:g} ms earlier)" in found.meta.derived
    one = written(tmp_path / "map.toml", text.replace("{ contact =", "{ contact_XX ="))
    refused(r"\[even\] late: no column of kind 'contact_XX'", import_log, tmp_path / "run.csv", one)
