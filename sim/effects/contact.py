"""Effects of the ground below the feet, and of how the feet sense it.

A foot's pad and switch make its contacts begin or end late, or begin early. A contact begins late
because the load must first compress the pad by a certain impulse. It ends late because the unloaded
pad recovers slowly: the reading falls with a first-order lag down to the threshold. It begins early
if a long, soft pad touches the ground before the foot is loaded. The delay thus varies from step to
step.
"""

from dataclasses import replace

import numpy as np

from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import kernel
from surefoot.sim.effects.base import Effect, Prior, Traced, declared_on
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.log.schema import named_columns
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.sensors.stances import swings
from surefoot.sim.sensors.streams import Streams


class FootSlip(Effect):
    """The ground has less friction than declared: every coefficient is reduced by this share.

    No model compensates it, since friction has no influence below its limit. Sliding feet under
    load reveal it, which `trace` uses for an estimate (`models.attribution.forces`); stances that
    slide are masked.
    """

    unit = "ratio"
    bounds = (0.0, 0.95)
    targets = ("all",)
    traced = Traced(channels=("leg_velocity",))

    def alter_ground(self, ground: Ground) -> Ground:
        return ground.with_friction(1.0 - self.value)


class SoftGround(Effect):
    """The ground is soft: the time constant of its contacts is larger by this size.

    The size is added to the time constant of MuJoCo's `solref`. A landing foot sinks and is pushed
    back within a few time constants, to an equilibrium depth that grows with their square. The
    model predicts the depth and velocity of each foot from its touchdowns and load
    (`models.residuals.soft_ground`).
    """

    unit = "s"
    bounds = (0.0, 0.2)
    targets = ("all",)
    traced = Traced(
        channels=("foot_height", "leg_velocity"),
        step=1e-3,
        starts=(0.015, 0.03, 0.06),
        motion="walk on hard ground",
    )

    def alter_ground(self, ground: Ground) -> Ground:
        return replace(ground, softness=ground.softness + self.value)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log, declared_on(robot, softness=self.value)


class ContactDelay(Effect):
    """The feet's contacts begin or end late by this mean time; a negative size means that they
    begin early.

    Caused by a foot's pad and switch, whose delay depends on the load at each step; the mean over
    all steps is the size. A long, soft pad touches before the foot stands. A contact that ends
    early is harmless, since an unloaded foot stands still for a while.
    """

    unit = "s"
    bounds = (-0.05, 0.15)
    targets = ("touchdown", "liftoff")
    traced = Traced(
        channels=("contact_timing",),
        # Less than a row: with every row, some bouncing contacts appear and some vanish.
        step=1e-3,
        belongs_to="sensor",
        needs=("contact", "reference"),
        on_given_feet=True,
        prior=Prior(0.08, "no figure found: filters of 10 Hz, debouncing, foam that springs back"),
        motion="change the gait's frequency and speed",
    )

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        threshold = streams.contact_threshold * robot.mass * GRAVITY
        loads = streams.t, streams.force, threshold
        if self.value < 0.0:
            return replace(streams, force=begin_early(*loads, -self.value))
        force = late_contacts(*loads, self.value, begins=self.target == "touchdown")
        return replace(streams, force=force)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        undone = self.value
        if self.target == "touchdown":
            # Debouncing has already removed a part of an early beginning. A late beginning is not
            # undone: a foot that stood before it was sensed does no harm, but each step has a delay
            # of its own, and stances extended by the mean would begin in the air.
            undone = min(undone + log.meta.model.get("contact_debounce", 0.0), 0.0)
        rows, contact = int(undone * log.rate), log.contact.copy()
        for leg in range(contact.shape[1] if rows else 0):
            lifts, lands = swings(log.t, log.contact[:, leg])
            for edge in lands if self.target == "touchdown" else lifts:
                contact[max(edge - max(rows, 0), 0) : edge + max(-rows, 0), leg] = False
        columns = named_columns("contact", contact.astype(float), log.legs)
        # The part that is not undone in the log is declared in the model.
        known = declared_on(robot, **{f"{self.target}_late": self.value - rows / log.rate})
        return log.with_columns(columns), known

    @classmethod
    def traced_at(cls, target: str) -> Traced:
        # The part of each stance before a late touchdown is lost.
        return replace(cls.traced, lossy=target == "touchdown")

    @classmethod
    def is_always_present(cls, target: str, robot: Robot) -> bool:
        # A pad takes some time to spring back and cross a threshold.
        return target == "liftoff" and not robot.extras.liftoff_late

    @classmethod
    def bounds_on(cls, limbs: Limbs | None, target: str | None = None) -> tuple[float, float]:
        low, high = super().bounds_on(limbs, target)
        # No foot is sensed to lift off before it does.
        return (0.0 if target == "liftoff" else low), high


