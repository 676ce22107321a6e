"""The forms of a new effect, an own estimator and an own filter, filled in and used."""

import os
import tomllib

import pandas as pd
import pytest
from own_package import found
from processes import printed, python
from refusals import refused
from synthetic import without
from warming import GyroWarming

from studies.blind.outside_effects import ThermalGyroDrift
from surefoot import Robot, Scenario, walk
from surefoot.extend import AXES, Effect, Ground, Segment
from surefoot.models.attribution.diagnose import diagnose
from surefoot.scenarios.cli.main import main
from surefoot.sim.effects import CATALOGUE, add

ROBOT = Robot.load("spot_class")


SIZE = 0.015  # rad/s


@pytest.fixture(scope="module")
def warmed():
    course = (Segment(10.0, 0.6, turn=0.3), Segment(10.0, 0.5, turn=-0.4), Segment(10.0, 0.6))
    warm = [ThermalGyroDrift("y", SIZE)]
    walked = walk(Scenario("warm", course, Ground(0.8)), ROBOT, 5, warm, declared=False)
    return without(walked, "q_", "dq_", "tau_", "contact_", "slip_", "mu_")


def test_the_form_that_is_left_becomes_an_effect(warmed, catalogue):
    before = diagnose([warmed], ROBOT)
    assert before.verdict == "none_of_these"
    form = before.unexplained[0]
    assert (form.channel, form.column) == ("imu_gyro", "gyro_y")
    assert form.regressors[0] in {"settling_8_s", "settling_16_s", "settling_32_s"}

    add(GyroWarming)
    after = diagnose([warmed], ROBOT)
    assert after.verdict == "attributed"
    assert [(e.name, e.target) for e in after.effects] == [("gyro_warming", "y")]
    assert after.effects[0].value == pytest.approx(SIZE, rel=0.1)
    level = after.channels["imu_gyro"]
    assert level.noise_floor is not None
    assert level.after < 1.1 * level.noise_floor < 0.2 * level.before


def test_a_class_that_says_too_little_or_takes_a_name_is_not_added(catalogue):
    class Unbounded(Effect):
        unit = "m"
        targets = AXES

    refused("Unbounded: lacks bounds", add, Unbounded)
    refused("GyroWarming: must be a class, is GyroWarming", add, GyroWarming("x", 0.01))

    class Taken(GyroWarming):
        name = "gyro_bias"

    refused("gyro_bias: the catalogue has one of that name", add, Taken)
    assert not any(k.__qualname__.endswith(("Unbounded", "Taken")) for k in CATALOGUE.values())


ADDED = """
from surefoot.scenarios.stages import processes, stage
from surefoot.sim.effects import add, effect
from surefoot.sim.effects.imu import GyroBias


@add
class Own(GyroBias):
    name = "own"


def known(_):
    return effect("own", "x", 0.1).name


if __name__ == "__main__":
    with processes(2) as pool:
        print(stage(pool, "", {1: (known, 1)}))
"""


def test_an_effect_that_a_script_adds_is_known_to_processes_that_it_spawns(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(ADDED)
    assert printed(script).strip() == "{1: 'own'}"


@pytest.fixture(scope="module")
def file(log, tmp_path_factory):
    path = tmp_path_factory.mktemp("walk") / "walk.parquet"
    log.rows(slice(0, 3500)).write(path)
    return path


def test_an_own_estimator_is_tabled_and_drawn(file, tmp_path):
    out = tmp_path / "out"
    with found("own_estimator"):
        main(f"compare {file} -o {out}".split())
    table = pd.read_csv(out / "table.csv")
    assert list(table["filter"]) == ["leg", "leg_slip", "imu", "standing_feet"]
    errors = dict(zip(table["filter"], table["APE_trans [m]"], strict=True))
    assert errors["standing_feet"] < errors["imu"]
    assert "Mean velocity of the standing feet" in (out / "report.html").read_text()


@pytest.fixture
def folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main("new estimator two_feet".split())
    assert "two_feet/test_two_feet.py" in capsys.readouterr().out
    return tmp_path / "two_feet"


def run(folder, *arguments: str):
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    return python(*arguments, cwd=folder, env={"PYTHONPATH": path})


@pytest.mark.long
def test_its_own_test_passes_and_fails_for_a_wrong_sign(folder):
    pytest_ = ("-m", "pytest", "-q", "-p", "no:cacheprovider")
    passed = run(folder, *pytest_)
    assert passed.returncode == 0, passed.stdout
    module = folder / "two_feet.py"
    module.write_text(module.read_text().replace("return -moving", "return moving"))
    assert "failed" in run(folder, *pytest_).stdout


@pytest.mark.long
def test_it_runs_as_a_plugin_and_its_package_offers_the_same(log, folder):
    log.write(folder / "log.parquet")
    line = ("-m", "surefoot", "estimate", "log.parquet", "--filter", "two_feet")
    ran = run(folder, *line, "--plugin", "two_feet.py")
    assert "APE_trans" in ran.stdout, ran.stderr
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["surefoot.estimators"] == {"two_feet": "two_feet:TwoFeet"}
    assert "class TwoFeet" in (folder / "two_feet.py").read_text()


@pytest.mark.parametrize("name", ["leg", "Big", "class", "../up", "a-b"])
def test_a_name_that_will_not_do_is_one_line(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match=r"already|module's name"):
        main(["new", "estimator", name])
    assert not list(tmp_path.iterdir())
