"""What a module is made of: every source that it imports in turn, however it imports it."""

import shutil
from importlib.machinery import EXTENSION_SUFFIXES

import pytest
from processes import printed
from written import written

from surefoot.sim.common import sources
from surefoot.sim.common.sources import code_digest, imported_sources, sources_digest

FILES = {
    "named": "from a import Registry\nR = Registry('g', {'one': 'house.alone:z'}, note='x: y')\n",
    "unnamed": "HOMES = {'one': 'house.alone:z'}\n",
    "__init__": "",
    "start": "import numpy\nfrom house import plain\nfrom . import beside\nfrom .room import one\n",
    "plain": "def late():\n    import house.inside\n",
    "inside": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import house.alone\n",
    "beside": "y = 2\n",
    "alone": "z = 3\n",
    "room/__init__": "from house.room.front import front\n",
    "room/front": "front = 1\n",
    "room/one": "from ..deep import two\n",
    "deep/__init__": "",
    "deep/two": "",
}

UNUSED = ("alone", "named", "unnamed")


def write(folder, texts):
    """Sources by name, without their suffix, in a folder."""
    for name, text in texts.items():
        path = folder / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def forget():
    for kept in (sources_digest, sources._contents, sources._folders, sources._source):
        kept.cache_clear()


def digest(name="house.start"):
    forget()
    return sources_digest(name)


@pytest.fixture
def house(tmp_path, monkeypatch):
    """A package whose module `start` imports all of it but `alone`."""
    write(tmp_path / "house", FILES)
    monkeypatch.syspath_prepend(str(tmp_path))
    forget()
    yield tmp_path / "house"
    forget()


def test_every_way_to_import_counts(house):
    expected = {
        "house",
        *(f"house.{m}" for m in ("start", "plain", "inside", "beside")),
        *(f"house.{m}" for m in ("room", "room.front", "room.one", "deep", "deep.two")),
    }
    assert set(imported_sources("house.start")) == expected


@pytest.mark.parametrize("name", [n for n in FILES if n not in UNUSED])
def test_an_edit_of_any_of_them_changes_the_digest(house, name):
    before, path = digest(), house / f"{name}.py"
    path.write_text(path.read_text() + "edited = 1\n")
    assert digest() != before


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("x = 1\n", '"""What x is."""\n\n# one\nx = 1\n', True),
        (
            'class A:\n    x: int\n    """m"""\n',
            'class A:\n    x: int\n    """A\n\n    # foot."""\n',
            True,
        ),
        ('x = """a\n# b\n"""\n', 'x = """a\n# c\n"""\n', False),
        ('"""a"""; x = 1\n', '"""a"""; x = 2\n', False),
        ('def f():\n    """a"""\n', "def f():\n    return 1\n", False),
        ("if y:\n    x = 1\n", "if y:\n  x = 1\n", False),
    ],
)
def test_docstrings_and_lines_of_comment_may_change(house, one, other, same):
    digests = set()
    for text in (one, other):
        (house / "start.py").write_text(text)
        digests.add(digest())
    assert (len(digests) == 1) is same


@pytest.mark.parametrize("name", ["table.toml", "data/gains.csv"])
def test_a_data_file_that_a_module_names_counts(house, name):
    path = house / "room" / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("x = 1")
    (house / "room" / "unnamed.toml").write_text("x = 1")
    (house / "room" / "one.py").write_text(f"from pathlib import Path\nT = Path({name!r})\n")
    before = digest()
    found = imported_sources("house.start")
    assert {one: path for one, path in found.items() if "/" in one} == {f"house.room/{name}": path}
    path.write_text("x = 2")
    assert digest() != before


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("surefoot.scenarios.estimate.settings", "surefoot.scenarios.estimate/tuned.toml"),
        ("surefoot.sim.importing.guessing.names", "surefoot.sim.importing.guessing/words.toml"),
    ],
)
def test_the_data_files_of_the_package_count(module, name):
    assert name in imported_sources(module)


def test_what_a_registry_names_counts(house):
    assert set(imported_sources("house.named")) == {"house", "house.named", "house.alone"}
    assert set(imported_sources("house.unnamed")) == {"house.unnamed"}


def test_a_script_counts_by_itself_and_its_files_do_not(tmp_path):
    (tmp_path / "walk.csv").write_text("t\n")
    script = tmp_path / "script.py"
    script.write_text("from surefoot.sim.common import errors\nNAME = 'walk.csv'\n")
    found = imported_sources("__main__", str(script))
    assert found["__main__"] == script
    assert "surefoot.sim.common.errors" in found
    assert not [name for name in found if name.endswith("walk.csv")]


