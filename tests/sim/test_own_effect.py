"""An effect of a user's own package is in every list, is simulated, and is a candidate of trace."""

import numpy as np
import pytest
from own_package import found

from surefoot.models.attribution.evidence import all_keys, linearise, log_under_model, table_of
from surefoot.scenarios.cli.main import main
from surefoot.sim.effects import CATALOGUE, compensate_all, effect, known_effects
from surefoot.sim.log import Log

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


def test_an_effect_of_a_package_is_listed_simulated_and_a_candidate(tmp_path, monkeypatch, robot):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "walk.toml").write_text(WALK)
    (tmp_path / "boots.toml").write_text(EFFECTS)
    key = ("rubber_boots", "all")
    with found("own_effect"):
        main("simulate walk.toml --effects boots.toml -o logs".split())
        (path,) = (tmp_path / "logs").glob("*.parquet")
        assert [*known_effects()] == [*CATALOGUE.bundled, "rubber_boots"]
        log = Log.read(path)
        assert [one["name"] for one in log.meta.effects] == ["rubber_boots"]
        case = log_under_model(log, robot)
        assert key in all_keys(case)
        _, thicker = compensate_all([effect(*key, 0.004)], log, robot)
        assert thicker.foot_radius[0] - robot.foot_radius[0] == pytest.approx(0.004)
        # It moves readings and the body at once: its regressor is the difference of the residual.
        (one,) = linearise([case], [], [key]).X
        plain, with_it = (table_of(case, e) for e in ([], [effect(*key, 1e-3)]))
        slope = np.nan_to_num((plain - with_it) / 1e-3)[:, one.columns]
        assert one.values.any()
        assert np.abs(one.values - slope).max() < 1e-9 * np.abs(slope).max()
