"""Joint torques and foot forces from the momentum of a walk, against those of its motors."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from synthetic import without

from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.physics.loads import momentum_balance
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.stances import inside_stances
from surefoot.sim.walk import walk


@pytest.fixture(scope="module")
def log(robot):
    return walk(Scenario("walk", (Segment(4.0, 0.5, turn=0.3),), Ground(0.8)), robot, seed=2)


def test_torques_are_those_of_the_motors(log, robot):
    """Of loaded joints, but for what feet press against each other and the edges of a stance."""
    found = momentum_balance(log, robot).torque
    stands = inside_stances(log.t, log.contact, 0.05, 0.05)
    rows = log.t - log.t[0] > 1.0
    for leg in range(4):
        use, joints = rows & stands[:, leg], slice(3 * leg, 3 * leg + 3)
        error = found[use, joints] - log.tau[use, joints]
        taken = np.sqrt(np.mean(np.sum(log.tau[use, joints] ** 2, axis=1)))
        assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.1 * taken
        for k in (0, 2):
            assert np.corrcoef(found[use, joints][:, k], log.tau[use, joints][:, k])[0, 1] > 0.9


def test_feet_carry_the_robot_and_nothing_in_the_air(log, robot):
    force = momentum_balance(log, robot).force
    assert_allclose(force[log.force == 0.0], 0.0)
    assert_allclose(momentum_balance(without(log, "force_"), robot).force[~log.contact], 0.0)
    carried = force[log.t - log.t[0] > 1.0].sum(axis=1).mean(axis=0)
    assert_allclose(carried[2], -GRAVITY_G[2] * robot.mass, rtol=0.05)
    assert np.all(np.abs(carried[:2]) < 0.1 * carried[2])


def test_feet_share_the_load_by_their_sensors_in_any_unit_before_they_count_as_standing(log, robot):
    """Of contacts that begin and end at half the load, as those of a pad that is read so."""
    half = 0.5 * np.median(log.force[log.contact])
    delayed = {f"contact_{leg}": 1.0 * (log.force[:, i] > half) for i, leg in enumerate(log.legs)}
    by_counts = {f"force_{leg}": 7.0 + 3.0 * log.force[:, i] for i, leg in enumerate(log.legs)}
    seen = log.with_columns(delayed)
    up_B = log.ref_R_GI[:, 2] @ robot.R_BI.T
    walks = log.t - log.t[0] > 1.0

    def error(one):
        found = np.einsum("nli,ni->nl", momentum_balance(one, robot).force, up_B)
        return np.sqrt(np.mean((found - log.force)[walks] ** 2))

    assert error(seen) < 0.9 * error(without(seen, "force_"))
    in_counts = momentum_balance(seen.with_columns(by_counts), robot).force
    assert_allclose(in_counts, momentum_balance(seen, robot).force, atol=1e-6)
