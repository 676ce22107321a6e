"""Compare results of this checkout with those of an earlier commit, to the last bit.

Refactorings must not change results. This builds the earlier commit in a git worktree in the cache
folder, runs the same probes there and here, and prints one table. Both run with the libraries that
are installed here. Results are stored by commit, so that an interrupted run is resumed; those of
uncommitted changes by the difference. Run times, versions and paths are not compared.

    python tests/yardstick.py [--start COMMIT] [--only PROBE ...]

Exits with 1 if anything differs. It takes a quarter of an hour on two idle cores, twice that for a
new start.
"""

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as parquet
from platformdirs import user_cache_path

CHECKOUT = Path(__file__).resolve().parents[1]
START = "27e71444"
MEASURED = Path(os.environ.get("SUREFOOT_MEASURED") or CHECKOUT.parent / "shared" / "measured")
CACHE = Path(os.environ.get("SUREFOOT_CACHE") or user_cache_path("surefoot", appauthor=False))
WORKERS, SHOWN = 2, 3
"""Probes at once, and differences of a probe that are printed."""
IGNORED = {"step [us]", "versions"}
"""Columns of tables and keys of metadata that differ between runs or versions."""
ROBOTS = ("spot_class", "v60_class")
CASES = range(0, 358, 9)
"""Numbers of the blind study's cases: forty, of all kinds."""
RECORDINGS = {
    "ak80_pendulum": ("ak80_pendulum/pd_measured.csv",),
    "go1_square": ("go1_square",),
    "go2_in_air": ("go2_in_air",),
    "icub_biped": ("icub_biped/walking.mat", "icub_biped/com_sinusoid.mat"),
    "ricmonk_run": ("ricmonk/csv/r01.csv",),
    "ricmonk_swing": ("ricmonk/swings/r01_s0.csv",),
    "scaler_trot": ("scaler_trot/logs/scaler_06.csv",),
    "so101": ("so101/chirp_sweep",),
}
"""Bundled map -> recordings that it is for, in the folder of measured ones."""

STAIRS = """
name = "Stairs"
segment = [
  {distance = 3.0, forward = 0.6},
  {distance = 4.2, forward = 0.45},
  {distance = 2.0, forward = 0.6},
]
ground = {mu = 0.75, half_size = 20.0, strip = [
  {start = [4.0, 0.0], end = [12.0, 0.0], width = 4.0, heights = [0.6, 0.6]},
  {start = [3.4, 0.0], end = [5.0, 0.0], width = 4.0, heights = [0.0, 0.6], steps = 5},
]}
ranges = {mu = [0.9, 1.1], speed = [0.985, 1.015]}
"""
ICE = """
name = "Ice"
segment = [
  {distance = 4.0, forward = 0.7},
  {angle = 3.1416, forward = 0.2, turn = 0.8},
  {distance = 4.0, forward = 0.7},
]
ground = {mu = 0.12, half_size = 20.0}
ranges = {mu = [0.9, 1.1], speed = [0.97, 1.03]}
"""
LOOP = """
name = "Loop"
role = "test"
segment = [
  {distance = 4.0, forward = 0.5},
  {angle = 3.1416, forward = 0.3, turn = 0.6},
  {distance = 4.0, forward = 0.5},
]
ground = {mu = 0.7, half_size = 20.0, patch = [{center = [2.0, 0.0], size = [1.0, 2.0], mu = 0.25}]}
"""
AS_WALKED = f"""
scenarios = ["loop.toml"]
robots = {json.dumps(ROBOTS)}
seeds = [3]
filters = ["leg", "imu"]
[[condition]]
name = "as walked"
imperfections = "as_built.toml"
walked = "as_walked.toml"
"""


