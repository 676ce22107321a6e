"""Products are made once for what decides them, and again when any of it changes."""

import json
import os

import pytest
from refusals import refused

from surefoot.scenarios.cache import finished_case, product
from surefoot.sim.common import sources
from surefoot.sim.common.sources import sources_digest


@pytest.fixture
def house(tmp_path, monkeypatch):
    """A package in which `house.a` imports `house.b`, and nobody `house.c`."""
    (tmp_path / "house").mkdir()
    texts = {"__init__": "", "a": "from house import b\nimport numpy\n", "b": "x = 1\n", "c": ""}
    for name, text in texts.items():
        (tmp_path / "house" / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    forget()
    yield tmp_path / "house"
    forget()


def forget():
    for one in (sources_digest, sources._contents, sources._folders, sources._source):
        one.cache_clear()


def made(folder, inputs, log):
    def make(path):
        log.append(inputs)
        path.write_text(str(inputs))
        return {"n": len(log)}

    return product(folder, "thing", inputs, "house.a", ".txt", make)


def test_a_product_is_made_once_for_its_inputs(tmp_path, house):
    log = []
    first = made(tmp_path, {"x": 1}, log)
    again = made(tmp_path, {"x": 1}, log)
    other = made(tmp_path, {"x": 2}, log)
    assert first == again
    assert log == [{"x": 1}, {"x": 2}]
    assert other.path != first.path
    assert again.facts == {"n": 1}


def test_what_a_module_imports_decides_too_and_nothing_else_does(tmp_path, house):
    log = []
    made(tmp_path, {}, log)
    for name, remade in (("c", False), ("b", True), ("a", True)):
        (house / f"{name}.py").write_text((house / f"{name}.py").read_text() + "edited = 1\n")
        forget()
        before = len(log)
        made(tmp_path, {}, log)
        assert (len(log) > before) == remade, name


def test_a_file_that_a_kill_left_without_its_card_is_made_again(tmp_path, house):
    log = []
    first = made(tmp_path, {}, log)
    first.path.with_suffix(".json").unlink()
    assert made(tmp_path, {}, log).digest == first.digest
    assert len(log) == 2
    first.path.with_suffix(".json").write_text("{")
    made(tmp_path, {}, log)
    assert len(log) == 3


CHANGED = {
    "empty": lambda path: path.write_text(""),
    "a link": lambda path: (path.rename(path.with_name("other")), path.symlink_to("other")),
    "a pipe": lambda path: (path.unlink(), os.mkfifo(path)),
}


@pytest.mark.parametrize("how", CHANGED)
def test_a_product_that_was_changed_is_made_again(how, tmp_path, house, capsys):
    log = []
    path = made(tmp_path, {}, log).path
    CHANGED[how](path)
    assert made(tmp_path, {}, log).path.read_text() == "{}"
    assert len(log) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert path.name in said
    assert "made again" in said


@pytest.mark.parametrize("text", ["[" * 100_000, "7", '{"row": {"a": 2}, "sha256": "0"}', ""])
def test_a_row_that_was_changed_is_made_again(text, tmp_path, house, capsys):
    def row():
        return finished_case(tmp_path, "case", {}, "house.a", lambda: {"a": 1})

    assert row() == {"a": 1}
    path = tmp_path / "case.json"
    values = json.loads(path.read_text())
    path.write_text(json.dumps(values | json.loads(text)) if text.startswith("{") else text)
    assert row() == {"a": 1}
    (said,) = capsys.readouterr().err.splitlines()
    assert "case.json" in said


@pytest.mark.parametrize("plant", [os.mkfifo, os.mkdir, lambda path: path.symlink_to("x")])
def test_a_row_that_is_no_file_is_refused(plant, tmp_path, house):
    plant(tmp_path / "case.json")
    said = r"case\.json: is a link or no regular file"
    refused(said, finished_case, tmp_path, "case", {}, "house.a", dict)


def test_equal_contents_have_equal_digests_whatever_made_them(tmp_path, house):
    same = lambda path: path.write_text("the same bits") and {}  # noqa: E731
    one = product(tmp_path, "thing", {"x": 1}, "house.a", ".txt", same)
    two = product(tmp_path, "thing", {"x": 2}, "house.b", ".txt", same)
    assert one.digest == two.digest
