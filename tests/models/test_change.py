"""What changed since runs of the unchanged machine, and nothing where nothing did."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from machines import ARM, machine, moved
from pendulum import swung

from surefoot.models.attribution.change import CONTRADICTION, NAMED, find_change
from surefoot.models.attribution.diagnose import DiagnosisOptions, diagnose
from surefoot.models.attribution.effect_sizes import interior_bounds, with_deviation
from surefoot.models.attribution.evidence import log_under_model
from surefoot.models.attribution.model_error import model_error, run_sums
from surefoot.sim.effects.base import with_columns
from surefoot.sim.log import LogError
from surefoot.sim.robot.machine import load_machine

PENDULUM = load_machine("ak80_pendulum")


@lru_cache
def case(seed, zero=0.0, **hidden):
    log = swung(seed=seed, seconds=8.0, **hidden)
    return log_under_model(with_columns(log, {"q_shoulder": log.q[:, 0] + zero}), PENDULUM)


@pytest.fixture(scope="module")
def known():
    runs = [case(seed, armature=x) for seed, x in enumerate((0.010, 0.014, 0.012, 0.011))]
    found = model_error([run_sums(one) for one in runs], PENDULUM.limbs)
    assert found is not None
    return found


def of(change):
    return [(one.effect.name, one.effect.target) for one in change.found]


@pytest.mark.parametrize("seed", [10, 11, 12])
def test_an_unchanged_run_is_unchanged(known, seed):
    change = find_change([case(seed, armature=0.012)], known)
    assert (change.verdict, change.found, change.reasons) == ("unchanged", (), ())


def test_friction_is_named_with_its_size(known):
    change = find_change([case(20, armature=0.012, friction=0.5)], known)
    assert (change.verdict, of(change)) == ("attributed", [("coulomb_friction", "shoulder")])
    low, high = change.found[0].interval
    assert low < 0.5 < high
    torque = change.channels["joint_torque"]
    assert torque.after < 0.7 * torque.before


def test_the_least_change_is_named_in_most_runs_and_half_of_it_in_few(known):
    """Asked: 95 of 100 at the least size."""
    least = find_change([case(10, armature=0.012)], known).least["coulomb_friction", "shoulder"]
    named = {
        share: [
            of(find_change([case(seed, armature=0.012, friction=share * least)], known)) != []
            for seed in range(30, 36)
        ]
        for share in (0.4, 1.3)
    }
    assert sum(named[1.3]) >= 5
    assert sum(named[0.4]) <= 3


@pytest.mark.parametrize("zero", [0.19, -0.7, 3.0])
def test_a_lost_zero_is_named_and_no_mass(known, zero):
    """One beyond the bounds of the effect is said in words."""
    change = find_change([case(40, zero, armature=0.012)], known)
    if abs(zero) < 0.2:
        assert of(change)[0] == ("encoder_offset", "shoulder")
        assert change.found[0].effect.value == pytest.approx(zero, abs=0.03)
    else:
        assert (change.verdict, of(change)) == ("not_identifiable", [])
        assert float(change.reasons[0].removeprefix("q_shoulder is off by ")) == pytest.approx(
            zero, abs=0.1
        )


def test_an_encoder_that_hangs_is_named_and_no_mass(known):
    log = case(41, armature=0.012).log
    q = log.q[:, 0].copy()
    q[1000:2000] = q[1000]
    hung = log_under_model(with_columns(log, {"q_shoulder": q}), PENDULUM)
    change = find_change([hung], known)
    assert (change.verdict, change.found) == ("not_identifiable", ())
    assert "q_shoulder and dq_shoulder contradict each other" in change.reasons[0]


def test_a_hand_is_said_with_its_time_and_the_run_is_not_called_unchanged(known):
    change = find_change([case(60, armature=0.012, pushes=(4.0, 4.15, 4.3))], known)
    assert (change.verdict, change.found) == ("not_identifiable", ())
    (said,) = change.reasons
    assert said.startswith("outside forces of up to")
    begin, end = (float(said.split()[place]) for place in (-7, -5))
    assert 3.3 < begin < 4.1 < 4.4 < end < 5.2


def test_what_changed_is_judged_where_nothing_pushes(known):
    pushes = tuple(np.arange(4.0, 5.5, 0.15))
    change = find_change([case(61, armature=0.012, friction=0.5, pushes=pushes)], known)
    assert (change.verdict, of(change)) == ("attributed", [("coulomb_friction", "shoulder")])
    low, high = change.found[0].interval
    assert low < 0.5 < high
    assert change.pushes


def test_commands_that_are_delivered_late_are_a_change():
    def commanded(seed, late=0.0):
        log, rng = swung(seed=seed, seconds=8.0), np.random.default_rng(seed)
        rates, phases = rng.uniform(1.0, 6.0, 4), rng.uniform(0.0, 6.0, 4)
        asked = 0.9 * np.sin(rates * (log.t[:, None] + late) + phases).sum(axis=1)
        return log_under_model(with_columns(log, {"tau_ff_shoulder": asked}), PENDULUM)

    known = model_error([run_sums(commanded(seed)) for seed in range(3)], PENDULUM.limbs)
    assert known is not None
    assert find_change([commanded(10)], known).verdict == "unchanged"
    change = find_change([commanded(11, late=0.02)], known)
    assert (change.verdict, of(change)) == ("attributed", [("command_delay", "all")])
    low, high = change.found[0].interval
    assert low < 0.02 < high


def test_a_shift_of_the_centre_that_a_lost_zero_imitates_has_a_large_least_size(known):
    """Along the pendulum it is told from a zero, across it by little but the second order."""
    least = find_change([case(10, armature=0.012)], known).least
    sizes = [size for (name, _), size in least.items() if name == "link_com"]
    assert max(sizes) > 10.0 * min(sizes)


def test_what_a_load_changes_is_told_on_a_machine_that_moves_in_a_plane(tmp_path):
    """Its mass and the shift of the centre, though nothing shows the shift across the plane."""
    arm, noise = machine(ARM, tmp_path), {"shoulder": 0.2, "elbow": 0.1}

    def run(edit=lambda spec: None, seed=0):
        return log_under_model(moved(arm, noise, edit, seed), arm)

    def loaded(spec):
        ball = spec.joint("elbow").parent.add_body(pos=(0.28, 0.0, 0.0))
        ball.add_geom(size=[0.02, 0, 0], mass=0.5, contype=0, conaffinity=0)

    known = model_error([run_sums(run(seed=seed)) for seed in range(3)], arm.limbs)
    assert known is not None
    change = find_change([run(loaded, 9)], known)
    assert change.verdict == "attributed"
    found = {(one.effect.name, one.effect.target): one.interval for one in change.found}
    low, high = found["link_mass", "elbow"]
    assert low < 0.5 < high
    # The centre of the link and of the load, from that of the link.
    low, high = found["link_com", "elbow_x"]
    assert low < 0.5 * (0.28 - 0.15) / 3.5 < high


def test_runs_add_up(known):
    """Two runs tell a change half of whose square neither has."""
    one, two = ([case(seed, armature=0.012) for seed in seeds] for seeds in ((50,), (50, 51)))
    first, both = (find_change(cases, known).least for cases in (one, two))
    assert both["coulomb_friction", "shoulder"] < first["coulomb_friction", "shoulder"]


def test_readings_that_differ_are_refused_in_one_line(known):
    log = case(10, armature=0.012).log
    without = replace(log, frame=log.frame.drop(columns="tau_shoulder"))
    with pytest.raises(LogError, match="its readings differ from those of the runs"):
        find_change([log_under_model(without, PENDULUM)], known)


@pytest.mark.parametrize(("seconds", "verdict"), [(1.6, "unchanged"), (0.8, "not_identifiable")])
def test_a_run_of_some_windows_is_compared(known, seconds, verdict):
    log = case(10, armature=0.012).log
    short = log.rows(slice(0, int(seconds * log.rate)))
    found = diagnose([short], PENDULUM, DiagnosisOptions(declared=(), since=known))
    assert found.verdict == verdict
    assert bool(found.least) == (verdict == "unchanged")


def test_no_link_loses_more_mass_than_it_has():
    low, high = interior_bounds("link_mass", "shoulder", PENDULUM)
    assert low == pytest.approx(-PENDULUM.limbs.mass)
    assert high > 10.0
    lost = with_deviation(("link_mass", "shoulder"), -5.0, 0.1, PENDULUM)
    assert lost.effect.value == low
    assert lost.interval == pytest.approx((-5.196, -4.804))


def test_thresholds_are_odds():
    assert np.exp(NAMED / 2.0) == pytest.approx(1000.0)
    assert CONTRADICTION > 1.0
