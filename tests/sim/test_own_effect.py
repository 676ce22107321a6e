"""An effect of a user's own package is in every list, is simulated, and is a candidate of trace."""

import pytest
from own_package import run_with

from surefoot.sim.effects import CATALOGUE

WALK = """
robot = "spot_class"
stand = 0.2
segment = [{ duration = 1.0, forward = 0.4 }]
"""
EFFECTS = """
[[effect]]
name = "rubber_boots"
target = "all"
value = 0.004
unit = "m"
"""
CANDIDATE = """
import sys
import numpy as np
from surefoot.models.attribution.evidence import all_keys, linearise, log_under_model, table_of
from surefoot.sim.effects import compensate_all, effect, known_effects
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

log, robot = Log.read(sys.argv[1]), Robot.load("spot_class")
print(*known_effects())
print(*log.meta.effects)
print(("rubber_boots", "all") in all_keys(log_under_model(log, robot)))
_, known = compensate_all([effect("rubber_boots", "all", 0.004)], log, robot)
print(known.foot_radius[0] - robot.foot_radius[0])
key, case = ("rubber_boots", "all"), log_under_model(log, robot)
(one,) = linearise([case], [], [key]).X
without, with_it = (table_of(case, e) for e in ([], [effect(*key, 1e-3)]))
slope = np.nan_to_num((without - with_it) / 1e-3)[:, one.columns]
print(one.values.any(), np.abs(one.values - slope).max() / np.abs(slope).max())
"""


def test_an_effect_of_a_package_is_listed_simulated_and_a_candidate(tmp_path):
    (tmp_path / "walk.toml").write_text(WALK)
    (tmp_path / "boots.toml").write_text(EFFECTS)
    command = ("simulate", "walk.toml", "--effects", "boots.toml", "-o", "logs")
    run = run_with("own_effect", "-m", "surefoot", *command, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    (log,) = (tmp_path / "logs").glob("*.parquet")
    said = run_with("own_effect", "-c", CANDIDATE, str(log))
    assert said.returncode == 0, said.stderr
    names, declared, candidate, thicker, slope = said.stdout.splitlines()
    assert names.split() == [*CATALOGUE, "rubber_boots"]
    assert "'rubber_boots'" in declared
    assert candidate == "True"
    assert float(thicker) == pytest.approx(0.004)
    # It moves readings and the body at once: its regressor is the difference of the residual.
    there, apart = slope.split()
    assert there == "True"
    assert float(apart) < 1e-9
