"""Recordings that a test writes, and what an importer makes of them."""

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import scipy.io

from surefoot.sim.importing.guessing.draft import Draft, Entry
from surefoot.sim.importing.guessing.guess import guess_map
from surefoot.sim.importing.recording import import_log
from surefoot.sim.log import Log
from surefoot.sim.log.schema import GROUPS

SENSORS, POSE = ([*GROUPS[group]] for group in ("imu", "reference"))
UNIX = 1_700_000_000


def csv(folder: Path, columns, name: str = "run.csv", **options) -> Path:
    """A table of text in a folder, of columns by name; options are those of pandas."""
    pd.DataFrame(columns).to_csv(folder / name, index=False, **options)
    return folder / name


def saved(path: Path, arrays: Mapping) -> Path:
    """A file of arrays by name, of the kind that its suffix says: .npz, .mat or .h5."""
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    elif path.suffix == ".mat":
        scipy.io.savemat(path, dict(arrays))
    else:
        with h5py.File(path, "w") as file:
            file.update(arrays)
    return path


def as_recording(folder: Path, log: Log, name: str = "run", more: str = "") -> tuple[Path, Path]:
    """A log as a table of text, and a map of it by its own names, with `more` at its end."""
    columns = "".join(f'{column} = "{column}"\n' for column in log.frame)
    rules = folder / f"{name}.toml"
    rules.write_text(f"[columns]\n{columns}{more}")
    return csv(folder, log.frame, f"{name}.csv"), rules


def imported(files: Path | Sequence[Path], rules: str | Draft) -> Log:
    """The log of files by a map of this text, or by a draft as it is."""
    first = files if isinstance(files, Path) else files[0]
    at = first.parent / "map.toml"
    at.write_text(rules.text if isinstance(rules, Draft) else rules)
    return import_log(files, at)


def as_named(names: Iterable[str], section: str = "columns") -> str:
    """A section of a map, of columns that have the log's names."""
    return f"[{section}]\n" + "".join(f'{name} = "{name}"\n' for name in names)


def pasted(text: str, lines: Sequence[str]) -> str:
    """A map with lines in place of its own."""
    section = ""
    for line in lines:
        if line.startswith("["):
            section = line
            continue
        key = line.partition(" = ")[0]
        kept, at = [], ""
        for old in text.splitlines():
            at = old if old.startswith("[") else at
            if not (at == section and old.partition(" = ")[0] == key):
                kept.append(old)
            if old == section:
                kept.append(line)
        text = "\n".join(kept) + "\n"
    tomllib.loads(text)
    return text


def poses(t: np.ndarray, step: float) -> pd.DataFrame:
    """A reference that goes along x by a step [m] a sample, and does not turn."""
    frame = pd.DataFrame({"t": t} | dict.fromkeys(POSE, 0.0))
    return frame.assign(ref_p_x=step * np.arange(len(t)), ref_q_w=1.0)


def drafted(folder: Path, columns, robot: str | None = None) -> Draft:
    """The draft of a single table of text."""
    return guess_map([csv(folder, columns)], robot)


def entries_of(draft: Draft) -> dict[str, Entry]:
    """Entries by the log's column; those of the reference after its name."""
    poses = {f"reference {one.name}": one for one in draft.reference}
    return {one.name: one for one in draft.main} | poses


def check_entries(draft: Draft, expected: Mapping[str, tuple[str | None, ...]]) -> None:
    """Check entries of a draft by the log's columns: their column and, where given, unit and words
    of the doubt; `()` stands for none.
    """
    found = entries_of(draft)
    for name, (*of_file, doubt) in ((n, (*x, "")[:3]) for n, x in expected.items()):
        if not of_file:
            assert name not in found, name
            continue
        one = found[name]
        assert [one.theirs, one.unit][: len(of_file)] == of_file, name
        assert str(doubt) in one.doubt, (name, one.doubt)
