"""Hostile input is refused: one line that names what is at fault, nothing written, no traceback, no
more than 1 GB and 10 s. `make test` runs every twentieth case, `.ci/run` all of them."""

import json
from collections.abc import Callable
from pathlib import Path

import command_cases
import log_cases
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import recording_cases
import text_cases
from forked import copied, run_forked
from observer_file import observer_contents, write_observer

from surefoot.sim.robot.machine import load_machine

READERS = {
    "SCENARIO": ("scenario.toml", "simulate scenario.toml -o new"),
    "EFFECTS": ("effects.toml", "simulate scenario.toml --effects effects.toml -o new"),
    "MAP": ("map.toml", "import csv data.csv --map map.toml -o new.parquet"),
    "CSV": ("data.csv", "import csv data.csv --map map.toml -o new.parquet"),
    "ROBOT": ("robot.xml", "trace walk.parquet --robot robot.xml -o new"),
    "URDF": ("robot.urdf", "trace walk.parquet --robot robot.urdf -o new"),
    "EXPERIMENT": ("experiment.toml", "experiment experiment.toml -o new"),
    "SETTINGS": ("settings.toml", "estimate walk.parquet --filter imu --settings settings.toml"),
}
"""Table of cases -> the file that they change, and the command that reads it."""
LEARNT = (
    "estimate walk.parquet --filter coverage --observer observer.safetensors --bounds bounds.json"
)
SHARES = (0.0, 0.001, 0.1, 0.5, 0.9, 0.999)
"""Places in a file, where it is cut short or a byte is flipped."""


def replaced(name: str, old: str, new: str | bytes) -> Callable[[Path], None]:
    """Replace a text of a good file, or where `old` is empty all of it."""

    def change(folder: Path) -> None:
        path = folder / name
        if isinstance(new, bytes):
            path.write_bytes(new)
        else:
            path.write_text(path.read_text().replace(old, new, 1) if old else new)

    return change


def written_log(alter: Callable) -> Callable[[Path], None]:
    """Write the good log anew, its columns and metadata altered."""

    def change(folder: Path) -> None:
        table = pq.read_table(folder / "walk.parquet")
        columns = {name: table[name].to_numpy() for name in table.column_names}
        about = json.loads(table.schema.metadata[b"surefoot"])
        alter(columns, about)
        altered = pa.table(columns).replace_schema_metadata({b"surefoot": json.dumps(about)})
        pq.write_table(altered, folder / "walk.parquet")

    return change


def edited_json(name: str, alter: Callable) -> Callable[[Path], None]:
    """Edit a file of JSON by hand; what is edited becomes bounds.json."""

    def change(folder: Path) -> None:
        values = json.loads((folder / name).read_text())
        alter(values)
        (folder / "bounds.json").write_text(json.dumps(values))

    return change


def edited_observer(alter: Callable) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        values = observer_contents(folder / "observer.safetensors")
        alter(values)
        write_observer(folder / "observer.safetensors", values)

    return change


def damaged(name: str, share: float, flip: bool) -> Callable[[Path], None]:
    """Cut a file short at a place, or flip a byte there."""

    def change(folder: Path) -> None:
        whole = (folder / name).read_bytes()
        at = int(share * (len(whole) - 1))
        rest = bytes([whole[at] ^ 0x55]) + whole[at + 1 :] if flip else b""
        (folder / name).write_bytes(whole[:at] + rest)

    return change


def recorded(file: str, content: str | bytes | Callable[[Path], None]) -> Callable[[Path], None]:
    """Write a recording, and the map of its columns."""

    def change(folder: Path) -> None:
        of_bag = Path(file).suffix in recording_cases.BAGS
        rules = recording_cases.BAG_MAP if of_bag else recording_cases.MAP
        (folder / "recording.toml").write_text(rules)
        if callable(content):
            content(folder / file)
        else:
            (folder / file).write_bytes(content.encode() if isinstance(content, str) else content)

    return change


def zeros(groups: int, rows: int) -> Callable[[Path], None]:
    """Write the good log anew, of so many rows of zeros."""

    def change(folder: Path) -> None:
        path = folder / "walk.parquet"
        recording_cases.zeros(path, groups, rows, pq.read_schema(path).metadata)

    return change


