"""An effect of a user's own package is in every list, is simulated, and is a candidate of trace."""

import pytest
from own_package import run_with

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.plugins import plugins
from surefoot.sim.effects import CATALOGUE, effect, known_effects

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


def test_without_the_package_its_name_is_unknown_and_the_known_are_listed(tmp_path):
    (tmp_path / "walk.toml").write_text(WALK)
    (tmp_path / "boots.toml").write_text(EFFECTS)
    command = ("simulate", "walk.toml", "--effects", "boots.toml", "-o", "logs")
    run = run_with("", "-m", "surefoot", *command, cwd=tmp_path)
    assert run.returncode != 0
    assert "unknown effect 'rubber_boots'; known: encoder_offset" in run.stderr
    assert "Traceback" not in run.stderr


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("Mine = 3", "lacks name, unit"),
        ("class Mine(Effect):\n    name = 'mine'", "lacks unit, bounds"),
        (
            "from surefoot.sim.effects.imu import GyroBias as Mine",
            "its class calls itself gyro_bias",
        ),
        ("import nowhere", "cannot be imported"),
    ],
)
def test_a_package_at_fault_is_named_in_one_line(tmp_path, monkeypatch, source, said):
    monkeypatch.syspath_prepend(str(tmp_path))
    text = f"from surefoot.sim.effects.base import Effect\n{source}\n"
    module = f"mine_{abs(hash(source))}"
    (tmp_path / f"{module}.py").write_text(text)
    info = tmp_path / "mine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[surefoot.effects]\nmine = {module}:Mine\n")
    plugins.cache_clear()
    try:
        with pytest.raises(SurefootError, match=r"plugin mine .*surefoot\.effects") as caught:
            known_effects()["mine"]
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)
        # Nothing but its own use is stopped by it.
        assert list(known_effects()) == [*CATALOGUE, "mine"]
        assert effect("gyro_bias", "x", 0.01).value == 0.01
        assert list(known_effects().usable()[0]) == list(CATALOGUE)
    finally:
        monkeypatch.undo()
        plugins.cache_clear()
