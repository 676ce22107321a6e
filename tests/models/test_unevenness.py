"""Rough ground is told by the footholds; planes, constants of legs and a few edges are none."""

import numpy as np
import pytest

from surefoot.models.residuals.feet import unevenness


def footholds(seed, rough):
    rng = np.random.default_rng(seed)
    leg = np.tile(np.arange(4), 100)
    xy = np.column_stack(
        [np.repeat(0.05 * np.arange(100), 4), 0.2 * (leg % 2) + 0.02 * rng.normal(size=400)]
    )
    z = 0.2 * xy[:, 0] - 0.1 * xy[:, 1] + rough * rng.normal(size=400)
    return np.column_stack([xy, z]), leg


@pytest.mark.parametrize("rough", [0.002, 0.01])
def test_the_deviation_is_found_on_a_slope(rough):
    holds, leg = footholds(0, rough)
    assert unevenness(holds, leg) == pytest.approx(rough, rel=0.15)


def test_constants_of_legs_and_a_step_are_no_rough_ground():
    holds, leg = footholds(1, 0.0)
    holds[:, 2] += 0.01 * (leg == 2) + 0.1 * (holds[:, 0] > 2.5)
    assert unevenness(holds, leg) < 0.002


def test_too_few_footholds_show_nothing():
    holds, leg = footholds(2, 0.01)
    assert unevenness(holds[:3], leg[:3]) == 0.0
