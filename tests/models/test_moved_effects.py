"""Bundled effects that were moved to a package of their own are traced as before: all that `trace`
knows of an effect is in its class."""

import numpy as np
import pytest
from driven import driven
from own_package import found

from surefoot.models.attribution.diagnose import diagnose
from surefoot.models.attribution.effect_sizes import per_run_effects, price_of_some_parts
from surefoot.scenarios.trace.result import Trace
from surefoot.sim.effects import CATALOGUE, effect, known_effects
from surefoot.sim.robot.limbs import QUADRUPED
from surefoot.sim.robot.machine import load_machine

MOVED = ("torque_bias", "viscous_friction", "rate_delay")


def traced():
    """What is found, and what is known of the effects' classes."""
    machine = load_machine("ak80_pendulum")
    log = driven(machine, [effect("viscous_friction", "shoulder", 0.1)], 12.0)
    # A tenth of a Newton metre in one run, and rates that lag by less than half a row in both.
    lagging = np.interp(log.t - 0.8e-3, log.t, log.dq[:, 0])
    log = log.with_columns({"dq_shoulder": lagging})
    biased = log.with_columns({"tau_shoulder": log.tau[:, 0] + 0.1})
    kinds = [known_effects()[name] for name in MOVED]
    rivals = tuple({"name": name} for name in MOVED)
    confounded = Trace(verdict="confounded", channels={}, filters={}, rivals=rivals)
    return diagnose([log, biased], machine), {
        "modules": {kind.__module__ for kind in kinds},
        "per_run": [name in per_run_effects() for name in MOVED],
        "sources": [kind.size_prior().source for kind in kinds],
        "motion": confounded.motion,
        "price": price_of_some_parts("viscous_friction", "FL_calf", QUADRUPED),
    }


@pytest.fixture(scope="module")
def traces():
    """With the bundled effects, and with those of the package."""
    bundled, before = traced(), dict(CATALOGUE.bundled)
    with found("moved_effects"):
        for name in MOVED:
            del CATALOGUE.bundled[name]
        try:
            moved = traced()
        finally:
            CATALOGUE.bundled.clear()
            CATALOGUE.bundled.update(before)
    return bundled, moved


def test_the_same_is_found(traces):
    (bundled, _), (moved, known) = traces
    assert known["modules"] == {"moved_effects"}
    assert bundled.verdict == moved.verdict
    (friction,) = moved.effects
    assert (friction.name, friction.target) == ("viscous_friction", "shoulder")
    assert friction.value == pytest.approx(bundled.effects[0].value, rel=1e-3)
    assert 0.0 < moved.found[0].least < friction.value
    assert friction.value == pytest.approx(0.1, rel=0.1)


def test_an_offset_belongs_to_its_run_and_a_lag_within_a_row_is_no_effect(traces):
    (bundled, kept), (moved, known) = traces
    assert kept["per_run"] == known["per_run"] == [True, False, False]
    first, second = ({z.effect.name: z.effect.value for z in run.zeros} for run in moved.runs)
    assert second["torque_bias"] - first.get("torque_bias", 0.0) == pytest.approx(0.1, abs=0.02)
    for trace in (bundled, moved):
        (lag,) = [note for note in trace.notes if "within a row" in note]
        assert "rate_delay" in lag


def test_prior_motion_and_spread_are_those_of_the_class(traces):
    (_, kept), (_, known) = traces
    assert all("package's author" in source for source in known["sources"])
    assert known["motion"].count(";") == 2
    assert "viscous torque grows" in known["motion"]
    assert kept["price"] == 0.0 < known["price"]
