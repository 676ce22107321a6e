"""What `trace` needs to know of an effect, beside how a model compensates it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Prior:
    """Prior of an effect's size, in the effect's unit.

    Attributes:
        within: bound on the magnitude for 19 of 20 machines.
        source: of that figure.
        most: magnitude beyond which the size is implausible for any machine, so that another cause
            must explain the residual: three times the limit of a working sensor's data sheet.
    """

    within: float
    source: str
    most: float = np.inf


@dataclass(frozen=True)
class Traced:
    """How `trace` looks for an effect.

    Attributes:
        channels: residual channels that the effect can change.
        step: of numerical derivatives with respect to the size, in its unit; required if a model
            can compensate the effect.
        prior: of the size; without one, any size within the bounds is equally plausible.
        belongs_to: what has the effect: the machine; a sensor, whose error is no change of the
            machine; or a run, in which a zero, bias or clock has a size of its own.
        motion: that tells the effect from others.
        needs: groups of a log's columns, as for `Log.require`, that `compensate` needs beyond those
            of its channels.
        bounds_on_legs: narrower bounds on a machine with legs, whose parts are small.
        starts: initial sizes for a search, where the residual is far from linear in the size; by
            default one step.
        chain_rule: the only quantities that `compensate` changes, so that derivatives of the
            residual may use the chain rule: "readings" (columns of gyro, accel, q, dq, tau), "legs"
            (leg geometry and foot radius) or "mass" (inertial parameters). None: finite differences
            of the residual, valid for any effect.
        lossy: whether compensation degrades the readings, by interpolation of streams shifted in
            time or by the noise of a derivative.
        uses_loads: whether `compensate` takes the loads of joints or feet from the log, in which
            all other effects must be compensated before.
        unseen_by: residual channels whose readings are not compensated. A spring's compensation
            replaces the encoders' angles by those of a rigid leg with the feet at their actual
            positions; the motors, and the links if only the feet yield, remain at the encoders'
            angles.
        on_given_feet: whether `compensate` also works for a machine that is known by its feet alone
            (`sim.robot.given_feet`), by changing the readings or `extras` only.
        by_search: whether the search over residuals fits the size; False where it has an estimate
            of its own.
        spread: relative spread of the size between parts of one kind, at 95 %, of an effect that
            machines have by construction; None if it may be on any part alone.
        scales_with: what a size measured on one robot is multiplied by for another: what its unit
            says (`carry.DIMENSIONS`), or the radius of the foot.
    """

    channels: tuple[str, ...] = ()
    step: float = 0.0
    prior: Prior | None = None
    belongs_to: Literal["machine", "sensor", "run"] = "machine"
    motion: str = "more varied motion"
    needs: tuple[str, ...] = ()
    bounds_on_legs: tuple[float, float] | None = None
    starts: tuple[float, ...] = ()
    chain_rule: Literal["readings", "legs", "mass"] | None = None
    lossy: bool = False
    uses_loads: bool = False
    unseen_by: tuple[str, ...] = ()
    on_given_feet: bool = False
    by_search: bool = True
    spread: float | None = None
    scales_with: Literal["unit", "foot_radius"] = "unit"


NO_FIGURE_OF_DRIVES = "no figure found: wide for legs; large arms may have more"
"""Source of priors of drives for which none was found."""
