"""Bundled effects that were moved to a package of their own are traced as before: all that `trace`
knows of an effect is in its class."""

import json

import pytest
from own_package import run_with

MOVED = ("torque_bias", "viscous_friction", "rate_delay")
TRACE = """
import json
import sys

import numpy as np
from driven import driven

from surefoot.models.attribution.diagnose import diagnose
from surefoot.models.attribution.effect_sizes import per_run_effects, price_of_some_parts
from surefoot.scenarios.trace.words import motion_to_distinguish
from surefoot.sim.effects import CATALOGUE, effect, known_effects
from surefoot.sim.robot.limbs import QUADRUPED
from surefoot.sim.robot.machine import load_machine

for name in sys.argv[1:]:
    del CATALOGUE.bundled[name]  # now the package's
machine = load_machine("ak80_pendulum")
log = driven(machine, [effect("viscous_friction", "shoulder", 0.1)], 12.0)
# A tenth of a Newton metre in one run, and rates that lag by less than half a row in both.
lagging = np.interp(log.t - 0.8e-3, log.t, log.dq[:, 0])
log = log.with_columns({"dq_shoulder": lagging})
biased = log.with_columns({"tau_shoulder": log.tau[:, 0] + 0.1})
found = diagnose([log, biased], machine)
names = ("torque_bias", "viscous_friction", "rate_delay")
kinds = [known_effects()[name] for name in names]
print(
    json.dumps(
        {
            "modules": [kind.__module__ for kind in kinds],
            "verdict": found.verdict,
            "effects": [[e.name, e.target, e.value] for e in found.effects],
            "runs": [[[z.effect.name, z.effect.value] for z in run.zeros] for run in found.runs],
            "lags": [note for note in found.notes if "within a row" in note],
            "per_run": [name in per_run_effects() for name in names],
            "sources": [kind.size_prior().source for kind in kinds],
            "motion": motion_to_distinguish(names),
            "price": price_of_some_parts("viscous_friction", "FL_calf", QUADRUPED),
        }
    )
)
"""


@pytest.fixture(scope="module")
def traces():
    """What is found with the bundled effects, and with those of the package."""
    found = []
    for moved in ((), MOVED):
        package = "moved_effects" if moved else "own_channel"
        done = run_with(package, "-c", TRACE, *moved)
        assert done.returncode == 0, done.stderr
        found.append(json.loads(done.stdout))
    return found


def test_the_same_is_found(traces):
    bundled, moved = traces
    assert set(moved["modules"]) == {"moved_effects"}
    assert bundled["verdict"] == moved["verdict"]
    assert [one[:2] for one in moved["effects"]] == [["viscous_friction", "shoulder"]]
    for one, other in zip(bundled["effects"], moved["effects"], strict=True):
        assert one[:2] == other[:2]
        assert one[2] == pytest.approx(other[2], rel=1e-3)
    assert moved["effects"][0][2] == pytest.approx(0.1, rel=0.1)


def test_an_offset_belongs_to_its_run_and_a_lag_within_a_row_is_no_effect(traces):
    bundled, moved = traces
    assert bundled["per_run"] == moved["per_run"] == [True, False, False]
    first, second = map(dict, moved["runs"])
    assert second["torque_bias"] - first.get("torque_bias", 0.0) == pytest.approx(0.1, abs=0.02)
    assert len(moved["lags"]) == len(bundled["lags"]) == 1
    assert "rate_delay" in moved["lags"][0]


def test_prior_motion_and_spread_are_those_of_the_class(traces):
    bundled, moved = traces
    assert all("package's author" in source for source in moved["sources"])
    assert moved["motion"].count(";") == 2
    assert "viscous torque grows" in moved["motion"]
    assert bundled["price"] == 0.0 < moved["price"]
