"""A minute of walking on each kind of ground, scaled to the robot's legs."""

import numpy as np

from surefoot import Robot, Scenario
from surefoot.extend import Ground, Patch, Segment, Strip

SLOPE = np.tan(np.radians(10.0))
MU, ICE = 0.8, 0.15
STEPS, WIDTH, HALF_SIZE = 8, 9.0, 80.0
# Riser and tread as shares of the leg; thick shins and a deep belly need shallower stairs.
SUITED = (0.15, 0.5)
STAIRS = {"hyqreal1": (0.12, 0.6), "hyqreal2": (0.12, 0.6)}


def grounds_for(robot: Robot) -> tuple[Scenario, ...]:
    """Flat with turns, a hill of 10 degrees, a patch of mu 0.15, stairs up and down: 60 s each."""
    leg = robot.leg_length
    v = 0.8 * np.sqrt(leg / 0.66)  # m/s, the same Froude number for all
    turns = (
        Segment(9, v),
        Segment(6, 0.5 * v, turn=0.5),
        Segment(9, 1.1 * v),
        Segment(6, 0.5 * v, turn=-0.6),
    )
    on_ice = (Segment(20, 0.5 * v), Segment(20, 0.4 * v, turn=0.3), Segment(18, 0.6 * v))
    return (
        Scenario("flat, turns", turns, Ground(MU), laps=2),
        Scenario("10 degree slope", (Segment(58, 0.6 * v),), _hill(0.6 * v * 26.0)),
        Scenario("patch of mu 0.15", on_ice, Ground(MU, (Patch(4.0, 0.0, 4.0, 12.0, ICE),))),
        Scenario("stairs", (Segment(58, 0.5 * v),), _stairs(leg, *STAIRS.get(robot.name, SUITED))),
    )


def _hill(side: float) -> Ground:
    """Up over `side` metres of ground, a metre along the top, and down."""
    return _up_and_down(1.0, side, 1.0, side * SLOPE)


def _stairs(leg: float, riser: float, tread: float) -> Ground:
    run, rise = tread * leg * STEPS, riser * leg * STEPS
    return _up_and_down(2.0 * leg, run, 4.0 * leg, rise, STEPS)


def _up_and_down(first: float, side: float, top: float, rise: float, steps: int = 0) -> Ground:
    """A ground that rises, stays level and falls again, along x.

    Args:
        first: length of the level beginning [m].
        side: length of rise and fall [m].
        top: length of the level part between them [m].
        rise: its height [m].
        steps: of a staircase; 0 for a slope.
    """
    a, b, c, d = np.cumsum([first, side, top, side])
    return Ground(
        MU,
        (),
        HALF_SIZE,
        (
            Strip((a, 0.0), (b, 0.0), WIDTH, (0.0, rise), steps=steps),
            Strip((b, 0.0), (c, 0.0), WIDTH, (rise, rise)),
            Strip((c, 0.0), (d, 0.0), WIDTH, (rise, 0.0), steps=steps),
        ),
    )
