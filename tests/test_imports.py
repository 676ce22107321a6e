"""How the house is wired: which module imports which, under what names, and how quickly."""

import ast
import os
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from importlib.resources import files
from pathlib import Path

import pytest

ROOMS = ("sim", "estimator", "models", "scenarios")
MAY_IMPORT = {
    "sim": {"sim"},
    "estimator": {"estimator", "sim"},
    "models": {"models", "estimator", "sim"},
    "scenarios": set(ROOMS),
}
HEAVY = ("torch", "rerun", "matplotlib", "mujoco", "pandas", "numba", "numpy")
HOUSE = Path(str(files("surefoot")))


def _module(path: Path) -> str:
    parts = path.relative_to(HOUSE.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


SOURCES = {
    _module(path): path
    for room in ROOMS
    # The rooms are links in a checkout, folders in an installation.
    for path in sorted((HOUSE / room).glob("**/*.py"))
}


def _imports(path: Path) -> set[str]:
    """Modules of surefoot that a source imports, inside functions too, but for type checkers."""
    found: set[str] = set()
    waiting: list[ast.AST] = [ast.parse(path.read_bytes())]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            waiting += node.orelse
            continue
        waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            members = {f"{node.module}.{alias.name}" for alias in node.names}
            modules = members & set(SOURCES)
            # `from package import module` needs the module, not what else the package exports.
            found |= modules if modules == members else {node.module, *modules}
    return found & set(SOURCES)


def test_no_module_imports_itself_in_a_circle():
    assert len(SOURCES) > 200
    try:
        TopologicalSorter({name: _imports(path) for name, path in SOURCES.items()}).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_the_rooms_below_it(room):
    for name, path in SOURCES.items():
        if name.split(".")[1] == room:
            used = {imported.split(".")[1] for imported in _imports(path)}
            assert used <= MAY_IMPORT[room], name


def _run(code: str, folder: Path, **environment: str) -> str:
    run = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=dict(os.environ, **environment),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


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
        f"for name in {[name for name in SOURCES if not name.endswith('__main__')]!r}:\n"
        "    importlib.import_module(name)\n"
        f"print([room for room in {ROOMS!r} if room in sys.modules])"
    )
    assert _run(code, elsewhere).strip() == "[]"


def test_modules_of_a_user_do_not_shadow_the_rooms(elsewhere):
    run = subprocess.run(
        [sys.executable, "-m", "surefoot", "--help"],
        cwd=elsewhere,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert run.returncode == 0, run.stderr
    assert "simulate" in run.stdout


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
    assert _run(code, tmp_path).splitlines()[-1] == "[]"
