"""Every reader takes any bytes: it reads them or raises SurefootError, in bounded time and memory.

The bytes are good files with parts cut, copied, flipped and replaced by what breaks parsers. A few
files a reader in `make test`, some hundreds in `.ci/run`.
"""

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_cases import MAP, hdf5, matrices, packed, replaced, table

from surefoot import Bounds, Log, Observer, Scenario, import_log
from surefoot.extend import SurefootError, Trajectory
from surefoot.scenarios.datasets.simulate import seed_range
from surefoot.scenarios.estimate.settings import read_settings
from surefoot.scenarios.experiments.file import Experiment
from surefoot.scenarios.export import export
from surefoot.sim.effects.file import load_effects
from surefoot.sim.importing.guessing.guess import guess_map
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.readers.bag import read_bag
from surefoot.sim.robot.model_gate import check_model_file

FILES = Path(__file__).resolve().parents[1] / "data" / "0.1.0"
READERS: dict[str, Callable[[Path], object]] = {
    "scenario.toml": Scenario.load,
    "effects.toml": load_effects,
    "map.toml": ImportMap.read,
    "experiment.toml": Experiment.load,
    "settings.toml": lambda path: read_settings(path, ()),
    "data.csv": lambda path: import_log(path, path.parent / "good" / "map.toml"),
    "robot.xml": check_model_file,
    "robot.urdf": check_model_file,
    "bounds.json": Bounds.load,
    "old_bounds.json": Bounds.load,
    "observer.safetensors": Observer.load,
    "walk.parquet": Log.read,
    "trajectory.parquet": Trajectory.read,
    "run.mcap": read_bag,
    "named.csv": lambda path: guess_map([path]),
}
RECORDINGS: dict[str, Callable[[Path], object]] = {
    "run.json": lambda path: path.write_text(replaced("0.1")),
    "run.npz": packed(),
    "run.h5": hdf5(lambda file: None),
    "run.mat": matrices,
    "run.parquet": table(),
}
"""Whole files that the import reads, and what writes them."""
READERS |= dict.fromkeys(RECORDINGS, lambda path: import_log(path, path.parent / "recording.toml"))
NASTY = (
    *(b"nan", b"inf", b"-1", b"0", b"1e300", b"1e400", b"9" * 400, b"true", b"null", b'""', b"[]"),
    *(b"{}", b"[[", b"]", b"}", b"\0", b"\n", b"\r\n", b'"', b"'", b",", b"=", b"<!--", b"&a;"),
    *(b"\xff\xfe", b"\xc3\x28", b"../", b"/etc/passwd", b"%s%n", b"<script>", b"9" * 5000),
    *(b"[" * 3000, b"1_000", b"0x10", b"1979-05-27", b"=1\n[a]\n"),
)


@st.composite
def edits(draw) -> list[tuple]:
    """Where (a share of the file), how much is taken away, and what is put there."""
    place = st.floats(0.0, 1.0)
    length = st.sampled_from((0, 0, 1, 2, 5, 20, 200))
    put = st.sampled_from(NASTY) | st.binary(max_size=8)
    return draw(st.lists(st.tuples(place, length, put), min_size=1, max_size=4))


def edited(good: bytes, changes: list[tuple]) -> bytes:
    for share, length, put in changes:
        at = int(share * len(good))
        good = good[:at] + put + good[at + length :]
    return good


def _whole(name: str, good: Path, folder: Path) -> Path:
    """The file that is edited."""
    if name == "trajectory.parquet":
        return FILES / name
    if name in RECORDINGS:
        (folder / "recording.toml").write_text(MAP)
        RECORDINGS[name](folder / name)
        return folder / name
    if name == "named.csv":
        Log.read(good / "walk.parquet").frame[:50].to_csv(folder / name, index=False)
        return folder / name
    if name == "run.mcap":
        export(good / "walk.parquet", folder / name)
        return folder / name
    return good / name


@pytest.mark.parametrize("count", [4, pytest.param(400, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", READERS)
def test_a_reader_takes_any_bytes(name, count, good, tmp_path):
    content = _whole(name, good, tmp_path).read_bytes()
    for other in ("scenario.toml", "effects.toml"):
        (tmp_path / other).write_bytes((good / other).read_bytes())
    if not (tmp_path / "good").exists():
        (tmp_path / "good").symlink_to(good)
    path = tmp_path / name
    path.write_bytes(content)
    READERS[name](path)  # else what fails below is a fault of the good file

    @settings(
        max_examples=count,
        deadline=10_000,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(edits())
    def run(changes: list[tuple]) -> None:
        path.write_bytes(edited(content, changes))
        with suppress(SurefootError):
            READERS[name](path)

    run()


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=8,
)


def test_bounds_of_any_values(tmp_path):
    """Of the schema without a digest, whose values nothing else guards."""
    good = json.loads((FILES / "bounds.json").read_text())
    path = tmp_path / "bounds.json"

    @settings(max_examples=60, derandomize=True, database=None, deadline=None)
    @given(st.sampled_from(sorted(good)), JSON)
    def run(key: str, value: object) -> None:
        path.write_text(json.dumps(good | {key: value}))
        with suppress(SurefootError):
            Bounds.load(path)

    run()


@given(st.text(max_size=30) | st.from_regex(r"-?[0-9]{1,30}:?-?[0-9]{0,30}", fullmatch=True))
def test_seeds_of_any_text(text):
    try:
        found = seed_range(text)
    except SurefootError:
        return
    assert 0 < len(found) <= 100_000
    assert found[0] >= 0
