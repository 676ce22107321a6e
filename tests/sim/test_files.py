"""What a command writes: whole, listed, replaced only where the same command made it, and never
over what it reads."""

import errno
import json
import os
from contextlib import suppress

import pytest
from refusals import refused

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import (
    MANIFEST,
    cache_folder,
    check_unchanged,
    command_run,
    manifest_entries,
    refuse_full,
    refuse_overwrite,
    remove_unfinished,
    whole_file,
    whole_folder,
)


def write(path, text, command="make", inputs=(), force=True):
    with command_run(command, inputs), whole_file(path, force) as temporary:
        temporary.write_text(text)


def fill(folder, texts, command="make", force=True):
    with command_run(command), whole_folder(folder, force) as made:
        for name, text in texts.items():
            (made / name).parent.mkdir(exist_ok=True)
            (made / name).write_text(text)


def test_force_replaces_what_the_same_command_made(tmp_path):
    path = tmp_path / "a.txt"
    write(path, "one")
    write(path, "two")
    assert path.read_text() == "two"
    refused("give --force to overwrite it", write, path, "three", force=False)
    refused("give force=True to overwrite it", refuse_overwrite, path, force=False)
    refused("surefoot make made it", write, path, "three", command="other")
    path.write_text("edited")
    refused("was changed since it was made", write, path, "three")
    assert path.read_text() == "edited"
    assert sorted(p.name for p in tmp_path.iterdir()) == [MANIFEST, "a.txt"]


def test_force_leaves_what_nobody_listed(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    refused("no command of surefoot made it", write, tmp_path / "mine.txt", "theirs")
    assert (tmp_path / "mine.txt").read_text() == "mine"
    # From Python, outside of any command, force is what it says.
    with whole_file(tmp_path / "mine.txt", force=True) as temporary:
        temporary.write_text("ours")
    assert (tmp_path / "mine.txt").read_text() == "ours"


def test_what_a_program_puts_in_its_place_stays_the_commands(tmp_path):
    """From Python, force over a command's output: the command's own --force goes on to work."""
    path, out = tmp_path / "a.txt", tmp_path / "out"
    write(path, "one")
    with whole_file(path, force=True) as temporary:
        temporary.write_text("from Python")
    write(path, "two")
    fill(out, {"report.html": "1", "figures/a.png": "1"})
    with whole_folder(out, force=True) as made:
        (made / "figures").mkdir()
        (made / "figures" / "a.png").write_text("from Python")
    with whole_file(out / "report.html", force=True) as temporary:
        temporary.write_text("from Python")
    fill(out, {"report.html": "2"})
    assert path.read_text() == "two"
    assert (out / "report.html").read_text() == "2"
    assert not (out / "figures" / "a.png").exists()
    refused("surefoot make made it", write, path, "three", command="other")


@pytest.mark.parametrize("name", ["log", "link", "hard", "folder/log", "sub/../log"])
def test_an_output_is_no_input_by_whatever_name(tmp_path, name):
    log = tmp_path / "log"
    write(log, "log")
    (tmp_path / "link").symlink_to(log)
    os.link(log, tmp_path / "hard")
    (tmp_path / "folder").symlink_to(tmp_path)
    (tmp_path / "sub").mkdir()
    refused("is an input of this command", write, tmp_path / name, "new", inputs=[log])
    assert log.read_text() == "log"


def test_a_folder_is_replaced_as_a_whole(tmp_path):
    out = tmp_path / "out"
    fill(out, {"report.html": "1", "figures/a.png": "1", "figures/b.png": "1"})
    (out / "notes.txt").write_text("mine")
    fill(out, {"report.html": "2", "figures/a.png": "2"})
    left = {str(p.relative_to(out)): p.read_text() for p in out.rglob("*") if p.is_file()}
    del left[MANIFEST]
    assert left == {"report.html": "2", "figures/a.png": "2", "notes.txt": "mine"}
    (out / "figures" / "a.png").write_text("mine now")
    with command_run("make"), pytest.raises(SurefootError, match=r"a\.png: not overwritten"):
        refuse_full(out, force=True)
    refused(r"a\.png: not overwritten", fill, out, {"report.html": "3", "figures/a.png": "3"})
    assert (out / "report.html").read_text() == "2"
    with command_run("other"), pytest.raises(SurefootError, match="made nothing here"):
        refuse_full(out, force=True)


def test_a_folder_that_a_link_leads_out_of_is_not_filled(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out" / "figures").symlink_to(tmp_path / "elsewhere")
    refused("by a link", fill, tmp_path / "out", {"figures/a.png": "1"})
    assert not list((tmp_path / "elsewhere").iterdir())


def test_what_is_unfinished_goes_where_the_process_ends_without_leaving_it(tmp_path):
    """In a process of its own, for nothing can be begun afterwards."""
    child = os.fork()
    if child == 0:
        with whole_folder(tmp_path / "new" / "out") as made, whole_file(made / "a"):
            (made / "b").write_text("half")
            remove_unfinished()
            os._exit(7)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_said_of_the_file_that_could_not_be_written(tmp_path):
    cache = tmp_path / "cache" / "fonts.json"
    full = OSError(errno.ENOSPC, "No space left on device", str(cache))
    said = pytest.raises(SurefootError, match=r"^\S+fonts\.json: cannot be written \(No space")
    with said, whole_file(tmp_path / "a"):
        raise full
    said = pytest.raises(SurefootError, match=r"^\S+/a: cannot be written \(No space")
    with said, whole_file(tmp_path / "a") as temporary:
        full.filename = str(temporary)
        raise full


def test_a_failed_run_leaves_nothing(tmp_path):
    """Nor the folders that it made for its output."""
    with suppress(RuntimeError), whole_folder(tmp_path / "a" / "b" / "out") as made:
        (made / "half").write_text("half")
        raise RuntimeError
    with suppress(RuntimeError), whole_file(tmp_path / "c" / "d" / "half") as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_debris_of_a_killed_run_goes_with_the_next(tmp_path):
    dead = tmp_path / ".out.4194303.tmp"
    (dead / "figures").mkdir(parents=True)
    fill(tmp_path / "out", {"report.html": "1"})
    assert not dead.exists()


def test_a_line_cut_short_by_a_kill_is_skipped(tmp_path):
    write(tmp_path / "a", "1")
    with (tmp_path / MANIFEST).open("a") as stream:
        stream.write('{"file": "b", "sha')
    write(tmp_path / "c", "1")
    assert set(manifest_entries(tmp_path)) == {"a", "c"}
    lines = (tmp_path / MANIFEST).read_text().splitlines()
    assert json.loads(lines[0])["command"] == "make"


def test_a_flipped_byte_is_noticed(tmp_path):
    path = tmp_path / "walk.rrd"
    write(path, "recording")
    check_unchanged(path)
    path.write_text("recorder.")
    refused("changed or damaged", check_unchanged, path)


def test_a_cache_that_others_can_write_to_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("SUREFOOT_CACHE", str(tmp_path / "cache"))
    assert cache_folder() == tmp_path / "cache"
    (tmp_path / "cache").chmod(0o777)
    refused("others can write to this cache", cache_folder)


def test_a_manifest_of_brackets_lists_nothing(tmp_path):
    (tmp_path / MANIFEST).write_text("[" * 100_000 + "\n" + '{"file": "a"}\n')
    assert manifest_entries(tmp_path) == {}
