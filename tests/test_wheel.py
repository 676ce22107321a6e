"""What users install: made from a clean export, whole, and run outside the repository."""

import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from collections import Counter
from importlib.resources import files
from pathlib import Path, PurePosixPath

import pytest

CHECKOUT = Path(str(files("surefoot"))).resolve().parent
ROOMS = ("sim", "estimator", "models", "scenarios")

pytestmark = pytest.mark.skipif(
    not (CHECKOUT / ".git").exists(), reason="not a git checkout: nothing to export"
)


def _run(command: list, folder: Path) -> str:
    """What the command prints."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    run = subprocess.run(
        [str(part) for part in command],
        cwd=folder,
        env=kept,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def _build(what: str, source: Path, out: Path) -> Path:
    code = f"from setuptools.build_meta import {what} as b; print(b({str(out)!r}))"
    return out / _run([sys.executable, "-c", code], source).split()[-1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("wheel")


@pytest.fixture(scope="module")
def sdist(folder) -> Path:
    """Of a clean export: a build folder left in a checkout puts deleted modules into a wheel."""
    export = folder / "export.tar"
    _run(["git", "archive", "--output", export, "HEAD"], CHECKOUT)
    with tarfile.open(export) as archive:
        archive.extractall(folder / "export", filter="data")
    return _build("build_sdist", folder / "export", folder)


@pytest.fixture(scope="module")
def wheel(folder, sdist) -> Path:
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "sdist", filter="data")
    (source,) = (folder / "sdist").iterdir()
    return _build("build_wheel", source, folder)


@pytest.fixture(scope="module")
def python(folder, wheel) -> Path:
    """Of a virtual environment with the wheel, which sees this one's packages but not its own
    surefoot: a path in a .pth file is searched last, and its .pth files are not read."""
    venv.create(folder / "venv", with_pip=False)
    found = folder / "venv" / "bin" / "python"
    packages = Path(
        _run(
            [found, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], folder
        ).strip()
    )
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    pip = [sys.executable, "-m", "pip", "--python", found]
    _run([*pip, "install", "--quiet", "--no-index", "--no-deps", wheel], folder)
    return found


def _tracked() -> list[str]:
    names = _run(["git", "ls-tree", "-r", "--name-only", "HEAD", *ROOMS], CHECKOUT).split()
    return [f"surefoot/{name}" for name in names]


def test_sdist_holds_every_file_of_a_room_once(sdist):
    with tarfile.open(sdist) as archive:
        members = [PurePosixPath(m.name) for m in archive if not m.isdir()]
    count = Counter("/".join(member.parts[1:]) for member in members)
    assert {name: count[name] for name in _tracked()} == dict.fromkeys(_tracked(), 1)
    assert not {name.partition("/")[0] for name in count} & set(ROOMS)


def test_wheel_holds_every_file_of_a_room_once_and_no_other(wheel):
    with zipfile.ZipFile(wheel) as archive:
        count = Counter(archive.namelist())
    ours = {name: n for name, n in count.items() if ".dist-info/" not in name}
    package = [f"surefoot/{path.name}" for path in (CHECKOUT / "surefoot").glob("*.py")]
    assert ours == dict.fromkeys([*package, *_tracked()], 1)


def test_installed_wheel_brings_its_data(python, folder):
    code = """
from importlib.metadata import version
import surefoot
import surefoot.sim.log
from surefoot.scenarios.experiments.file import Experiment
from surefoot.sim.robot.catalog import known_robots
from surefoot.sim.scenario_catalog import bundled_scenarios
assert version("surefoot") == surefoot.__version__
assert {"spot_class", "v60_class"} <= set(known_robots())
for name in bundled_scenarios():
    surefoot.Scenario.load(name)
for name in ("spot", "vision60"):
    Experiment.load(name)
print(surefoot.sim.log.__file__)
"""
    assert _run([python, "-c", code], folder).startswith(str(folder))
    assert "simulate" in _run([python.parent / "surefoot", "--help"], folder)
