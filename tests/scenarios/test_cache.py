"""Products are made once for what decides them, and again when any of it changes."""

import json
import os

import pytest
from refusals import refused

from surefoot.scenarios import cache
from surefoot.scenarios.cache import finished_case, product

CODE = "surefoot.sim.common.gravity"
"""Module that makes the products."""


def made(folder, inputs, log):
    def make(path):
        log.append(inputs)
        path.write_text(str(inputs))
        return {"n": len(log)}

    return product(folder, "thing", inputs, CODE, ".txt", make)


def test_a_product_is_made_once_for_its_inputs(tmp_path):
    log = []
    first = made(tmp_path, {"x": 1}, log)
    again = made(tmp_path, {"x": 1}, log)
    other = made(tmp_path, {"x": 2}, log)
    assert first == again
    assert log == [{"x": 1}, {"x": 2}]
    assert other.path != first.path
    assert again.facts == {"n": 1}


def test_a_product_of_other_code_is_another(tmp_path, monkeypatch):
    log = []
    first = made(tmp_path, {}, log)
    monkeypatch.setattr(cache, "sources_digest", lambda module: f"other code of {module}")
    assert made(tmp_path, {}, log).path != first.path
    assert len(log) == 2


def test_a_file_that_a_kill_left_without_its_card_is_made_again(tmp_path):
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
def test_a_product_that_was_changed_is_made_again(how, tmp_path, capsys):
    log = []
    path = made(tmp_path, {}, log).path
    CHANGED[how](path)
    assert made(tmp_path, {}, log).path.read_text() == "{}"
    assert len(log) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert path.name in said
    assert "made again" in said


@pytest.mark.parametrize("text", ["[" * 100_000, "7", '{"row": {"a": 2}, "sha256": "0"}', ""])
def test_a_row_that_was_changed_is_made_again(text, tmp_path, capsys):
    def row():
        return finished_case(tmp_path, "case", {}, CODE, lambda: {"a": 1})

    assert row() == {"a": 1}
    path = tmp_path / "case.json"
    values = json.loads(path.read_text())
    path.write_text(json.dumps(values | json.loads(text)) if text.startswith("{") else text)
    assert row() == {"a": 1}
    (said,) = capsys.readouterr().err.splitlines()
    assert "case.json" in said


@pytest.mark.parametrize("plant", [os.mkfifo, os.mkdir, lambda path: path.symlink_to("x")])
def test_a_row_that_is_no_file_is_refused(plant, tmp_path):
    plant(tmp_path / "case.json")
    said = r"case\.json: is a link or no regular file"
    refused(said, finished_case, tmp_path, "case", {}, CODE, dict)


def test_equal_contents_have_equal_digests_whatever_made_them(tmp_path):
    same = lambda path: path.write_text("the same bits") and {}  # noqa: E731
    one = product(tmp_path, "thing", {"x": 1}, CODE, ".txt", same)
    two = product(tmp_path, "thing", {"x": 2}, "surefoot.sim.common.errors", ".txt", same)
    assert one.digest == two.digest
