"""Members that users add to a group: found by entry points, refused in one clear line."""

import sys

import pytest
from refusals import refused

from surefoot.sim.common import plugins as plugins_module
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.plugins import Registry, load_plugin, naming_plugins, plugins

GROUP = "surefoot.tests"
WHOLE = "class Mine:\n    label = run = 1\n"


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A function that puts packages with these entry points and this source on the path."""
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins.cache_clear()

    def make(points: str, source: str, name: str = "own") -> None:
        monkeypatch.delitem(sys.modules, f"{name}_thing", raising=False)
        (tmp_path / f"{name}_thing.py").write_text(source)
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[{GROUP}]\n{points}\n")
        plugins.cache_clear()

    yield make
    plugins.cache_clear()


def test_own_members_come_after_the_bundled(package):
    package("mine = own_thing:Mine", "class Mine:\n    label = 'my own'\n")
    assert list(Registry(GROUP, {"theirs": 1})) == ["theirs", "mine"]
    found = dict(Registry(GROUP, {"theirs": 1}, needs=("label",)))
    assert list(found) == ["theirs", "mine"]
    assert found["mine"].label == "my own"


def test_a_broken_member_is_listed_and_stops_only_what_uses_it(package):
    package("mine = own_thing:Mine", "raise RuntimeError('broken')\n")
    registry = Registry(GROUP, {"root": "math:sqrt"})
    assert list(registry) == ["root", "mine"]
    assert "mine" in registry
    assert "magic" not in registry
    assert registry["root"](4.0) == 2.0
    members, broken = registry.usable()
    assert list(members) == ["root"]
    assert broken["mine"].startswith("plugin mine = own_thing:Mine")
    refused("broken", registry.__getitem__, "mine")


@pytest.mark.parametrize(
    ("points", "source", "words"),
    [
        ("mine = own_thing:Mine", "import nowhere_at_all\n", "ModuleNotFoundError"),
        ("mine = own_thing:Mine", "Other = 1\n", "AttributeError"),
        ("mine = own_thing:Mine", "class Mine:\n    pass\n", "lacks label, run"),
        ("mine = own_thing:Mine", f"{WHOLE}It = Mine\nMine = It()\n", "must be a class"),
        ("theirs = own_thing:Mine", WHOLE, "surefoot has one of that name"),
    ],
)
def test_a_bad_member_is_one_line_that_names_it(package, points, source, words):
    package(points, source)
    name = points.partition(" ")[0]
    registry = Registry(GROUP, {"theirs": 1}, needs=("label", "run"))
    refused(f"plugin {name} = own_thing:Mine.*{words}", dict, registry)


def test_one_name_of_two_packages_is_refused(package):
    package("mine = own_thing:Mine", "Mine = 1\n")
    package("mine = other_thing:Mine", "Mine = 2\n", name="other")
    refused("has that name too", dict, Registry(GROUP, {}))


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("import sys; sys.exit(0)", "SystemExit"),
        ("def", "SyntaxError"),
        ("import nowhere_at_all", "ModuleNotFoundError"),
        ("PLUGINS = []", "needs PLUGINS"),
        ("PLUGINS = {'surefoot.effects': 5}", "a dict of classes"),
        ("PLUGINS = {'surefoot.effects': {'a': 5}}", "a must be a class"),
        ("PLUGINS = {'surefoot.effects': {'a': object()}}", "a must be a class"),
        ("PLUGINS = {'surefoot.effects': {3: int}}", "3 is no name"),
        ("PLUGINS = {'surefoot.effects': {'a\\x1b[31m': int}}", "is no name"),
        ("PLUGINS = {7: {'a': int}}", "no group '7'"),
    ],
)
def test_a_file_of_any_wrong_form_is_one_line_that_names_it(tmp_path, text, word):
    (tmp_path / "mine.py").write_text(text)
    assert refused(f"mine.py.*{word}", load_plugin, tmp_path / "mine.py").isprintable()


FAULTS = {
    "raises": ("raise ValueError('no leg')", "failed (ValueError: no leg; faults.py, line 4)"),
    "raises in a library": ("import json; json.loads('{')", "faults.py, line 4"),
    "returns nothing": ("return None", "may have returned something invalid (AttributeError"),
}


@pytest.fixture
def faulty(tmp_path, monkeypatch):
    """A function that makes a gait of a plug-in file whose method does this."""
    monkeypatch.setattr(plugins_module, "_LOADED", {})
    monkeypatch.setattr(plugins_module, "_IN_USE", {})
    monkeypatch.setattr(plugins_module, "_OF_FILES", {})
    monkeypatch.setenv(plugins_module.FILES, "")

    def make(does: str):
        path = tmp_path / "faults.py"
        lines = "class Mine:\n    label = 'mine'\n    def run(self):\n        {}\n"
        path.write_text(f"{lines.format(does)}PLUGINS = {{'surefoot.gaits': {{'mine': Mine}}}}\n")
        load_plugin(path)
        return Registry("surefoot.gaits", {"root": "math:sqrt"})["mine"]()

    yield make
    plugins.cache_clear()


@pytest.mark.parametrize(("does", "words"), FAULTS.values(), ids=FAULTS)
def test_what_a_command_raises_in_a_plugin_or_by_it_names_it(faulty, does, words):
    mine = faulty(does)
    with pytest.raises(SurefootError, match="plugin mine = ") as error, naming_plugins():
        mine.run().started()
    assert words in str(error.value)
    assert "faults.py, line " in str(error.value)


@pytest.mark.parametrize(
    "error", [KeyError("x"), OSError("full"), SystemExit(3), BrokenPipeError()]
)
def test_what_no_plugin_caused_stays_as_it_is(faulty, error):
    with pytest.raises(type(error)), naming_plugins():
        raise error
    faulty("pass")
    if not isinstance(error, KeyError):
        with pytest.raises(type(error)), naming_plugins():
            raise error


def test_what_a_member_raises_while_it_runs_names_it(package):
    """An exit, too, which would end the command as if it were done."""
    source = "class Mine:\n    def run(self):\n        raise SystemExit(0)\n"
    package("mine = own_thing:Mine", source)
    registry = Registry(GROUP, {"root": "math:sqrt"})
    with (
        pytest.raises(SurefootError, match=r"plugin mine = own_thing:Mine.*own_thing.py, line 3"),
        registry.running("mine"),
    ):
        registry["mine"]().run()
    with pytest.raises(ValueError, match="math domain"), registry.running("root"):
        registry["root"](-1.0)
