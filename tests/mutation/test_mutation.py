"""The mutants of a tiny checkout: which are drawn, which are killed, and what a kill leaves."""

import ast
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest
from mutate import drawn, mutants_of, quotas, read_plan
from run import first_outcomes, read_row, run_mutants
from trial import Outcome, Workplace

ROOT = Path(__file__).resolve().parents[2]
SOURCE = '''"""Sums."""

LEAST = 0.5


def total(values):
    """0.5 - 1.0 is no code."""
    found = 0.0
    for value in values:
        found += value
    return found + 0.0


def same(a, b):
    return max(a - b, b - a) <= LEAST


def down(count):
    while count > 0:
        count -= 1
    return count
'''
TRIED = ("tests/test_tiny.py",)
TESTS = """from surefoot.estimator.tiny import down, same, total


def test_total():
    assert total([1.0, 2.0]) == 3.0


def test_same():
    assert same(1.0, 1.5)
    assert not same(1.0, 1.52)


def test_down():
    assert down(3) == 0
"""


@pytest.fixture
def place(tmp_path) -> Workplace:
    root = tmp_path / "checkout"
    files = {
        "surefoot/__init__.py": "",
        "estimator/__init__.py": "",
        "estimator/tiny.py": SOURCE,
        "tests/test_tiny.py": TESTS,
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    plan = replace(read_plan(), files=["estimator/*.py"], tests=["tests"], grace=20.0)
    return Workplace(root, tmp_path / "cache", plan)


def _mutant(before: str, after: str):
    return next(
        mutant
        for mutant in mutants_of("estimator/tiny.py", SOURCE.encode())
        if mutant.lines(SOURCE.encode()) == (before, after)
    )


@pytest.mark.parametrize(
    ("before", "after", "outcome", "by"),
    [
        ("LEAST = 0.5", "LEAST = 0.55", "killed", "tests/test_tiny.py::test_same"),
        ("count -= 1", "pass", "timeout", "tests/test_tiny.py"),
        ("return found + 0.0", "return found - 0.0", "survived", ""),
    ],
)
def test_a_known_mutant_is_killed_and_an_equivalent_one_survives(place, before, after, outcome, by):
    place.refresh()
    if outcome == "timeout":
        place = replace(place, plan=replace(place.plan, grace=2.0))
    found = place.try_mutant(_mutant(before, after))
    assert (found.outcome, found.by) == (outcome, by)
    assert (place.root / "estimator/tiny.py").read_text() == SOURCE


def test_a_killed_run_leaves_nothing_and_is_gone_on_with(place, tmp_path):
    data = tmp_path / "rows"
    first = run_mutants(place, data, at_most=1)
    copy = place.overlay / "surefoot/estimator/tiny.py"
    endless = replace(place, plan=replace(place.plan, grace=1e5))
    runner = os.fork()
    if runner == 0:
        endless.try_mutant(_mutant("count -= 1", "pass"))
        os._exit(0)
    while copy.read_text() == SOURCE and os.waitpid(runner, os.WNOHANG) == (0, 0):
        time.sleep(0.01)
    os.kill(runner, signal.SIGKILL)
    os.waitpid(runner, 0)
    assert copy.read_text() != SOURCE
    assert (place.root / "estimator/tiny.py").read_text() == SOURCE
    (stamp,) = (path.stat().st_mtime_ns for path in data.iterdir())
    rows = run_mutants(place, data, at_most=1)
    assert copy.read_text() == SOURCE
    assert len(rows) == 2
    assert rows[0] == first[0]
    assert stamp in {path.stat().st_mtime_ns for path in data.iterdir()}


def test_a_row_lapses_with_its_module_and_with_its_tests(place, tmp_path):
    run_mutants(place, tmp_path, at_most=1)
    mutant = drawn(place.plan, place.root)[0]
    assert read_row(tmp_path, mutant, place) is not None
    for name in ("estimator/tiny.py", "tests/test_tiny.py"):
        path = place.root / name
        text = path.read_text()
        path.write_text(text + "\n# A comment.\n")
        assert read_row(tmp_path, mutant, place) is not None
        path.write_text(text + "\nMORE = 1\n")
        assert read_row(tmp_path, mutant, place) is None
        path.write_text(text)
        assert read_row(tmp_path, mutant, place) is not None


def test_lapsed_rows_come_first_and_keep_what_was_found_at_first(place, tmp_path, monkeypatch):
    found = iter(["survived", "killed", "survived", "killed", "killed"])
    monkeypatch.setattr(Workplace, "try_mutant", lambda *_: Outcome(next(found), files=TRIED))
    every = drawn(place.plan, place.root)
    run_mutants(place, tmp_path, at_most=2)
    assert first_outcomes(place, tmp_path) == ["survived", "killed"]
    path = place.root / TRIED[0]
    path.write_text(path.read_text() + "\nMORE = 1\n")
    rows = run_mutants(place, tmp_path, at_most=1)
    assert [row["key"] for row in rows] == [every[0].key]
    rows = run_mutants(place, tmp_path, at_most=2)
    assert [row["key"] for row in rows] == [mutant.key for mutant in every[:3]]
    assert first_outcomes(place, tmp_path) == ["survived", "killed", "killed"]


def test_the_draw_is_that_of_its_seed_and_has_every_file_by_its_share():
    plan = replace(read_plan(), files=["estimator/updates/*.py"], mutants=60)
    every = drawn(plan, ROOT)
    assert every == drawn(plan, ROOT)
    assert len(every) == len({mutant.key for mutant in every}) == plan.mutants
    assert every != drawn(replace(plan, seed=plan.seed + 1), ROOT)
    counts = {
        name: len(mutants_of(name, (ROOT / name).read_bytes()))
        for name in {mutant.file for mutant in every}
    }
    shares = quotas(counts, plan.mutants, plan.each)
    for name, share in shares.items():
        assert share == sum(mutant.file == name for mutant in every) >= min(3, counts[name])
    # The first third of them has about a third of each file's.
    part = [mutant.file for mutant in every[: plan.mutants // 3]]
    assert all(abs(part.count(name) - share / 3) <= 2 for name, share in shares.items())


def test_every_mutant_of_the_drawn_files_is_python_and_no_docstring():
    for name in ("estimator/metrics.py", "models/calibration/bounds.py"):
        source = (ROOT / name).read_bytes()
        before = ast.dump(ast.parse(source))
        for mutant in mutants_of(name, source)[::8]:
            assert ast.dump(ast.parse(mutant.apply(source))) != before


def test_a_change_of_one_line_redraws_no_other_key():
    before = {mutant.key for mutant in mutants_of("a.py", SOURCE.encode())}
    longer = SOURCE.replace("LEAST = 0.5", "# said\n\nLEAST = 0.6").encode()
    after = {mutant.key for mutant in mutants_of("a.py", longer)}
    assert len(before - after) == len(after - before) == 1
