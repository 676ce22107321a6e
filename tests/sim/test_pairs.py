"""Effects combine: any two, in either order, in the simulated robot, its streams and its model."""

import numpy as np
import pytest

from surefoot.sim.effects import CATALOGUE, compensate_all, effect
from surefoot.sim.effects.base import Effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.physics.scene import robot_spec
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import find_legs
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.streams import Reference, Streams
from surefoot.sim.walk import walk

SPOT = Robot.load("spot_class")


def sized(name: str) -> Effect:
    """A tenth of the way to the upper bound, on the last single target: a foot's end of a leg."""
    kind = CATALOGUE[name]
    return effect(name, kind.single_targets(SPOT.limbs)[-1], 0.1 * kind.bounds[1])


EFFECTS = {n: sized(n) for n, kind in CATALOGUE.items() if kind.single_targets(SPOT.limbs)}
BODILY = [n for n in EFFECTS if type(EFFECTS[n]).edit_spec is not Effect.edit_spec]


@pytest.fixture(scope="module")
def log() -> Log:
    log = walk(Scenario("step", (Segment(1.0, 0.3),), Ground(0.8), stand=0.1), SPOT, seed=1)
    return log.rows(slice(None, None, 5))


def without_order(model) -> tuple:
    """What a compiled robot is, whatever the order of what was done to it."""
    legs = find_legs(model, "spot").constants
    numbers = (model.body_mass, model.dof_armature, model.jnt_stiffness, model.actuator_delay)
    return (
        *(np.round(part, 9) for part in (legs.offset, legs.foot, legs.rotation)),
        *(np.sort(np.round(part.ravel(), 9)) for part in numbers),
    )


@pytest.mark.parametrize("first", BODILY)
def test_a_robot_may_have_any_two_in_either_order(first):
    for second in BODILY[: BODILY.index(first) + 1]:
        built = []
        for names in ((first, second), (second, first)):
            spec = robot_spec(SPOT)
            for name in names:
                EFFECTS[name].edit_spec(spec, SPOT)
            built.append(spec.compile())
        one, other = map(without_order, built)
        # A leg that is turned and then longer is not quite one that is longer and then turned.
        exact = "link_length" not in names or "leg_heading" not in names
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-9 if exact else 1e-3)


@pytest.mark.parametrize("first", EFFECTS)
def test_streams_and_models_bear_any_other_effect_after_it(log, first):
    v_GI = log.frame[["ref_v_x", "ref_v_y", "ref_v_z"]].to_numpy()
    streams = (log.t, log.gyro, log.accel, log.q, log.dq, log.tau, log.tau_ff, log.force)
    seen = EFFECTS[first].alter_streams(Streams(*streams), SPOT)
    mounted = EFFECTS[first].alter_mounting(SPOT)
    reference = EFFECTS[first].alter_reference(Reference(log.t, log.ref_R_GI, log.ref_p, v_GI))
    after = compensate_all([EFFECTS[first]], log, SPOT)
    for second in EFFECTS.values():
        altered = vars(second.alter_streams(seen, SPOT))
        assert all(np.isfinite(part).all() for part in altered.values())
        assert np.isfinite(second.alter_mounting(mounted).p_BI).all()
        assert np.isfinite(second.alter_reference(reference).p_GI).all()
        known, robot = compensate_all([second], *after)
        assert np.isfinite(known.frame.to_numpy()).all(), second.name
        assert np.isfinite(robot.feet_I(known.q)).all()