many_rows, one_group = zeros(100, 1_000_000), zeros(1, 4_000_000)


def untouched(folder: Path) -> None:
    """For a command that is at fault itself."""


def _cases() -> list[tuple[str, Callable[[Path], None], str, str]]:
    """What it is, the change to the good files, the command, and a word of its error."""
    found = []
    for table, (file, command) in READERS.items():
        for what, old, new, word in getattr(text_cases, table):
            found.append((f"{table.lower()}: {what}", replaced(file, old, new), command, word))
    for what, file, content, word in recording_cases.RECORDING:
        command = f"import {file} --map recording.toml -o new.parquet"
        found.append((f"recording: {file}: {what}", recorded(file, content), command, word))
    estimate = "estimate walk.parquet --filter leg"
    for what, alter, word in log_cases.LOG:
        found.append((f"log: {what}", written_log(alter), estimate, word))
    found.append(("log: a hundred million rows", many_rows, estimate, "unpacked"))
    found.append(("log: a group of rows", one_group, estimate, "unpacked"))
    for what, alter in log_cases.BOUNDS:
        change = edited_json("bounds.json", alter)
        found.append((f"bounds: {what}", change, LEARNT, "changed"))
    for what, alter, word in log_cases.OLD_BOUNDS:
        change = edited_json("old_bounds.json", alter)
        found.append((f"bounds of 0.1.0: {what}", change, LEARNT, word))
    for what, alter, word in log_cases.OBSERVER:
        found.append((f"observer: {what}", edited_observer(alter), LEARNT, word))
    binary = {"walk.parquet": estimate, "observer.safetensors": LEARNT, "bounds.json": LEARNT}
    for name, command in (binary | {"robot.xml": READERS["ROBOT"][1]}).items():
        for share in SHARES:
            found.append((f"{name}: cut at {share}", damaged(name, share, False), command, ""))
            if name in binary:
                found.append((f"{name}: a bit at {share}", damaged(name, share, True), command, ""))
    for group in ("OPTIONS", "OUTPUTS"):
        for what, command, word in getattr(command_cases, group):
            found.append((f"{group.lower()}: {what}", untouched, command, word))
    return found


CASES = _cases()
SAMPLE = 20
"""Every so many cases are run by `make test`."""


def _marked(number: int, case: tuple) -> object:
    marks = () if number % SAMPLE == 0 else (pytest.mark.long,)
    return pytest.param(*case[1:], id=case[0], marks=marks)


# Behind the limit on what a packed file becomes, which refuses both files first.
@pytest.mark.long
@pytest.mark.parametrize(("change", "word"), [(many_rows, "time stops"), (one_group, "row group")])
def test_a_log_whose_size_is_allowed_is_refused_by_its_rows(
    change, word, good, tmp_path, monkeypatch
):
    monkeypatch.setenv("SUREFOOT_LIMITS", "unpacked=1e9")
    folder = copied(good, tmp_path / "case")
    change(folder)
    found = run_forked(["estimate", "walk.parquet", "--filter", "leg"], folder)
    assert found.refused, found
    assert word in found.err


@pytest.mark.parametrize(
    ("change", "command", "word"), [_marked(number, case) for number, case in enumerate(CASES)]
)
def test_refused(change, command, word, good, tmp_path):
    folder = copied(good, tmp_path / "case")
    change(folder)
    found = run_forked(command.split(), folder)
    *_, said = found.err.splitlines() or [""]
    faults = {
        "not refused in one line": not found.refused,
        f"does not say {word!r}": word.lower() not in said.lower(),
        "a long line": len(said) > 3000,
    }
    if wrong := [what for what, is_so in faults.items() if is_so]:
        pytest.fail(f"{', '.join(wrong)}: {found}", pytrace=False)


@pytest.mark.parametrize("file", ["robot.xml", "robot.urdf"])
def test_the_good_robots_are_read(file, good):
    """Else a case could pass for another reason; test_fuzzed reads the other good files."""
    assert load_machine(good / file).joint_names == ("shoulder",)
