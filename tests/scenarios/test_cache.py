"""Products are made once for what decides them, and again when any of it changes."""

import pytest

from surefoot.scenarios.experiments import cache
from surefoot.scenarios.experiments.cache import code_digest, imported_modules, product


@pytest.fixture
def rooms(tmp_path, monkeypatch):
    """A tree of modules in which sim.a imports sim.b, and sim.c nobody."""
    (tmp_path / "sim").mkdir()
    for name, text in {"a": "from sim import b\nimport numpy\n", "b": "x = 1\n", "c": ""}.items():
        (tmp_path / "sim" / f"{name}.py").write_text(text)
    monkeypatch.setattr(cache, "ROOT", tmp_path)
    code_digest.cache_clear()
    yield tmp_path / "sim"
    code_digest.cache_clear()


def made(folder, inputs, log):
    def make(path):
        log.append(inputs)
        path.write_text(str(inputs))
        return {"n": len(log)}

    return product(folder, "thing", inputs, "sim.a", ".txt", make)


def test_a_product_is_made_once_for_its_inputs(tmp_path, rooms):
    log = []
    first = made(tmp_path, {"x": 1}, log)
    again = made(tmp_path, {"x": 1}, log)
    other = made(tmp_path, {"x": 2}, log)
    assert first == again
    assert log == [{"x": 1}, {"x": 2}]
    assert other.path != first.path
    assert again.facts == {"n": 1}


def test_what_a_module_imports_decides_too_and_nothing_else_does(tmp_path, rooms):
    log = []
    made(tmp_path, {}, log)
    for name, remade in (("c", False), ("b", True), ("a", True)):
        (rooms / f"{name}.py").write_text((rooms / f"{name}.py").read_text() + "# edited\n")
        code_digest.cache_clear()
        before = len(log)
        made(tmp_path, {}, log)
        assert (len(log) > before) == remade, name


def test_a_file_that_a_kill_left_without_its_card_is_made_again(tmp_path, rooms):
    log = []
    first = made(tmp_path, {}, log)
    first.path.with_suffix(".json").unlink()
    assert made(tmp_path, {}, log).digest == first.digest
    assert len(log) == 2
    first.path.with_suffix(".json").write_text("{")
    made(tmp_path, {}, log)
    assert len(log) == 3


def test_equal_contents_have_equal_digests_whatever_made_them(tmp_path, rooms):
    same = lambda path: path.write_text("the same bits") and {}  # noqa: E731
    one = product(tmp_path, "thing", {"x": 1}, "sim.a", ".txt", same)
    two = product(tmp_path, "thing", {"x": 2}, "sim.b", ".txt", same)
    assert one.digest == two.digest


def test_a_walk_depends_on_the_world_and_not_on_what_is_learnt_from_it():
    modules = set(imported_modules("surefoot.sim.walking.batch"))
    assert {
        "surefoot.sim.walk",
        "surefoot.sim.ground.tiles",
        "surefoot.sim.gait.controller",
        "surefoot.sim.sensors.streams",
    } <= modules
    assert not any(name.startswith(("models", "estimator", "scenarios")) for name in modules)
