"""Walks of many minutes: simulated, indexed and estimated in the memory of one."""

import json

import pytest
from courses import course_file
from dataset_index import read_index
from processes import printed

from surefoot.scenarios.datasets import simulate
from surefoot.scenarios.settings import SimulateSettings
from surefoot.sim.log import LogReader

LAP = """robot = "spot_class"
laps = {laps}
[[segment]]
repeat = 2
[[segment.segment]]
duration = 20.0
forward = 0.5
[[segment.segment]]
duration = 10.0
forward = 0.3
turn = 0.3141592653589793
"""
PEAKS = """
import json, resource, sys, time
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.datasets import simulate
from surefoot.scenarios.estimate import file
simulate.LONG_WALK = file.LONG = 60.0
found = {}
for name, arguments in (
    ("simulate", ["simulate", "laps.toml", "-o", "walks"]),
    ("estimate", ["estimate", "walks/laps_0.parquet", "--filter", "leg", "-o", "leg.parquet"]),
):
    begun = time.process_time()
    main(arguments)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    found[name] = {"MB": peak, "CPU s": time.process_time() - begun}
print(json.dumps(found))
"""
DATASET = """
import resource, sys
from surefoot.scenarios.cli.main import main
main(["simulate", "short.toml", "--seeds", sys.argv[1], "--workers", "2", "-o", "walks"])
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)
"""
MORE = {"simulate": 150.0, "estimate": 500.0}
"""MB that a walk of any length may take beyond one of two minutes: lists of a few numbers a minute,
what the allocator does not give back, and the hundred thousand estimates that are judged."""


def peaks(folder, minutes: int) -> dict[str, dict[str, float]]:
    """Peak memory and time of simulating and of estimating so many minutes, in a process."""
    folder.mkdir()
    (folder / "laps.toml").write_text(LAP.format(laps=minutes))
    return json.loads(printed("-c", PEAKS, cwd=folder, timeout=None).splitlines()[-1])


@pytest.mark.parametrize(
    "minutes", [pytest.param(20, marks=pytest.mark.long), pytest.param(480, marks=pytest.mark.slow)]
)
def test_memory_is_flat_and_time_linear(tmp_path, minutes):
    short, long = peaks(tmp_path / "short", 2), peaks(tmp_path / "long", minutes)
    for name, found in long.items():
        print(f"{name}, {minutes} min: {found['MB']:.0f} MB at most, {found['CPU s']:.0f} CPU s; "
              f"2 min: {short[name]['MB']:.0f} MB, {short[name]['CPU s']:.0f} CPU s")  # fmt: skip
        assert found["MB"] < short[name]["MB"] + MORE[name]
        assert found["CPU s"] < 1.5 * minutes / 2 * short[name]["CPU s"]


@pytest.mark.slow
def test_a_thousand_walks_take_the_memory_of_twenty(tmp_path):
    """And those that are there already are neither walked again nor lost."""
    course_file(tmp_path, 0.2, "[ranges]\nmu = [0.8, 1.2]\n")

    def peak(seeds: str) -> float:
        said = printed("-c", DATASET, seeds, cwd=tmp_path, timeout=None)
        return float(said.splitlines()[-1])

    few, many = peak("0:20"), peak("0:1000")
    print(f"20 walks: {few:.0f} MB at most, 1000 walks: {many:.0f} MB")
    assert many < few + 100.0
    index = read_index(tmp_path / "walks")
    assert sorted(index.seed) == list(range(1000))
    assert all((tmp_path / "walks" / file).is_file() for file in index.file)


def test_a_long_walk_has_the_row_of_a_short_one(tmp_path, monkeypatch):
    scenario = tmp_path / "laps.toml"
    scenario.write_text(LAP.format(laps=1).replace("20.0", "4.0").replace("10.0", "3.0"))
    simulate.simulate(SimulateSettings([scenario], tmp_path / "whole"))
    monkeypatch.setattr(simulate, "LONG_WALK", 1.0)
    (row,) = simulate.simulate(SimulateSettings([scenario], tmp_path / "pieces"))
    (whole,) = read_index(tmp_path / "whole").to_dict(orient="records")
    # Of less than a minute the facts, too, are those of the whole.
    known = {name: value for name, value in vars(row).items() if value == value}  # not NaN
    assert known == {name: whole[name] for name in known}
    assert LogReader(tmp_path / "pieces" / row.file).rows == round(500 * row.duration)
