"""What is shown: previews of courses and logs, and recordings in the viewer."""

import subprocess

import pytest
from refusals import refused
from rerun.chunk import RrdReader
from written import written

from surefoot.scenarios.cli.main import main
from surefoot.scenarios.viewer.view import view
from surefoot.sim.common.files import command_run, whole_file


def shown_in(path) -> tuple[set[str], str]:
    """Entities of a recording, and the text of the page that opens first."""
    chunks = {str(one.entity_path): one for one in RrdReader(path).stream().to_chunks()}
    return set(chunks), str(chunks["/about"].to_record_batch().to_pydict())


def test_a_course_is_shown_on_its_ground_before_it_is_walked(tmp_path):
    main(["view", "demo/walk", "-o", str(tmp_path / "course.rrd")])
    found, text = shown_in(tmp_path / "course.rrd")
    assert {"/world/truth/path", "/world/ground/patch_0", "/world/robot"} <= found
    assert "**Ground**" in text
    assert not any(absent in text for absent in ("Dots", "observer", "**Feet**"))


def test_a_log_is_shown_as_it_is(log, tmp_path):
    log.rows(slice(0, 1000)).write(tmp_path / "log.parquet")
    main(["view", str(tmp_path / "log.parquet"), "-o", str(tmp_path / "log.rrd")])
    found, text = shown_in(tmp_path / "log.rrd")
    assert {"/world/truth/path", "/feet/contact/FL"} <= found
    assert all(shown in text for shown in ("**Dots on the ground**", "**Feet**"))
    assert "observer" not in text


@pytest.mark.parametrize("web", [False, True])
def test_the_server_listens_on_this_machine_alone(tmp_path, monkeypatch, web):
    path = written(tmp_path / "walk.rrd", b"RRF2....")
    commands = []

    def run(command, check):
        commands.append(command)
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(subprocess, "run", run)
    view(path, web=web)
    (command,) = commands
    assert command[command.index("--bind") + 1] == "127.0.0.1"
    assert ("--web-viewer" in command) == web
    assert command[-1] == str(path)


def test_a_recording_that_was_altered_is_not_shown(tmp_path, monkeypatch):
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: pytest.fail("it is shown"))
    path = tmp_path / "walk.rrd"
    with command_run("trace", ()), whole_file(path) as temporary:
        temporary.write_bytes(b"RRF2....")
    path.write_bytes(b"RRF2...,")
    refused("was changed or damaged", view, path)


def test_a_viewer_that_fails_is_an_error(tmp_path, monkeypatch):
    path = written(tmp_path / "walk.rrd", b"RRF2....")
    monkeypatch.setattr(subprocess, "run", lambda c, check: subprocess.CompletedProcess(c, 3))
    refused(r"exit code 3; without a screen, try --web", view, path)
