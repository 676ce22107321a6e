"""Attitudes between rows, against scipy's."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation, Slerp

from surefoot.sim.common.quaternion import slerp


@pytest.mark.parametrize("turn", [0.0, 1e-9, 1e-4, 0.3, 2.5])
def test_slerp_turns_evenly_the_short_way_round(turn):
    rng = np.random.default_rng(1)
    steps = Rotation.from_rotvec(turn * rng.uniform(-0.7, 0.7, (200, 3)))
    attitudes = [Rotation.identity()]
    for step in steps:
        attitudes.append(attitudes[-1] * step)
    rotations = Rotation.concatenate(attitudes)
    t = np.cumsum(rng.uniform(0.5, 2.0, len(rotations)))
    # Signs as a recording may have them, and rows themselves among the times.
    q = rotations.as_quat(scalar_first=True) * rng.choice([-1.0, 1.0], (len(t), 1))
    then = np.sort(np.concatenate([rng.uniform(t[0], t[-1], 500), t]))
    found = slerp(t, q, then)
    wanted = Slerp(t, rotations)(then)
    apart = wanted.inv() * Rotation.from_quat(found, scalar_first=True)
    assert_allclose(apart.magnitude(), 0.0, atol=1e-14)
    assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-15)
    assert np.all(found[:, 0] >= 0.0)
