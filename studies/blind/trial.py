"""One case of the blind study: simulate its walk and trace it."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from studies.blind.plan import PLAN, Case, study_robot
from studies.walking.grounds import grounds_for
from surefoot import Log, Scenario, walk
from surefoot.extend import Effect, Ground, Patch, Segment, SurefootError, read_toml
from surefoot.models.attribution.diagnose import Diagnosis, diagnose
from surefoot.models.attribution.forces import DRY_FRICTION
from surefoot.models.attribution.noise_floor import ground_of

STANDING_TIME = 20.0
"""Duration of the logs of a standing robot [s], with effects that standing cannot distinguish."""


@lru_cache(maxsize=8)
def ground_and_course(seed: int, standing: bool, plan: Path = PLAN) -> Scenario:
    """The scenario of a seed: random segments, and patches of low friction along the way."""
    w = read_toml(plan, "study")["walk"]
    if standing:
        # A scenario needs a segment; `standing_part` cuts off its steps.
        return Scenario("stand", (Segment(0.5),), Ground(0.8), stand=STANDING_TIME)
    rng = np.random.default_rng([seed, 7])
    segments = tuple(
        Segment(
            duration=rng.uniform(*w["duration"]),
            forward=rng.uniform(*w["forward"]),
            lateral=rng.choice([0.0, 0.08, -0.08]),
            turn=rng.choice([0.0, -1.0, 1.0]) * rng.uniform(*w["turn"]),
        )
        for _ in range(w["stretches"])
    )
    places = rng.uniform(-3.0, 6.0, (w["patches"], 2))
    patches = tuple(Patch(x, y, 1.0, 1.0, rng.uniform(0.15, 0.3)) for x, y in places)
    return Scenario("study", segments, Ground(rng.uniform(*w["mu"]), patches))


def scenario_of(case: Case, plan: Path = PLAN) -> Scenario:
    """The scenario of a case: the course of its seed, or one on another ground."""
    if not case.ground:
        return ground_and_course(case.seed, case.standing, plan)
    if case.ground != "rough":
        return next(s for s in grounds_for(study_robot(case.robot)) if s.name == case.ground)
    course = ground_and_course(case.seed, False, plan)
    rough = read_toml(plan, "study")["rough"]
    return replace(course, ground=ground_of(course.segments, rough, course.ground.mu))


def run_case(case: Case, plan: Path = PLAN) -> dict[str, Any]:
    """Simulate and trace one case of a plan.

    Returns the injected effects, and the verdict, effects and channels found, as plain JSON types.
    """
    record: dict[str, Any] = {
        "number": case.number,
        "kind": case.kind,
        "robot": case.robot,
        "seed": case.seed,
        "effects": [e.as_dict() for e in case.effects],
        "twin": case.twin,
        "ground": case.ground,
    }
    robot = study_robot(case.robot)
    scenario = scenario_of(case, plan)
    try:
        log = walk(scenario, robot, case.seed, case.effects, declared=False)
    except SurefootError as fell:
        return record | {"fell": str(fell)}
    if case.standing:
        log = standing_part(log)
    found = diagnose([log], robot)
    result = found.as_dict()
    kept = ("verdict", "reasons", "rivals", "remainder", "channels", "masked_share")
    record |= {key: result.get(key) for key in kept}
    record["effects_found"] = result["effects"]
    record["over_floor"] = [size_over_floor(found, one) for one in case.effects]
    return record


def standing_part(log: Log) -> Log:
    """The log up to its first step, since a few samples of stepping would distinguish the effects
    that standing cannot.
    """
    still = log.t - log.t[0] < STANDING_TIME - 0.5
    return replace(log, frame=log.frame[still])


def size_over_floor(found: Diagnosis, one: Effect) -> float | None:
    """Ratio of an effect's size to the least size that this log could show; None if unknown.

    For friction, that least size is the share that can be lost before the feet slide. The ratio is
    zero for an effect that is no candidate and leaves no channel above its noise floor.
    """
    if one.name == "foot_slip" and found.friction is not None:
        return one.value / max(1.0 - found.friction.held / DRY_FRICTION, 1e-3)
    rounds = found.attribution.rounds if found.attribution else ()
    for c in rounds[0] if rounds else ():
        if c.key == (one.name, one.target):
            least = c.least
            return abs(one.value) / least if np.isfinite(least) and least > 0 else 0.0
    shown = any(not replace(c, after=c.before).at_floor for c in found.channels.values())
    return None if shown else 0.0
