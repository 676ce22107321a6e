"""`surefoot view` of what has no recording yet: a course, and a log."""

import pytest
from rerun.chunk import RrdReader

from surefoot.scenarios.cli.main import main


def entities(path) -> set[str]:
    return {str(chunk.entity_path) for chunk in RrdReader(path).stream().to_chunks()}


def explanation(path) -> str:
    """The text of the page that opens first."""
    chunks = RrdReader(path).stream().to_chunks()
    (about,) = [chunk for chunk in chunks if str(chunk.entity_path) == "/about"]
    return str(about.to_record_batch().to_pydict())


def test_a_course_is_shown_on_its_ground_before_it_is_walked(tmp_path, capsys):
    main(["view", "demo/walk", "-o", str(tmp_path / "course.rrd")])
    assert "course.rrd" in capsys.readouterr().out
    found = entities(tmp_path / "course.rrd")
    assert {"/world/truth/path", "/world/ground/patch_0", "/world/robot"} <= found
    text = explanation(tmp_path / "course.rrd")
    assert "**Ground**" in text
    assert not any(absent in text for absent in ("Dots", "observer", "**Feet**"))


def test_a_log_is_shown_as_it_is(log, tmp_path):
    log.rows(slice(0, 1000)).write(tmp_path / "log.parquet")
    main(["view", str(tmp_path / "log.parquet"), "-o", str(tmp_path / "log.rrd")])
    assert {"/world/truth/path", "/feet/contact/FL"} <= entities(tmp_path / "log.rrd")
    text = explanation(tmp_path / "log.rrd")
    assert all(shown in text for shown in ("**Dots on the ground**", "**Feet**"))
    assert "observer" not in text


def test_what_is_neither_is_one_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for line, message in (("view nowhere", "view opens"), ("view no.toml", "No such file")):
        with pytest.raises(SystemExit, match=message):
            main(line.split())
