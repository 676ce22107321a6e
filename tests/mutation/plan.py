"""The plan of the mutants, `plan.toml`, and those that it draws."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from mutate import Mutant, mutants_of

from surefoot.sim.common.toml import read_typed

HERE = Path(__file__).resolve().parent
PLAN = HERE / "plan.toml"


@dataclass(frozen=True)
class Plan:
    """Fields as `plan.toml` explains them."""

    seed: int
    mutants: int
    each: int
    files: list[str]
    tests: list[str]
    nearest: int
    longest_test: float
    longest_file: float
    budget: float
    patience: float
    grace: float
    memory: int


def read_plan(path: Path = PLAN) -> Plan:
    return read_typed(path, Plan, "plan")


def drawn(plan: Plan, root: Path) -> list[Mutant]:
    """The mutants of a plan, in turns over the files, so that the first of them are a fair sample
    of all: each file by its share, none sooner by its name or size.

    A mutant is drawn by the digest of the seed and its key, so that a line that changes redraws
    no other.
    """
    files = sorted({path for pattern in plan.files for path in root.glob(pattern)})
    ranked: dict[str, list[Mutant]] = {}
    for path in files:
        name = path.relative_to(root).as_posix()
        every = mutants_of(name, path.read_bytes())
        if every:
            ranked[name] = sorted(every, key=lambda mutant: _rank(plan.seed, mutant))
    shares = quotas({name: len(every) for name, every in ranked.items()}, plan.mutants, plan.each)
    turns = [
        ((place + _uniform(plan.seed, mutant)) / shares[name], mutant.key, mutant)
        for name, every in ranked.items()
        for place, mutant in enumerate(every[: shares[name]])
    ]
    return [mutant for *_, mutant in sorted(turns, key=lambda turn: turn[:2])]


def quotas(counts: dict[str, int], total: int, each: int) -> dict[str, int]:
    """How many of each file: `each`, and of what is left a share by its count, largest
    remainders first."""
    total = min(total, sum(counts.values()))
    shares = {name: min(each, count) for name, count in counts.items()}
    left = total - sum(shares.values())
    spare = {name: counts[name] - shares[name] for name in counts}
    exact = {name: left * n / max(sum(spare.values()), 1) for name, n in spare.items()}
    shares = {name: shares[name] + int(exact[name]) for name in counts}
    rest = sorted(counts, key=lambda name: (int(exact[name]) - exact[name], name))
    for name in rest[: total - sum(shares.values())]:
        shares[name] += 1
    return shares


def _uniform(seed: int, mutant: Mutant) -> float:
    """From 0 to 1, by other digits than those of its rank."""
    return int(_rank(seed, mutant)[-8:], 16) / 16**8


def _rank(seed: int, mutant: Mutant) -> str:
    return hashlib.sha256(f"{seed}|{mutant.key}".encode()).hexdigest()
