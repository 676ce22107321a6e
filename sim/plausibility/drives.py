"""Checks of the drives of a machine on a fixed base.

Torques are compared with inverse dynamics along the motion, commanded angles with the measured
ones, in the same way: sign, scale, and whether the stream goes on where what it explains does.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from surefoot.sim.importing.advice import entries, scaled
from surefoot.sim.plausibility.comparison import (
    HARDLY,
    LIKELY,
    match_axes,
    of_changing_sign,
    sign_change,
)
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
        alike: two series (M, 2) whose correlation has the sign of the stream.
        witness: what is expected, in words.
        otherwise: cause of another scale.
    """

    column: str
    x: np.ndarray
    expected: np.ndarray
    rest: np.ndarray
    alike: np.ndarray
    witness: str
    otherwise: str

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
        return _correlation(x, expected)


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
    witness = "what the model asks for"
    otherwise = "another unit, of the motor's side, or a load that the model lacks"
    for j, column in enumerate(view.columns("tau")):
        friction = np.column_stack([np.tanh(dq[:, j] / SLIDES), dq[:, j]])
        both = np.column_stack([tau[:, j], rigid[:, j]])
        one = _Explained(column, *both.T, friction, both, witness, otherwise)
        if stuck := _stuck(view, one, LIMITED):
            seen = f"{stuck} while what it drives goes on"
            yield Finding((column,), seen, "a sensor that hangs")
        else:
            yield from _sign_and_scale(view, one)


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
    if not view.on_fixed_base:
        return
    q, asked = view.means(view.log.q), view.means(view.log.q_des)
    sent, moved = (
        view.after(x, 0.5 * MOVE) - view.after(x, -0.5 * MOVE) for x in (view.log.q_des, view.log.q)
    )
    offset, otherwise = np.ones((len(q), 1)), "another unit than its angle's"
    for j, column in enumerate(view.columns("q_des")):
        angle = column.replace("q_des_", "q_", 1)
        moves = np.column_stack([sent[:, j], moved[:, j]])
        witness = f"the moves of {angle}"
        one = _Explained(column, asked[:, j], q[:, j], offset, moves, witness, otherwise)
        if stuck := _stuck(view, one, COMMANDED):
            yield Finding(
                (column,), f"{stuck} while {angle} goes on", "a command that was not logged"
            )
        else:
            yield from _sign_and_scale(view, one)


def _stuck(view: LogView, one: _Explained, least: float) -> str:
    """The first section of at least `least` [s] in which a stream does not change, while what
    explains it does, in words; "" where there is none.
    """
    rows = still_sections(view.t, view.log.frame[one.column].to_numpy(), least)
    for begin, end in (view.t[[section.start, section.stop - 1]] for section in rows):
        # After a step of a command, a joint is still moving.
        during = (view.at > begin + 0.25 * least) & (view.at < end)
        outside = (view.at < begin) | (view.at > end + 0.25 * least)
        if min(during.sum(), outside.sum()) < 3:
            continue
        fitted = one.fitted(outside)[0]
        missed = (one.x - fitted) ** 2
        goes_on = min(missed[during].mean(), np.ptp(fitted[during]) ** 2)
        if goes_on > STRAYS**2 * missed[outside].mean():
            return f"no change from {begin:.2f} to {end:.2f} s"
    return ""


def _sign_and_scale(view: LogView, one: _Explained) -> Iterator[Finding]:
    """Check sign and scale of a stream."""
    if not (one.x.std() > 0.0 and one.expected.std() > 0.0):
        return
    fitted, scale = one.fitted()
    alike, since = _correlation(*one.alike.T), sign_change(view.at, *one.alike.T, LIKELY)
    # What is expected alone is inconclusive for a machine that pushes against something.
    explained = _correlation(one.x, fitted) > LIKELY
    if since is not None:
        yield of_changing_sign(one.column, since, one.witness)
    elif explained and alike < -HARDLY:
        seen, changes = (
            f"correlation with {one.witness} {alike:.2f}",
            entries((one.column,), sign=-1.0),
        )
        yield Finding((one.column,), seen, "wrong sign", changes)
    elif explained and abs(one.beside_rest) > LIKELY and not DRIVEN[0] < scale < DRIVEN[1]:
        seen = f"{scale:.3g} times {one.witness}"
        yield Finding((one.column,), seen, one.otherwise, scaled(one.column, scale))


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Correlation of a (M,) and b (M,); 0 where one is constant."""
    return float(match_axes(a[:, None], b[:, None]).own[0])
