"""Long walks, simulated and recorded in pieces with the memory of one piece.

The rows are equal to those of a walk simulated at once.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import pandas as pd

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import Effect
from surefoot.sim.gait.course import course_pieces
from surefoot.sim.physics.scene import TIMESTEP
from surefoot.sim.physics.stepper import STEPS_PER_TICK, TICK, simulate_in_pieces
from surefoot.sim.walk import PIECE_TICKS, SETTLING_TIME, Plan, Sensing

LONG_WALK = 1800.0
"""Duration from which a walk is simulated in pieces [s]; at once it would take gigabytes."""


def needs_whole(made: Plan) -> str:
    """Why a walk cannot be simulated in pieces; "" if it can."""
    altering = [
        effect.name
        for effect in made.effects
        if type(effect).alter_streams is not Effect.alter_streams
        or type(effect).alter_reference is not Effect.alter_reference
    ]
    if altering:
        return f"effect {altering[0]} alters whole streams"
    rate = made.scenario.sensors.rate
    if rate and rate < 1.0 / TIMESTEP:
        return f"[sensors] rate is not the simulation's, {1.0 / TIMESTEP:g} Hz"
    if len(made.gait.velocity_error) or len(made.gait.attitude_error):
        return "[gait] the errors of the controller's estimate are drawn for a whole walk"
    return ""


def walk_in_pieces(
    made: Plan, progress: Callable[[float], None] | None = None, ticks: int = PIECE_TICKS
) -> Iterator[pd.DataFrame]:
    """Yield the rows of the planned walk's log, equal to those of `sim.walk.record`, in pieces.

    Raises Fallen after the last row before a fall, and SurefootError with the reason of
    `needs_whole`.

    Args:
        made: the plan.
        progress: called with the share done.
        ticks: of the controller, in a piece.
    """
    if why := needs_whole(made):
        raise SurefootError(f"scenario {made.scenario.name}: cannot be walked in pieces: {why}")
    sensing = Sensing(made, made.ticks * STEPS_PER_TICK - round(SETTLING_TIME / TIMESTEP))
    pieces = course_pieces(made.commands, TICK, ticks)
    for motion in simulate_in_pieces(made.world, made.robot, made.gait, pieces, made.seconds):
        if progress:
            progress(min(motion.t[-1] / made.seconds, 1.0))
        begins = motion.t[0] <= SETTLING_TIME
        motion = (
            motion.after(SETTLING_TIME) if begins else replace(motion, t=motion.t - SETTLING_TIME)
        )
        if len(motion.tau):
            yield sensing.of(motion)
