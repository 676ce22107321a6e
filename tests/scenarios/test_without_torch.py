"""Whoever only filters needs no torch: the extra `learn` is for observers."""

import pytest
from processes import python

WITHOUT_TORCH = """
import sys


class NoTorch:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "torch":
            raise ModuleNotFoundError("No module named 'torch'", name="torch")


sys.meta_path.insert(0, NoTorch())
from surefoot.scenarios.cli.main import main

refused = []
for line in sys.argv[1:]:
    try:
        main(line.split())
    except SystemExit as stop:
        refused.append(str(stop.code))
sys.exit("\\0".join(refused) or None)
"""
SHORT = """
name = "short"
robot = "spot_class"

[[segment]]
duration = 2.0
forward = 0.5
"""
LOG = "walks/short_0.parquet"


def run(lines, folder):
    return python("-c", WITHOUT_TORCH, *lines, cwd=folder, env={"PYTHONWARNINGS": "ignore"})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A walk that was simulated without torch, and what becomes of it."""
    folder = tmp_path_factory.mktemp("without_torch")
    (folder / "short.toml").write_text(SHORT)
    done = run(
        [
            "simulate short.toml -o walks",
            f"info {LOG}",
            f"export {LOG} -o log.csv",
            "import log.csv --guess --robot spot_class -o map.toml",
            "import log.csv --map map.toml -o back.parquet",
            f"estimate {LOG} --filter leg -o leg.parquet",
            f"compare {LOG} -o compared",
            f"trace {LOG} -o traced",
        ],
        folder,
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize(
    "made", ["back.parquet", "leg.tum", "compared/report.html", "traced/trace.json"]
)
def test_what_needs_no_observer_needs_no_torch(folder, made):
    assert (folder / made).stat().st_size > 0


def test_what_needs_an_observer_names_the_extra(folder):
    lines = [
        f"train {LOG} -o observer.pt",
        f"calibrate {LOG} {LOG} -o bounds.json",
        f"compare {LOG} --observer {LOG} -o with_observer",
    ]
    done = run(lines, folder)
    said = done.stderr.strip().split("\0")
    assert len(said) == len(lines)
    assert all("surefoot[learn]" in one and "\n" not in one for one in said)
