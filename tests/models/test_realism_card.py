"""The realism card: known gaits, feet and vibrations come back as numbers with honest intervals."""

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from refusals import refused
from synthetic import without

from surefoot.models.realism.card import DRAWS, estimate, realism_card, tolerances
from surefoot.models.realism.quantities import (
    FREQUENCIES,
    QUANTITIES,
    bandwidth,
    change_spread,
    line,
    period,
    period_change,
    spectra,
)
from surefoot.models.realism.walk_view import WalkView
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk
from surefoot.sim.walking.imitation import strides

BY_NAME = {quantity.name: quantity for quantity in QUANTITIES}


@pytest.fixture(scope="module")
def log(robot):
    """Steady, then faster."""
    segments = (Segment(5.0, 0.4), Segment(5.0, 0.8))
    return walk(Scenario("steady", segments, Ground(0.8), "spot_class"), robot, 0)


def rng():
    return np.random.default_rng(1)


def number(name, view):
    found, draws = estimate(BY_NAME[name], [view], rng())
    assert draws.shape == (DRAWS,)
    return found, np.percentile(draws, (2.5, 97.5))


def square_wave(periods, duty=0.55, rate=400.0):
    """Contacts of a foot that stands for `duty` of each period [s]."""
    lands = np.cumsum([0.3, *periods])
    t = np.arange(0.0, lands[-1] + 0.3, 1.0 / rate)
    k = np.clip(np.searchsorted(lands, t, side="right") - 1, 0, len(periods) - 1)
    share = (t - lands[k]) / np.asarray(periods)[k]
    return t, (t >= lands[0]) & (share < duty) & (t < lands[-1])


def test_strides_are_those_of_the_contacts_without_bounces_and_pauses():
    periods = [0.5, 0.5, 0.5, 3.0, 0.5, 0.5, 0.5]
    t, stands = square_wave(periods)
    stands[(t > 0.9) & (t < 0.92)] = False  # a bounce
    found = strides(t, stands)
    np.testing.assert_allclose(found[:, 2] - found[:, 0], 0.5, atol=0.006)
    np.testing.assert_allclose((found[:, 1] - found[:, 0]) / 0.5, 0.55, atol=0.02)
    assert len(found) == 5  # the first stance may be cut off, the pause is none, the last is open


def test_jitter_is_what_was_drawn_whatever_the_gait_does_slowly():
    drawn = rng().normal(0.0, 0.03, 400)
    slow = np.linspace(0.4, 0.6, 400)
    t, stands = square_wave(slow * (1.0 + drawn))
    length = np.diff(strides(t, stands)[:, [0, 2]]).ravel()
    changes = np.diff(length) / np.median(length)
    assert change_spread(changes) == pytest.approx(0.03, rel=0.2)


def test_a_robot_as_its_model_says_misses_nothing_and_one_with_point_feet_its_rolling(robot, log):
    share, interval = number("speed missed by standing legs", WalkView(log, robot))
    assert abs(share) < 0.02
    assert interval[0] <= share <= interval[1]
    pointed = replace(robot, foot_radius=np.zeros(4))
    lost, _ = number("speed missed by standing legs", WalkView(log, pointed))
    # A leg of length l turns about its hip and rolls forward by r for each radian: r / l is missed.
    height = -robot.feet_I(robot.q_home[None])[0, :, 2].mean()
    assert lost - share == pytest.approx(robot.foot_radius.mean() / height, rel=0.4)


def test_forces_are_weighed_only_where_they_are_newton(robot, log):
    peak, _ = number("foot force, peak to weight", WalkView(log, robot))
    assert 0.4 < peak < 4.0
    counts = log.frame.assign(
        **{f"force_{leg}": 7.0 * log.frame[f"force_{leg}"] for leg in log.legs}
    )
    view = WalkView(replace(log, frame=counts), robot)
    with pytest.raises(SurefootError, match="not in newton: their mean sum is"):
        number("foot force, peak to weight", view)
    # By its own scale it is the same in any unit.
    own = [number("foot force, peak to middle", w)[0] for w in (view, WalkView(log, robot))]
    assert own[0] == pytest.approx(own[1], rel=1e-9)


