"""What a plan of motions says: covariances of known problems, and what only turning shows."""

import numpy as np
import pytest

from surefoot.scenarios import motion_plan
from surefoot.sim.robot import Robot

KEYS = [("one", "x"), ("other", "x")]


def test_an_effect_alone_takes_as_long_as_its_noise_says():
    """One size, seen with deviation s after each SECONDS: n of them give s / sqrt(n)."""
    allowed, s = 1.0, 0.9
    prior = np.array([1.96 / allowed, 1.96 / allowed]) ** 2
    found = motion_plan._shown(np.diag([s**-2, s**-2]), prior, 0, KEYS)
    needed = motion_plan.SECONDS * s**2 * ((motion_plan.SHOWN * allowed) ** -2 - prior[0])
    assert found.seconds == pytest.approx(needed, rel=1e-3)
    assert found.rival is None


def test_two_that_look_alike_hide_each_other():
    """Only their sum is seen: however long, each stays as uncertain as its prior."""
    one = np.ones((2, 2)) * 1e6
    found = motion_plan._shown(one, np.full(2, 1.96**2), 0, KEYS)
    assert not np.isfinite(found.seconds)
    assert found.deviation == pytest.approx(np.sqrt(0.5) / 1.96, rel=1e-2)
    assert found.rival == KEYS[1]
    assert motion_plan.LONGEST_S > motion_plan.SECONDS


def test_each_motion_is_recorded_for_the_target_that_takes_longest_of_those_it_shows_first():
    def shown(seconds):
        return motion_plan.Shown(seconds, 0.05, None)

    found = {
        ("one", "x"): {"stand": shown(np.inf), "walk": shown(12.0)},
        ("one", "y"): {"stand": shown(90.0), "walk": shown(30.3)},
        ("two", "x"): {"stand": shown(0.2), "walk": shown(5.0)},
        ("three", "x"): {"stand": shown(np.inf), "walk": shown(np.inf)},
    }
    assert motion_plan.recordings_to_make(found) == {"walk": 30.3, "stand": 1.0}
    assert "record at least: walk, 31 s; stand, 1 s\n" in motion_plan.plan_text(found)


@pytest.mark.slow
def test_a_scale_about_the_vertical_wants_turning_and_hips_hide_behind_what_turns_their_leg():
    found = motion_plan.plan_motions(Robot.load("spot_class"), ["gyro_scale", "encoder_offset"])
    by_motion = found["gyro_scale", "z"]
    turning = by_motion["walk in circles, both ways"]
    assert turning.deviation < 0.5 * by_motion["walk straight"].deviation
    rows = {row["effect"]: row for row in motion_plan.motion_table(found)}
    hidden_by = str(rows["encoder_offset"]["hidden by"]).split()[0]
    assert hidden_by in {"leg_heading", "mounting_rotation"}