@dataclass(frozen=True)
class Side:
    """A commit that results are made of: its checkout, and the folder of its results."""

    checkout: Path
    results: Path

    def python(self, *arguments: str | Path, cwd: Path) -> None:
        """Run Python with this commit's surefoot and studies; raises SystemExit if it fails."""
        # Before the packages that are installed here as editable.
        environment = os.environ | {
            "PYTHONPATH": str(self.checkout),
            "OPENBLAS_NUM_THREADS": "1",
        }
        run = subprocess.run(
            [sys.executable, *map(str, arguments)],
            cwd=cwd,
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        if run.returncode:
            words = " ".join(map(str, arguments))
            raise SystemExit(f"{self.checkout}: {words} failed:\n{run.stdout[-3000:]}")

    def surefoot(self, *arguments: str | Path, cwd: Path) -> None:
        """Run a command of this commit."""
        self.python("-m", "surefoot", *arguments, cwd=cwd)


Probe = Callable[[Side, Path], Iterable[tuple[str, Path]]]
"""Works in a folder; returns (name, file) of all results to compare."""


def demo(side: Side, work: Path) -> list[tuple[str, Path]]:
    """Table and trace of the demo."""
    side.surefoot("demo", "-o", "demo", cwd=work)
    return [("table.csv", work / "demo/table.csv"), ("trace.json", work / "demo/trace/trace.json")]


def simulate(side: Side, work: Path) -> Iterator[tuple[str, Path]]:
    """Walks of two robots on stairs and on ice."""
    for name, text in {"stairs": STAIRS, "ice": ICE}.items():
        (work / f"{name}.toml").write_text(text)
        for robot in ROBOTS:
            folder = f"{name}_{robot}"
            side.surefoot(
                *("simulate", f"{name}.toml", "--robot", robot, "--seeds", "3", "-o", folder),
                cwd=work,
            )
            (log,) = (work / folder).glob("*.parquet")
            yield f"{folder}.parquet", log


def as_walked(side: Side, work: Path) -> Iterator[tuple[str, Path]]:
    """Walks of two robots as walked, and the errors of filters on them."""
    (work / "loop.toml").write_text(LOOP)
    (work / "walked.toml").write_text(AS_WALKED)
    for name in ("as_built.toml", "as_walked.toml"):
        (path,) = _git("ls-files", f"*/{name}", cwd=side.checkout).split()
        shutil.copy(side.checkout / path, work)
    side.surefoot("experiment", "walked.toml", "--no-recordings", "-o", "out", cwd=work)
    yield "results.csv", work / "out/results.csv"
    for log in (work / "out/cache/walk").glob("*.parquet"):
        about = json.loads((parquet.read_schema(log).metadata)[b"surefoot"])
        yield f"{about['robot']}.parquet", log


def compare(side: Side, work: Path) -> list[tuple[str, Path]]:
    """Filters on the Go1's measured walk."""
    side.surefoot(
        *("import", MEASURED / "go1_square", "--map", "go1_square", "-o", "go1.parquet"), cwd=work
    )
    side.surefoot("compare", "go1.parquet", "-o", "compared", cwd=work)
    return [("table.csv", work / "compared/table.csv")]


def imported(name: str, side: Side, work: Path) -> Iterator[tuple[str, Path]]:
    """Logs of the recordings of a bundled map."""
    for file in RECORDINGS[name]:
        log = work / f"{Path(file).stem}.parquet"
        side.surefoot("import", MEASURED / file, "--map", name, "-o", log, cwd=work)
        yield log.name, log


def blind(part: int, side: Side, work: Path) -> list[tuple[str, Path]]:
    """Every fourth of the blind cases: verdicts, targets and sizes."""
    side.python(Path(__file__), "--cases", *map(str, CASES[part::4]), cwd=work)
    return [(path.name, path) for path in work.glob("*.json")]


def run_cases(numbers: Iterable[int]) -> None:
    """Trace blind cases of the surefoot that is imported; writes a file for each."""
    plan, trial = (import_module(f"studies.blind.{name}") for name in ("plan", "trial"))
    read = import_module("surefoot.sim.common.toml").read_toml
    cases = {case.number: case for case in plan.draw_cases(read(plan.PLAN, "study"))}
    for number in numbers:
        row = trial.run_case(cases[number], plan.PLAN)
        Path(f"{number:03d}.json").write_text(json.dumps(row, default=float))


PROBES: dict[str, Probe] = {
    "demo": demo,
    "simulate": simulate,
    "as_walked": as_walked,
    **{f"blind_{part}": partial(blind, part) for part in range(4)},
    "compare_go1": compare,
    **{f"import_{name}": partial(imported, name) for name in RECORDINGS},
}


def recording_of(probe: str) -> Path | None:
    """The measured recording that a probe needs."""
    name = "go1_square" if probe == "compare_go1" else probe.removeprefix("import_")
    return MEASURED / RECORDINGS[name][0] if name in RECORDINGS else None


def run_probes(side: Side, names: Iterable[str]) -> None:
    """Run the probes that have no results yet."""

    def run(name: str) -> None:
        work = side.results / f"{name}.work"
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        finished = work / "results"
        finished.mkdir()
        for file, path in PROBES[name](side, work):
            shutil.copy(path, finished / file)
        finished.rename(side.results / name)
        shutil.rmtree(work)

    with ThreadPoolExecutor(WORKERS) as pool:
        for name, done in [(name, pool.submit(run, name)) for name in names]:
            done.result()
            print(f"{side.results.name}: {name}", file=sys.stderr)


def results_of(commit: str | None, names: Iterable[str]) -> Path:
    """Folder of results of a commit, None for the working tree; missing ones are made."""
    folder = CACHE / "yardstick"
    results = folder / _key(commit)
    missing = [name for name in names if not (results / name).is_dir()]
    if not missing:
        return results
    if commit is None:
        run_probes(Side(CHECKOUT, results), missing)
        return results
    # One checkout for all commits: kernels of files that two commits share are compiled once.
    checkout = folder / "checkout"
    if checkout.exists():
        _git("checkout", "--detach", "--force", commit, cwd=checkout)
    else:
        _git("worktree", "prune")
        _git("worktree", "add", "--detach", str(checkout), commit)
    run_probes(Side(checkout, results), missing)
    return results


def _key(commit: str | None) -> str:
    """Name of the results: the commit, and a digest of what is not committed."""
    found = _git("rev-parse", "--short=12", f"{commit or 'HEAD'}^{{commit}}").strip()
    if commit:
        return found
    changes = _git("diff", "HEAD").encode()
    for name in _git("ls-files", "--others", "--exclude-standard").splitlines():
        changes += name.encode() + (CHECKOUT / name).read_bytes()
    return found + (f"-{hashlib.sha256(changes).hexdigest()[:8]}" if changes else "")


def _git(*arguments: str, cwd: Path = CHECKOUT) -> str:
    return subprocess.run(
        ["git", *arguments], cwd=cwd, check=True, capture_output=True, text=True
    ).stdout


def differences(before: Path, after: Path) -> list[tuple[float, str]]:
    """(relative difference, words) of what differs between two folders of results, largest first;
    infinite for all but numbers.
    """
    old, new = (
        pd.concat({path.name: _values(path) for path in sorted(folder.iterdir())})
        for folder in (before, after)
    )
    found = []
    for key in old.index.union(new.index, sort=False):
        if key not in old or key not in new:
            found.append((np.inf, f"{': '.join(key)} is {'new' if key in new else 'missing'}"))
            continue
        difference, words = _difference(old[key], new[key])
        if difference > 0.0:
            found.append((difference, f"{': '.join(key)} {words}"))
    return sorted(found, key=lambda one: -one[0])


def _values(path: Path) -> pd.Series:
    """All that a result contains by its name: columns, cells or entries."""
    columns = {}
    if path.suffix == ".parquet":
        table = parquet.read_table(path)
        columns = {name: table[name].to_numpy() for name in table.column_names}
        entries = json.loads((table.schema.metadata or {})[b"surefoot"])
    elif path.suffix == ".csv":
        entries = pd.read_csv(path, float_precision="round_trip").to_dict("records")
    else:
        entries = json.loads(path.read_text(encoding="utf-8"))
    return pd.Series(columns | dict(_entries(entries)), dtype=object)


def _entries(value: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    """The single values of a nest of tables and lists, by their paths in it."""
    if isinstance(value, list):
        value = dict(enumerate(value))
    if not isinstance(value, Mapping):
        yield at, value
        return
    yield f"{at} keys", sorted(str(key) for key in value if key not in IGNORED)
    for key, one in value.items():
        if key not in IGNORED:
            yield from _entries(one, f"{at}/{key}")


def _difference(old: Any, new: Any) -> tuple[float, str]:
    """Largest relative difference of two values and its words; 0 if they are equal to the bit."""
    a, b = np.atleast_1d(old), np.atleast_1d(new)
    if a.dtype.kind + b.dtype.kind not in ("ff", "fi", "if", "ii") or a.shape != b.shape:
        same = a.shape == b.shape and a.dtype == b.dtype and (a == b).all()
        return (0.0, "") if same else (np.inf, f"{str(old)[:97]} -> {str(new)[:97]}")
    unequal = (a != b) & ~(np.isnan(a) & np.isnan(b))
    if not unequal.any():
        return 0.0, ""
    a, b = a[unequal].astype(float), b[unequal].astype(float)
    relative = np.nan_to_num(np.abs(a - b) / np.maximum(np.abs(a), np.abs(b)), nan=np.inf)
    most = int(np.argmax(relative))
    count = f", {a.size} of {unequal.size} values" if unequal.size > 1 else ""
    return float(relative[most]), f"{a[most]:.17g} -> {b[most]:.17g} ({relative[most]:.1e}{count})"


def report(before: Path, after: Path, names: Iterable[str]) -> bool:
    """Print the table; returns whether anything differs."""
    print(f"\nstart {before.name}, here {after.name}\n\n| probe | result |\n| --- | --- |")
    differs = False
    for name in names:
        found = differences(before / name, after / name)
        differs |= bool(found)
        shown = [words for _, words in found[:SHOWN]]
        more = f"; {len(found) - len(shown)} more" if len(found) > len(shown) else ""
        print(f"| {name} | {'; '.join(shown) + more if found else 'same'} |")
    return differs


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--start", default=START, help="commit to compare with")
    parser.add_argument("--only", nargs="+", default=["all"], help=f"of {', '.join(PROBES)}")
    parser.add_argument("--cases", nargs="+", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.cases:
        run_cases(args.cases)
        return
    names = [n for n in PROBES if args.only == ["all"] or any(map(n.startswith, args.only))]
    needed = {name: recording_of(name) for name in names}
    for name, recording in needed.items():
        if recording and not recording.exists():
            print(f"{name} is skipped: {recording} is not there")
            names.remove(name)
    before = results_of(args.start, names)
    after = results_of(None, names)
    sys.exit(report(before, after, names))


if __name__ == "__main__":
    main()