def test_a_line_of_the_accelerometer_is_found_where_it_was_put(robot, log):
    rung = log.frame.assign(accel_x=log.frame["accel_x"] + 4.0 * np.sin(2 * np.pi * 31 * log.t))
    values, _ = spectra(WalkView(replace(log, frame=rung), robot), "accel")
    plain, _ = spectra(WalkView(log, robot), "accel")
    assert line(values) == pytest.approx(31.0, abs=1.0)
    added = values.mean(axis=0).sum() - plain.mean(axis=0).sum()
    assert added == pytest.approx(4.0**2 / 2, rel=0.1)


def test_bandwidth_is_where_the_power_ends():
    white = np.where(FREQUENCIES <= 40.0, 1.0, 0.0)[None]
    assert bandwidth(white) == pytest.approx(0.95 * 40.0, abs=1.0)


def test_a_walk_is_like_itself_and_unlike_one_of_another_gait(robot, log):
    view = WalkView(log, robot)
    same = realism_card(view, [view], rng())
    assert all(row.difference == 0.0 for row in same.rows)
    assert "unlike" not in {row.verdict for row in same.rows}
    slow = log.frame.assign(t=1.5 * log.frame["t"])
    stretched = WalkView(
        replace(log, frame=slow, meta=replace(log.meta, rate=log.rate / 1.5)), robot
    )
    rows = {row.quantity: row for row in realism_card(view, [stretched], rng()).rows}
    assert rows["stride period"].verdict == "unlike"
    assert rows["stride period"].simulated == pytest.approx(1.5 * rows["stride period"].measured)
    assert rows["duty factor"].verdict == "like"


def test_what_a_log_lacks_is_named(robot, log):
    view = WalkView(without(log, "force_"), robot)
    card = realism_card(view, [view], rng())
    assert all(why.startswith("log: the log lacks force") for why in card.missing.values())
    assert set(card.missing) == {n for n in BY_NAME if n.startswith("foot force")}
    one_less = without(log, "contact_FL")
    refused(r"the log lacks contact \(contact_FL", WalkView, one_less, robot)
    refused("no foot makes more than", WalkView, log.rows(slice(0, 1500)), robot)


def test_each_quantity_has_a_tolerance_with_its_reason():
    assert list(tolerances()) == list(BY_NAME)
    assert all(len(one.reason) > 9 for one in tolerances().values())


def test_the_interval_covers_the_truth_as_often_as_it_says():
    """Of walks of 40 strides whose mean period is known, 95 % of the intervals hold it."""

    class Drawn:
        def __init__(self, seed):
            self.each = np.random.default_rng(seed).normal(0.5, 0.02, 40)
            self.strides = (np.cumsum([0.0, *self.each]),)

        def stride_of(self, t):
            return np.searchsorted(self.strides[0], t + 1e-9) - 1

    mean = replace(
        BY_NAME["stride period"],
        values=lambda w: (w.each, w.strides[0][:-1]),
        statistic=lambda v: float(v.mean()),
    )
    held = []
    for seed in range(60):
        _, draws = estimate(mean, [cast(WalkView, Drawn(seed))], rng())
        low, high = np.percentile(draws, (2.5, 97.5))
        held.append(low < 0.5 < high)
    assert 0.85 < np.mean(held) <= 1.0


def test_periods_of_a_plain_gait_do_not_jitter(robot, log):
    view = WalkView(log, robot)
    assert change_spread(period_change(view)[0]) < 0.02
    assert np.median(period(view)[0]) == pytest.approx(
        0.5 * np.sqrt(robot.leg_length / 0.66), rel=0.02
    )
