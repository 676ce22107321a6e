"""Without numba's compiler (NUMBA_DISABLE_JIT, for debuggers and coverage) kernels do the same."""

import numpy as np
import pytest
from processes import printed

from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import walk

INTERPRETED = {"NUMBA_DISABLE_JIT": "1"}
SCENARIO = """
name = "short"
robot = "spot_class"
stand = 0.1
segment = [{duration = 0.3, forward = 0.3}]
"""


@pytest.mark.long
def test_an_interpreted_walk_is_the_compiled_one(tmp_path):
    file = tmp_path / "short.toml"
    file.write_text(SCENARIO)
    printed("-m", "surefoot", "simulate", file, "-o", tmp_path, env=INTERPRETED)
    interpreted = Log.read(tmp_path / "short_0.parquet")
    compiled = walk(Scenario.load(file), Robot.load("spot_class"), 0)
    # Compiled code contracts products and sums: the last digits differ, and steps amplify that.
    for name, values in compiled.columns.items():
        np.testing.assert_allclose(interpreted.columns[name], values, atol=1e-4, err_msg=name)
    assert np.ptp(compiled.columns["ref_p_x"]) > 0.02


def test_a_filter_can_be_made_without_the_compiler():
    code = """
import numpy as np
from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.filter import InvariantFilter
start = NavState(np.eye(3), np.zeros(3), np.zeros(3))
made = InvariantFilter(start, 0.01 * np.eye(15), FilterNoise())
made.predict(np.zeros(3), np.array([0.0, 0.0, 9.81]), 0.01)
"""
    printed("-c", code, env=INTERPRETED)
