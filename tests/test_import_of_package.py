"""Importing the package: under which names its modules go, and how little they bring along."""

from importlib.resources import files
from pathlib import Path

import pytest
from processes import printed

ROOMS = ("sim", "estimator", "models", "scenarios")
HEAVY = ("torch", "rerun", "matplotlib", "mujoco", "pandas", "numba", "numpy")
HOUSE = Path(str(files("surefoot")))


def _module(path: Path) -> str:
    parts = path.relative_to(HOUSE.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


# The rooms are links in a checkout, folders in an installation.
MODULES = [
    _module(path)
    for room in ROOMS
    for path in sorted((HOUSE / room).glob("**/*.py"))
    if path.stem != "__main__"
]


@pytest.fixture
def elsewhere(tmp_path) -> Path:
    """A folder with a user's own modules, named as our rooms are."""
    for room in ROOMS:
        (tmp_path / f"{room}.py").write_text(f"raise SystemExit('the {room}.py of a user ran')")
    return tmp_path


def test_no_module_goes_by_a_bare_name(elsewhere):
    """Not even where all are imported: numba keeps compiled code under the name of its module."""
    code = (
        "import importlib, sys\n"
        f"for name in {MODULES!r}:\n"
        "    importlib.import_module(name)\n"
        f"print([room for room in {ROOMS!r} if room in sys.modules])"
    )
    assert len(MODULES) > 200
    assert printed("-c", code, cwd=elsewhere).strip() == "[]"


def test_modules_of_a_user_do_not_shadow_the_rooms(elsewhere):
    assert "simulate" in printed("-m", "surefoot", "--help", cwd=elsewhere)


@pytest.mark.parametrize(
    ("what", "heavy"),
    [
        ("import surefoot", HEAVY),
        ("import surefoot.scenarios.cli.main", HEAVY),
        ("from surefoot import Robot; Robot.load('spot_class')", HEAVY[:3]),
        ("from surefoot import Scenario, walk; Scenario.load('demo/walk')", HEAVY[:3]),
        ("from surefoot.scenarios.cli.main import main; main(['robots'])", HEAVY[:3]),
    ],
)
def test_nothing_heavy_is_imported_before_it_is_needed(tmp_path, what, heavy):
    code = f"{what}\nimport sys\nprint([name for name in {heavy!r} if name in sys.modules])"
    assert printed("-c", code, cwd=tmp_path).splitlines()[-1] == "[]"
