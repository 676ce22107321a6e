"""A blind study in small: each effect a model can know of, at a drawn size and target, and none."""

import numpy as np
import pytest

from scenarios.trace import diagnose
from sim.effects import CATALOGUE, effect
from sim.robot import Robot
from sim.scenario import Scenario, Segment
from sim.terrain import Ground, Patch
from sim.walk import walk

ROBOT = Robot.load("spot_class")
SIZES = {
    "encoder_offset": (0.01, 0.05),
    "link_length": (0.0033, 0.0099),
    "foot_rolling": (0.003, 0.010),
    "imu_rotation": (0.0175, 0.07),
    "gyro_scale": (0.005, 0.03),
    "joint_delay": (0.002, 0.010),
}


def a_minute(seed):
    rng = np.random.default_rng(seed)
    segments = tuple(
        Segment(
            rng.uniform(3, 7), rng.uniform(0.35, 0.85), rng.choice([0, 0.1, -0.1]),
            rng.choice([0, 0, 0.6, -0.6, 0.4, -0.4]),
        )
        for _ in range(11)
    )  # fmt: skip
    places = rng.uniform(-4, 4, (8, 2))
    patches = tuple(Patch(x, y, 1.5, 1.5, rng.uniform(0.15, 0.3)) for x, y in places)
    return Scenario("minute", segments, Ground(0.8, patches))


def drawn(seed):
    rng = np.random.default_rng([seed, 1])
    names = [None, *SIZES]
    name = names[seed % len(names)]
    if name is None:
        return None
    low, high = np.log(SIZES[name])
    sign = 1.0 if name == "joint_delay" else rng.choice([-1.0, 1.0])
    return effect(name, rng.choice(CATALOGUE[name].targets), sign * np.exp(rng.uniform(low, high)))


@pytest.mark.slow
def test_most_effects_are_named_and_no_walk_is_accused():
    right, accused, sized, cases = 0, 0, 0, 0
    for seed in range(28):
        one = drawn(seed)
        log = walk(a_minute(seed), ROBOT, seed, [one] if one else [], declared=False)
        found = diagnose([log], ROBOT)
        if one is None:
            accused += bool(found.effects)
            continue
        cases += 1
        named = found.effects[0] if found.effects else None
        if named and (named.name, named.target) == (one.name, one.target):
            right += 1
            assert found.attribution is not None
            low, high = found.attribution.found[0].interval
            sized += abs(named.value / one.value - 1) < 0.1 or low < one.value < high
        print(one, found.verdict, found.effects)
    assert accused == 0
    assert right >= 0.9 * cases
    assert sized >= 0.9 * right
