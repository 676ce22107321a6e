"""Filters on a log whose robot has effects that neither its log nor its model declares."""

from dataclasses import replace

import pytest
from refusals import refused
from written import written

from surefoot import Scenario, walk
from surefoot.extend import Ground, Segment, effect
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.compare import compare_files
from surefoot.scenarios.estimate.file import estimate_file
from surefoot.scenarios.settings import CompareSettings, EstimateSettings
from surefoot.sim.effects.file import save_effects

COURSE = (Segment(5.0, 0.5), Segment(5.0, 0.4, turn=0.5), Segment(4.0, 0.5, turn=-0.4))
HAS = [effect("encoder_offset", "RL_thigh", -0.02), effect("link_length", "FR_calf", 0.006)]
OTHERS = [effect("encoder_offset", "RL_thigh", 0.02)]


@pytest.fixture(scope="module")
def files(tmp_path_factory, log, robot):
    """Folder of the exact robot's walk, that of one with effects, and files of effects."""
    folder = tmp_path_factory.mktemp("with_effects")
    log.write(folder / "exact.parquet")
    course = Scenario("seen", COURSE, Ground(0.8))
    built = walk(course, robot, 4, effects=HAS, declared=False)
    built.write(folder / "built.parquet")
    declaring = replace(built, meta=replace(built.meta, effects=(HAS[0].as_dict(),)))
    declaring.write(folder / "declaring.parquet")
    for name, effects in (("true", HAS), ("others", OTHERS), ("rest", HAS[1:])):
        save_effects(folder / f"{name}.toml", effects)
    return folder


def leg_error(files, log, effects=None):
    """RPE of the leg filter [m]."""
    chosen = files / f"{effects}.toml" if effects else None
    settings = EstimateSettings(files / f"{log}.parquet", "leg", effects=chosen)
    metrics = estimate_file(settings).metrics
    assert metrics is not None
    return metrics.rpe_trans


def test_with_the_true_effects_the_leg_filter_errs_as_on_an_exact_robot(files):
    exact = leg_error(files, "exact")
    assert leg_error(files, "built") > 2.0 * exact
    assert leg_error(files, "built", "true") < 1.1 * exact
    assert leg_error(files, "built", "others") > leg_error(files, "built")
    # Those of the log and of the file together are the model's.
    assert leg_error(files, "declaring", "rest") < 1.1 * exact


def test_every_filter_of_a_comparison_has_them(files, tmp_path):
    logs = (files / "built.parquet",)
    errors = []
    for name in (None, "true"):
        chosen = files / f"{name}.toml" if name else None
        out = tmp_path / str(name)
        table, _ = compare_files(CompareSettings(logs, out, effects=chosen))
        errors.append(table.set_index("filter")["RPE_trans [m]"])
        named = "link_length FR_calf" in (out / "report.html").read_text()
        assert named == (name is not None)
    without, with_them = errors
    assert (with_them[["leg", "leg_slip"]] < 0.5 * without[["leg", "leg_slip"]]).all()
    assert with_them["imu"] == without["imu"]  # it does not use the legs


OF_NO_LEG = """[[effect]]
name = "gyro_scale"
target = "shoulder"
value = 1.0
unit = "ratio"
"""


@pytest.mark.parametrize("command", ["estimate {} --filter leg -o {}.parquet", "compare {} -o {}"])
def test_a_bad_file_is_one_line_and_nothing_is_written(files, tmp_path, command):
    bad, out = written(tmp_path / "bad.toml", OF_NO_LEG), tmp_path / "new"
    line = command.format(files / "built.parquet", out).split()
    refused("bad.toml.*shoulder", main, [*line, "--effects", str(bad)], error=SystemExit)
    assert list(tmp_path.iterdir()) == [bad]


def test_an_effect_is_not_compensated_twice(files):
    declaring = EstimateSettings(files / "declaring.parquet", "leg", effects=files / "true.toml")
    refused("true.toml.*declares encoder_offset of RL_thigh itself", estimate_file, declaring)