def test_a_package_without_an_init_counts(house, tmp_path):
    write(tmp_path, {"loose/first": "from loose import second\n", "loose/second": "x = 1\n"})
    assert set(imported_sources("loose.first")) == {"loose.first", "loose.second"}


def test_other_packages_of_a_user_count_and_installed_ones_do_not(house, tmp_path, monkeypatch):
    write(tmp_path, {"mine": "import helper, taken\n", "helper": "x = 1\n"})
    write(tmp_path / "site-packages", {"taken": "x = 1\n"})
    monkeypatch.syspath_prepend(str(tmp_path / "site-packages"))
    assert set(imported_sources("mine")) == {"mine", "helper"}


def test_compiled_modules_count(house, tmp_path):
    write(tmp_path, {"fast/start": "from fast import core\n"})
    core = written(tmp_path / "fast" / f"core{EXTENSION_SUFFIXES[0]}", b"\x7fELF 1")
    before = digest("fast.start")
    assert set(imported_sources("fast.start")) == {"fast.start", "fast.core"}
    core.write_bytes(b"\x7fELF 2")
    assert digest("fast.start") != before


def test_a_module_without_a_source_has_another_digest_in_each_process():
    assert digest("nowhere.at_all") != digest("nowhere.at_all")


@pytest.mark.parametrize(
    ("start", "added"),
    [
        ("from late import One\n", {"late.one"}),
        ("import late\n", {"late.one", "late.two"}),
        ("from late import *\n", {"late.one", "late.two"}),
    ],
)
def test_what_a_package_imports_when_it_is_asked_counts(house, tmp_path, start, added):
    homes = (
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n    from late.one import A as One\n    from late.two import Two\n"
        "def __getattr__(name): ...\n"
    )
    write(tmp_path, {"late/__init__": homes, "late/one": "", "late/two": "", "asking": start})
    assert set(imported_sources("asking")) == {"asking", "late", *added}


def test_the_code_of_several_classes_is_that_of_their_modules(house, monkeypatch):
    kinds = [type(name, (), {"__module__": f"house.{name}"}) for name in ("plain", "beside")]
    before = code_digest(*kinds)
    assert code_digest(*reversed(kinds)) == before != code_digest(kinds[0])
    (house / "beside.py").write_text("y = 3\n")
    forget()
    assert code_digest(*kinds) != before


CALLER = """
from surefoot.sim.common.kernels import kernel
from yard.called import value

@kernel
def twice():
    return 2 * value()

print(twice(), len(twice.stats.cache_hits))
"""
CALLED = """
from surefoot.sim.common.kernels import kernel

@kernel
def value():
    return {number}
"""


def test_a_kernel_follows_the_kernels_that_it_calls(tmp_path):
    """Loaded from the cache when nothing changed, also elsewhere; compiled anew when a called one
    did.
    """
    package = tmp_path / "yard"
    write(package, {"__init__": "", "caller": CALLER})

    def run(folder=tmp_path):
        places = {"PYTHONPATH": str(folder), "SUREFOOT_CACHE": str(tmp_path / "cache")}
        return printed("-c", "import yard.caller", env=places).split()

    (package / "called.py").write_text(CALLED.format(number=1))
    assert run() == ["2", "0"]
    assert run() == ["2", "1"]
    (package / "called.py").write_text(CALLED.format(number=5))
    assert run() == ["10", "0"]
    shutil.copytree(package, tmp_path / "other" / "yard", copy_function=shutil.copy)
    assert run(tmp_path / "other") == ["10", "1"]
    assert not list(package.glob("__pycache__/*.nb?"))


def test_what_surefoot_offers_is_followed_to_its_home(tmp_path):
    text = "from surefoot import trace\nfrom surefoot.extend import Calibrator\n"
    asking = written(tmp_path / "asking.py", text)
    found = imported_sources("asking", str(asking))
    assert {"surefoot.scenarios.trace.run", "surefoot.models.calibration.regions"} <= set(found)


def test_of_a_public_module_only_what_is_requested_counts(tmp_path):
    text = "from surefoot.scenarios.reporting import to_csv\n"
    asking = written(tmp_path / "asking.py", text)
    found = imported_sources("asking", str(asking))
    assert "surefoot.scenarios.reporting.tables" in found
    assert "surefoot.scenarios.reporting.pages" not in found
