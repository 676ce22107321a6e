"""`surefoot new estimator`: what it writes passes its own test and runs beside the others."""

import os
import tomllib

import pytest
from processes import python

from surefoot.scenarios.cli.main import main
from surefoot.scenarios.estimate.contract import Estimator


@pytest.fixture
def folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main("new estimator two_feet".split())
    assert "two_feet/test_two_feet.py" in capsys.readouterr().out
    return tmp_path / "two_feet"


def run(folder, *arguments: str):
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    return python(*arguments, cwd=folder, env={"PYTHONPATH": path})


def test_its_own_test_passes_and_fails_for_a_wrong_sign(folder):
    pytest_ = ("-m", "pytest", "-q", "-p", "no:cacheprovider")
    passed = run(folder, *pytest_)
    assert passed.returncode == 0, passed.stdout
    module = folder / "two_feet.py"
    module.write_text(module.read_text().replace("return -moving", "return moving"))
    assert "failed" in run(folder, *pytest_).stdout


def test_it_runs_as_a_plugin_and_its_package_offers_the_same(log, folder):
    log.write(folder / "log.parquet")
    line = ("-m", "surefoot", "estimate", "log.parquet", "--filter", "two_feet")
    ran = run(folder, *line, "--plugin", "two_feet.py")
    assert "APE_trans" in ran.stdout, ran.stderr
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    ((name, place),) = project["entry-points"]["surefoot.estimators"].items()
    module, _, kind = place.partition(":")
    assert (folder / f"{module}.py").is_file()
    assert f'name = "{name}"' in (folder / f"{module}.py").read_text()
    assert f"class {kind}" in (folder / f"{module}.py").read_text()


@pytest.mark.parametrize("name", ["leg", "Big", "class", "../up", "a-b"])
def test_a_name_that_will_not_do_is_one_line(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match=r"already|module's name"):
        main(["new", "estimator", name])
    assert not list(tmp_path.iterdir())


def test_the_contract_is_what_the_skeleton_has(folder):
    text = (folder / "two_feet.py").read_text()
    assert all(f"{name} " in text or f"def {name}" in text for name in Estimator.__annotations__)
