"""Checks of the drives of a machine on a fixed base.

Torques are compared with inverse dynamics along the motion, commanded angles with the measured
ones, in the same way: sign, scale, and whether the stream goes on where what it explains does.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from surefoot.sim.importing.advice import entries, scaled
from surefoot.sim.plausibility.axes import HARDLY, LIKELY, correlation, sign_change
from surefoot.sim.plausibility.causes import of_changing_sign
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.streams import LIMITED, still_sections
from surefoot.sim.plausibility.view import LogView

DRIVEN = (0.4, 2.0)
"""Range of the scale relative to what is expected: measured drives have 0.6 to 1.3, because of
friction and inaccurate published masses; a torque of the motor's side is smaller by the gear ratio.
"""
STRAYS = 3.0
"""Ratio to the usual error from which a constant torque or command is stuck."""
SLIDES = 0.05
"""Rate below which dry friction does not reach its full size [rad/s]."""
MOVE = 0.5
"""Time over which moves of a joint are compared with those of its command [s]; servos are 0.1 s
late.
"""
COMMANDED = 1.0
"""Time without a change of a command, while its joint moves, from which it is stuck [s]."""


@dataclass(frozen=True)
class _Explained:
    """A stream of a joint, and what explains it.

    Attributes:
        column: its name.
        x: mean values (M,).
        expected: (M,) in the same unit, but for friction or an offset.
        rest: regressors (M, R) of these.
        alike: two series whose correlation has the sign of the stream.
    """

    column: str
    x: np.ndarray
    expected: np.ndarray
    rest: np.ndarray
    alike: tuple[np.ndarray, np.ndarray]

    def fitted(self, where: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, float]:
        """Least-squares fit (M,), and the factor of what is expected, on the times `where`."""
        terms = np.column_stack([self.expected, self.rest])
        sizes = np.linalg.lstsq(terms[where], self.x[where], rcond=None)[0]
        return terms @ sizes, float(sizes[0])

    @property
    def beside_rest(self) -> float:
        """Correlation of stream and expectation without what the rest explains of both."""
        terms = np.column_stack([self.rest, np.ones(len(self.x))])
        both = np.column_stack([self.x, self.expected])
        x, expected = (both - terms @ np.linalg.lstsq(terms, both, rcond=None)[0]).T
        return correlation(x, expected)

    def stuck(self, view: LogView, least: float) -> str:
        """The first section of at least `least` [s] in which it does not change, while what
        explains it does, in words; "" where there is none.
        """
        rows = still_sections(view.t, view.log.frame[self.column].to_numpy(), least)
        for begin, end in (view.t[[one.start, one.stop - 1]] for one in rows):
            # After a step of a command, a joint is still moving.
            during = (view.at > begin + 0.25 * least) & (view.at < end)
            outside = (view.at < begin) | (view.at > end + 0.25 * least)
            if min(during.sum(), outside.sum()) < 3:
                continue
            fitted = self.fitted(outside)[0]
            missed = (self.x - fitted) ** 2
            least_missed = STRAYS**2 * missed[outside].mean()
            if min(missed[during].mean(), np.ptp(fitted[during]) ** 2) > least_missed:
                return f"no change from {begin:.2f} to {end:.2f} s"
        return ""


@plausibility_rule("torques of a fixed base", "t q tau", when="comparable")
def driving(view: LogView) -> Iterator[Finding]:
    """Check that the torques of drives on a fixed base explain its motion.

    Compares: torques with what the machine's model asks for along the motion, and friction
        beside it.
    Threshold: correlation below -{HARDLY:g}; a sign that changes on the way; not
        {DRIVEN[0]:g} to {DRIVEN[1]:g} times as large; no change for {LIMITED:g} s while
        {STRAYS:g} times as much is missed as else.
    Reason: three measured machines have 0.6 to 1.3 times what their models ask for.
    Remedy: sign, unit or gain of tau; torques of the output, not of the motor.
    """
    log, machine = view.log, view.machine
    if machine is None or machine.dynamics is None or not machine.fixed:
        return
    if any(d.startswith("tau") for d in log.meta.derived):
        return
    tau, dq = view.means(log.tau), view.changes(log.q)
    rigid = machine.dynamics.inverse(view.means(log.q), dq, np.gradient(dq, view.at, axis=0))[1]
    for j, joint in enumerate(log.joints):
        friction = np.column_stack([np.tanh(dq[:, j] / SLIDES), dq[:, j]])
        both = tau[:, j], rigid[:, j]
        one = _Explained(f"tau_{joint}", *both, friction, both)
        if stuck := one.stuck(view, LIMITED):
            seen = f"{stuck} while what it drives goes on"
            yield Finding((one.column,), seen, "a sensor that hangs")
        else:
            cause = "another unit, of the motor's side, or a load that the model lacks"
            yield from _faults(view, one, "what the model asks for", cause)


@plausibility_rule("commands of a fixed base", "t q q_des", when="comparable")
def followed(view: LogView) -> Iterator[Finding]:
    """Check that the joints of a machine on a fixed base follow their commands.

    Compares: q_des with q, joint by joint, and their moves within {MOVE:g} s.
    Threshold: correlation below -{HARDLY:g}; a sign that changes on the way; not
        {DRIVEN[0]:g} to {DRIVEN[1]:g} times as far; no change for {COMMANDED:g} s while the
        joint goes {STRAYS:g} times as far off as else.
    Reason: nothing but its drive moves a joint of an arm as far.
    Remedy: sign, unit or gain of q_des.
    """
    log = view.log
    if not view.on_fixed_base:
        return
    q, asked = view.means(log.q), view.means(log.q_des)
    half = 0.5 * MOVE
    moved, sent = (view.after(x, half) - view.after(x, -half) for x in (log.q, log.q_des))
    offset = np.ones((len(q), 1))
    for j, joint in enumerate(log.joints):
        both = asked[:, j], q[:, j]
        one = _Explained(f"q_des_{joint}", *both, offset, (sent[:, j], moved[:, j]))
        if stuck := one.stuck(view, COMMANDED):
            seen = f"{stuck} while q_{joint} goes on"
            yield Finding((one.column,), seen, "a command that was not logged")
        else:
            yield from _faults(
                view, one, f"the moves of q_{joint}", "another unit than its angle's"
            )


def _faults(view: LogView, one: _Explained, expected: str, other: str) -> Iterator[Finding]:
    """Check sign and scale of a stream; `other` is the cause of another scale."""
    if not (one.x.std() > 0.0 and one.expected.std() > 0.0):
        return
    fitted, scale = one.fitted()
    alike, when = correlation(*one.alike), sign_change(view.at, *one.alike, LIKELY)
    # What is expected alone is inconclusive for a machine that pushes against something.
    explained = correlation(one.x, fitted) > LIKELY
    column = (one.column,)
    if when is not None:
        yield of_changing_sign(one.column, when, expected)
    elif explained and alike < -HARDLY:
        seen = f"correlation with {expected} {alike:.2f}"
        yield Finding(column, seen, "wrong sign", entries(column, sign=-1.0))
    elif explained and abs(one.beside_rest) > LIKELY and not DRIVEN[0] < scale < DRIVEN[1]:
        yield Finding(column, f"{scale:.3g} times {expected}", other, scaled(one.column, scale))
