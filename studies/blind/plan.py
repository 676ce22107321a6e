"""Plan of the blind study, `study.toml`, and the cases drawn from it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from studies.blind.outside_effects import OUTSIDE_EFFECTS
from surefoot import Robot
from surefoot.extend import Effect, effect, known_effects, read_toml

PLAN = Path(__file__).with_name("study.toml")
ROBOTS = PLAN.with_name("robots")


@lru_cache(maxsize=16)
def study_robot(name: str) -> Robot:
    """A robot of the study's own folder, or else a known one."""
    own = ROBOTS / f"{name}.xml"
    return Robot.load(str(own) if own.is_file() else name)


@dataclass(frozen=True)
class Case:
    """One log: its kind, walk and undeclared effects."""

    number: int
    kind: str  # single, clean, outside, together, twins, exact, late, large
    robot: str
    seed: int
    effects: tuple[Effect, ...] = ()
    twin: str = ""
    standing: bool = False
    ground: str = ""  # of the walk, if it is not the course of its seed


def draw_cases(plan: Mapping[str, Any]) -> list[Case]:
    """Draw every case of a plan from its seed."""
    rng = np.random.default_rng(plan["seed"])
    walks = [(r, s) for s in plan["walk"]["seeds"] for r in plan["walk"]["robots"]]
    known = [name for name in known_effects() if name in plan.get("sizes", ())]
    found: list[Case] = []

    def add(kind: str, effects: Sequence[Effect] = (), **more) -> None:
        robot, seed = walks[len(found) % len(walks)]
        found.append(Case(len(found), kind, robot, seed, tuple(effects), **more))

    def drawn(name: str, sizes: Sequence[float], of_group: bool = False) -> Effect:
        robot, _ = walks[len(found) % len(walks)]
        return _draw_effect(name, sizes, rng, study_robot(robot), of_group)

    # Interleaved, so that an interrupted study has covered all kinds equally.
    for turn in range(plan["each"]):
        for name in known:
            add("single", [drawn(name, plan["sizes"][name], turn in plan["group_turns"])])
        for _ in range(_count_in_turn(plan["clean"], turn, plan["each"])):
            add("clean")
        for k in range(_count_in_turn(plan["outside"] * len(OUTSIDE_EFFECTS), turn, plan["each"])):
            name = list(OUTSIDE_EFFECTS)[(turn + k) % len(OUTSIDE_EFFECTS)]
            add("outside", [drawn(name, plan["outside_sizes"][name])])
        for _ in range(_count_in_turn(plan["together"], turn, plan["each"])):
            first, second = rng.choice(known, 2, replace=False)
            add("together", [drawn(n, plan["sizes"][n]) for n in (first, second)])
        for k in range(_count_in_turn(plan["confounded"], turn, plan["each"])):
            pair = plan["twins"][(turn + k) % len(plan["twins"])]
            name, target = pair["of"][0].split()
            one = effect(name, target, np.exp(rng.uniform(*np.log(pair["size"]))))
            add("twins", [one], twin=pair["of"][1], standing=True)
    for turn in range(plan.get("exact", 0)):
        add("exact", ground=plan["grounds"][turn % len(plan["grounds"])])
    for turn in range(plan.get("late", 0)):
        late = plan["lateness"][turn % len(plan["lateness"])]
        add("late", [effect("joint_delay", "all", late)])
    twice = {name: 2.0 * high for name, (_, high) in read_toml(PLAN, "study")["sizes"].items()}
    suited = [name for name, size in twice.items() if size < known_effects()[name].bounds[1]]
    for name in rng.choice(suited, plan.get("large", 0), replace=False):
        add("large", [drawn(name, [twice[name], twice[name]])])
    return found


def _count_in_turn(count: int, turn: int, turns: int) -> int:
    """Number of cases in this turn if `count` are spread evenly over `turns`."""
    return count * (turn + 1) // turns - count * turn // turns


def _draw_effect(
    name: str, size: Sequence[float], rng: np.random.Generator, robot: Robot, of_group: bool
) -> Effect:
    """Draw size, sign and target of an effect; the target is a group of parts if requested and
    possible.

    Args:
        name: of the effect.
        size: ends of its range.
        rng: random generator.
        robot: that has it; targets on which it is equivalent to another effect are not drawn.
        of_group: whether the target is a group.
    """
    known = known_effects()
    kind = known[name] if name in known else OUTSIDE_EFFECTS[name]
    value = float(np.exp(rng.uniform(*np.log(size))))
    sign = rng.choice([-1.0, 1.0])
    several = tuple(kind.group_targets(robot.limbs)) if of_group else ()
    single = [t for t in kind.single_targets(robot.limbs) if not kind.equals_another(t, robot)]
    target = str(rng.choice(several or single))
    # Delays are never negative.
    both = kind.bounds[0] < 0 and not name.endswith("_delay")
    return kind(target, sign * value if both else value)