TOUCHING = 1.5
"""Load on a pad that only touches, as a multiple of its threshold."""


RECOVERY = 0.03
"""Time constant of a compressed pad's recovery in the air [s], shorter than any swing."""


def late_contacts(
    t: np.ndarray, force: np.ndarray, threshold: float, late: float, begins: bool
) -> np.ndarray:
    """Readings (N, L) [N] of feet whose contacts begin late, or end late, on pads whose size is
    found by bisection.

    Args:
        t: (N,) [s].
        force: loads on the feet (N, L) [N].
        threshold: of contact [N].
        late: mean delay over all steps [s].
        begins: whether contacts begin late, or end late.
    """
    dt = float(np.median(np.diff(t)))
    keep, most = float(np.exp(-dt / RECOVERY)), dt * len(t)
    if begins:
        most = dt * float(force.max(initial=0.0)) * len(t)

    def read(size: float) -> np.ndarray:
        if begins:
            return _squeezed(force, dt, threshold, size, keep)
        return _springs_back(force, float(np.exp(-dt / size)))

    edges = [swings(t, stands)[begins] for stands in (force > threshold).T]
    low, high = 1e-9 * most, most
    if not late or not sum(map(len, edges)):
        return read(low)
    while high / low > 1.001:
        size = np.sqrt(low * high)
        stands = read(size) > threshold
        behind = [_first(stands[:, leg], rows, begins) - rows for leg, rows in enumerate(edges)]
        mean = dt * float(np.mean(np.concatenate(behind)))
        low, high = (size, high) if mean < late else (low, size)
    return read(low)


def begin_early(t: np.ndarray, force: np.ndarray, threshold: float, early: float) -> np.ndarray:
    """Readings (N, L) [N] of feet whose contacts begin early; arguments as of `late_contacts`."""
    read, rows = force.copy(), round(early / float(np.median(np.diff(t))))
    for leg, stands in enumerate((force > threshold).T):
        for land in swings(t, stands)[1]:
            before = slice(max(land - rows, 0), land)
            read[before, leg] = np.maximum(read[before, leg], TOUCHING * threshold)
    return read


def _first(stands: np.ndarray, rows: np.ndarray, what: bool) -> np.ndarray:
    """For each of `rows` (K,), the first row from it on at which `stands` (N,) equals `what`; N
    if none.
    """
    at = np.append(np.flatnonzero(stands == what), len(stands))
    return at[np.searchsorted(at, rows)]


@kernel
def _squeezed(force, dt, threshold, impulse, keep):
    """The loads (N, L) of feet whose pads are compressed, zero for the others. Feet that stand in
    the first row are compressed.

    Args:
        force: (N, L) [N].
        dt: time between rows [s].
        threshold: of contact [N].
        impulse: that closes the switch [N s].
        keep: share of it that remains after a row in the air.
    """
    out = force.copy()
    for leg in range(force.shape[1]):
        got = impulse if force[0, leg] > threshold else 0.0
        for k in range(1, len(force)):
            if force[k, leg] > threshold:
                got = min(got + dt * force[k, leg], impulse)
                if got < impulse:
                    out[k, leg] = 0.0
            else:
                got *= keep
    return out


@kernel
def _springs_back(force, keep):
    """The loads (N, L), with a first-order lag where they fall: a share `keep` of the difference
    remains after each row.
    """
    out = force.copy()
    for leg in range(force.shape[1]):
        for k in range(1, len(force)):
            behind = out[k - 1, leg] - force[k, leg]
            if behind > 0.0:
                out[k, leg] += keep * behind
    return out
