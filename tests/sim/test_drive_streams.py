"""Torques and commands of drives on a fixed base: what is wrong with the stream is told from what
is wrong with the drive."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from pendulum import swung

from studies.measured import measured_folder
from surefoot.sim.importing.recording import import_log
from surefoot.sim.plausibility import check_log
from surefoot.sim.robot.machine import load_machine, machine_for_log

PENDULUM = load_machine("ak80_pendulum")
MEASURED = measured_folder()


@lru_cache
def drive(**hidden):
    """A pendulum that is driven about, with the angle that it goes to a tenth of a second later as
    its command."""
    log = swung(seed=5, seconds=8.0, **hidden)
    return log.with_columns({"q_des_shoulder": np.interp(log.t + 0.1, log.t, log.q[:, 0])})


def findings(column, altered):
    log = drive()
    x = altered(log.frame[column].to_numpy().copy(), log.t)
    return check_log(replace(log, frame=log.frame.assign(**{column: x})), PENDULUM)


def frozen(x, t):
    return np.where((t > 2.0) & (t < 6.0), x[np.searchsorted(t, 2.0)], x)


def held(x, t):
    return x[np.arange(len(x)) // 10 * 10]


def turned(x, t):
    return np.where(t > 4.0, -x, x)


def spiking(x, t):
    x[[900, 1700, 2500]] += 12.0 * x.std()
    return x


@pytest.mark.parametrize(
    ("column", "altered", "cause", "line"),
    [
        ("tau_shoulder", frozen, "it hangs (no change from 2.00 to", ""),
        ("tau_shoulder", turned, "changes during the log (at 4.0", ""),
        ("tau_shoulder", lambda x, t: -x, "wrong sign", "sign = -1 in the entry of tau_"),
        ("tau_shoulder", lambda x, t: x / 6, "of the motor's side", "gain = 6."),
        ("tau_shoulder", lambda x, t: 1e3 * x, "another unit", "gain = 0.0"),
        ("tau_shoulder", held, "a slower sensor", "held = "),
        ("tau_shoulder", spiking, "readings corrupted in transmission", ""),
        ("q_des_shoulder", frozen, "it hangs (no change from 2.00 to", ""),
        ("q_des_shoulder", turned, "changes during the log", ""),
        ("q_des_shoulder", lambda x, t: -x, "wrong sign", "sign = -1 in the entry of q_des_"),
        ("q_des_shoulder", lambda x, t: 3.0 * x, "than its angle's (2.98", "gain = 0.3"),
    ],
)
def test_a_fault_of_a_stream_is_told_with_its_size_and_the_line_that_mends_it(
    column, altered, cause, line
):
    (found,) = findings(column, altered)
    assert found.streams == (column,)
    assert cause in found.line
    assert line in found.map_line
    assert bool(found.map_line) == bool(line)


@pytest.mark.parametrize(
    "hidden", [{}, {"friction": 0.5}, {"scale": 1.4}, {"armature": 0.05}, {"pushes": (4.0,)}]
)
def test_what_a_drive_lacks_is_no_fault_of_its_streams(hidden):
    assert check_log(drive(**hidden), PENDULUM) == ()


def test_of_a_drive_that_is_all_friction_no_scale_is_told():
    """The last wrist of an arm: the model asks next to nothing of it."""
    log = drive()
    dq = np.gradient(log.q[:, 0], log.t)
    rubbing = 20.0 * np.tanh(dq / 0.05) + 0.02 * log.tau[:, 0]
    assert check_log(log.with_columns({"tau_shoulder": rubbing}), PENDULUM) == ()


def test_a_drive_at_its_limit_holds_its_torque():
    """It does not hang: the motion is what that torque makes."""
    log = drive()
    limited = np.clip(log.tau, -0.5, 0.5)
    found = check_log(log.with_columns({"tau_shoulder": limited[:, 0]}), PENDULUM)
    assert not any("hangs" in one.cause for one in found)


def test_of_a_machine_that_pushes_against_something_no_sign_is_told():
    """Its motion explains a part of its torque alone, of whichever sign."""
    log = drive()
    tau = log.tau[:, 0]
    push = np.sin(7.0 * log.t) * np.sqrt(2.0) * tau.std()
    pushed = log.with_columns({"tau_shoulder": -0.75 * tau + push})
    assert check_log(pushed, PENDULUM) == ()


@pytest.mark.skipif(not MEASURED.is_dir(), reason=f"the measured logs are not here ({MEASURED})")
@pytest.mark.parametrize("machine", ["ak80_pendulum", "ricmonk"])
def test_measured_drives_have_no_such_fault(machine):
    folder = MEASURED / machine
    pattern = "*_measured.csv" if machine == "ak80_pendulum" else "swings/*.csv"
    files = sorted(folder.glob(pattern))
    assert files
    for file in files:
        log = import_log(file, "ricmonk_swing" if machine == "ricmonk" else machine)
        model = folder / "ricmonk_published.xml" if machine == "ricmonk" else None
        assert check_log(log, machine_for_log(log, model)) == (), file.name
