"""Many walks: scenarios times seeds, one log each."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from scenarios.progress import percent_bar
from sim.effects_file import load_effects, save_effects
from sim.errors import SurefootError
from sim.files import refuse_overwrite
from sim.robot import Robot
from sim.scenario import Scenario
from sim.walk import walk


def simulate_all(
    scenarios: Sequence[Path],
    out: Path,
    robot: str | None = None,
    seeds: str = "0",
    effects: Path | None = None,
    undeclared: bool = False,
    force: bool = False,
) -> list[Path]:
    """Walk every scenario with every seed into `out`/<scenario>_<seed>.parquet; returns the files.

    Logs that are there already are left alone (so a killed run goes on where it stopped) unless
    `force`. With `undeclared` the logs say nothing of the effects; truth.toml keeps the answer.
    """
    if not scenarios:
        raise SurefootError("give at least one scenario file")
    numbers = seed_range(seeds)
    chosen = load_effects(effects) if effects else ()
    if undeclared and not chosen:
        raise SurefootError("--undeclared: needs --effects")
    jobs = []
    for path in scenarios:
        scenario = Scenario.load(path)
        name = robot or scenario.robot
        if not name:
            raise SurefootError(f"scenario {path}: names no robot: say which with --robot")
        jobs += [(scenario, Robot.load(name), seed) for seed in numbers]
    if undeclared:
        refuse_overwrite(out / "truth.toml", force)
        save_effects(out / "truth.toml", chosen, force)
    written = []
    for scenario, body, seed in jobs:
        path = out / f"{scenario.name}_{seed}.parquet"
        written.append(path)
        if path.exists() and not force:
            print(f"{path}: is there already")
            continue
        with percent_bar(path.stem) as tell:
            log = walk(scenario, body, seed, chosen, declared=not undeclared, progress=tell)
        replace(log, name=path.stem).write(path, force)
    return written


def seed_range(text: str) -> range:
    """`5` or `0:8` as a range. Raises SurefootError for anything else."""
    first, _, last = text.partition(":")
    try:
        start = int(first)
        end = int(last) if last else start + 1
    except ValueError:
        raise SurefootError(f"--seeds {text}: give a number, or a range such as 0:8") from None
    if start < 0 or end <= start:
        raise SurefootError(f"--seeds {text}: the range is empty or negative")
    return range(start, end)
