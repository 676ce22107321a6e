"""Checks of the drives of a machine on a fixed base.

Torques are compared with inverse dynamics along the motion, commanded angles with the measured
ones.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from surefoot.sim.importing.advice import entries, scaled
from surefoot.sim.plausibility.finding import Finding, rule
from surefoot.sim.plausibility.joints import sign_change, turned_round
from surefoot.sim.plausibility.streams import LIMITED, stretches_without_change
from surefoot.sim.plausibility.view import LogView

OPPOSITE = -0.5
"""Correlation with the expected torque below which a torque has the opposite sign; likewise for the
moves of a command and its joint. Measured drives have 0.7 and more, 0 where they are touched, -0.2
where the commands are smaller than a servo's backlash.
"""
EXPLAINED = 0.7
"""Correlation with model and friction from which the scale and sign of a torque can be judged."""
SCALED = (0.4, 2.0)
"""Range of the scale relative to the model: measured drives have 0.6 to 1.3, because of friction
and inaccurate published masses; a torque of the motor's side is smaller by the gear ratio.
"""
STRAYS = 3.0
"""Ratio to the usual error from which a constant torque or command is stuck."""
SLIDES = 0.05
"""Rate below which dry friction does not reach its full size [rad/s]."""
FOLLOWED = 0.8
"""Correlation of an angle with its command from which it follows."""
MOVE = 0.5
"""Time over which moves of a joint are compared with those of its command [s]; servos are 0.1 s
late.
"""
COMMANDED = 1.0
"""Time without a change of a command, while its joint moves, from which it is stuck [s]."""
SWEPT = 0.5
"""Share of its range that a joint moves in that time; alternatively STRAYS times the usual
error.
"""


@dataclass(frozen=True)
class _Torque:
    """Torque of a joint.

    Attributes:
        joint: name.
        tau: mean torque (M,) [N m].
        rigid: torque (M,) by the rigid-body model [N m].
        friction: regressors (M, 2) of dry and viscous friction.
    """

    joint: str
    tau: np.ndarray
    rigid: np.ndarray
    friction: np.ndarray

    def fitted(self, where: np.ndarray) -> tuple[np.ndarray, float]:
        """Least-squares fit of model and friction (M,), and the model's factor, on the times
        `where` (M,).
        """
        terms = np.column_stack([self.rigid, self.friction])
        sizes = np.linalg.lstsq(terms[where], self.tau[where], rcond=None)[0]
        return terms @ sizes, float(sizes[0])

    @property
    def beside_friction(self) -> float:
        """Correlation of torque and model after subtracting friction from both."""
        terms = np.column_stack([self.friction, np.ones(len(self.tau))])
        both = np.column_stack([self.tau, self.rigid])
        tau, rigid = (both - terms @ np.linalg.lstsq(terms, both, rcond=None)[0]).T
        return _correlation(tau, rigid)


def _torques(view: LogView) -> list[_Torque]:
    """Torques of drives with a known model that requires some torque."""
    log, machine = view.log, view.machine
    if machine is None or machine.dynamics is None or not machine.fixed:
        return []
    if any(d.startswith("tau") for d in log.meta.derived):
        return []
    dq = view.changes(log.q)
    ddq = np.gradient(dq, view.at, axis=0)
    rigid = machine.dynamics.inverse(view.means(log.q), dq, ddq)[1]
    tau, sense = view.means(log.tau), np.tanh(dq / SLIDES)
    return [
        _Torque(name, tau[:, j], rigid[:, j], np.column_stack([sense[:, j], dq[:, j]]))
        for j, name in enumerate(log.joints)
        if tau[:, j].std() > 0.0 and rigid[:, j].std() > 0.0
    ]


@rule("torques of a fixed base", "t q tau", when="comparable")
def driving(view: LogView) -> Iterator[Finding]:
    """Check that the torques of drives on a fixed base explain its motion.

    Compares: torques with what the machine's model asks for along the motion, and friction
        beside it.
    Threshold: correlation below {OPPOSITE:g}; a sign that changes on the way; not
        {SCALED[0]:g} to {SCALED[1]:g} times as large; no change for {LIMITED:g} s while
        {STRAYS:g} times as much is missed as else.
    Reason: three measured machines have 0.6 to 1.3 times what their models ask for.
    Remedy: sign, unit or gain of tau; torques of the output, not of the motor.
    """
    for one in _torques(view):
        column = f"tau_{one.joint}"
        for seen, during, outside in _holds(view, column, LIMITED):
            if _strays(one.tau - one.fitted(outside)[0], during, outside):
                seen += " while what it drives goes on"
                yield Finding((column,), seen, "a sensor that hangs")
                break
        else:
            yield from _against_model(view, column, one)


def _against_model(view: LogView, column: str, one: _Torque) -> Iterator[Finding]:
    """Check sign and scale of a torque."""
    fitted, scale = one.fitted(np.ones(len(view.at), dtype=bool))
    alike = _correlation(one.tau, one.rigid)
    # The model alone is inconclusive for a machine that pushes against something.
    explained = _correlation(one.tau, fitted) > EXPLAINED
    when = sign_change(view.at, one.tau, one.rigid, EXPLAINED)
    if when is not None:
        yield turned_round(column, when, "what the model asks for")
    elif explained and alike < OPPOSITE:
        seen = f"correlation with what the model asks for {alike:.2f}"
        yield Finding((column,), seen, "wrong sign", entries((column,), sign=-1.0))
    elif explained and abs(one.beside_friction) > EXPLAINED and not SCALED[0] < scale < SCALED[1]:
        seen = f"{scale:.3g} times what the model asks for"
        cause = "another unit, or of the motor's side"
        cause += ", or a load that the model lacks" if scale > 1.0 else ""
        yield Finding((column,), seen, cause, scaled(column, scale))


def _holds(
    view: LogView, column: str, least: float, settles: float = 0.0
) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Sections of at least `least` [s] in which a column does not change.

    Each is given in words, with masks (M,) of the times in it and outside, without the first
    `settles` seconds of both; sections with less than three times are left out.
    """
    for first, last in stretches_without_change(view.t, view.log.frame[column].to_numpy(), least):
        begin, end = view.t[first], view.t[last]
        during = (view.at > begin + settles) & (view.at < end)
        outside = (view.at < begin) | (view.at > end + settles)
        if min(during.sum(), outside.sum()) >= 3:
            yield f"no change from {begin:.2f} to {end:.2f} s", during, outside


def _strays(rest: np.ndarray, during: np.ndarray, outside: np.ndarray) -> bool:
    """Whether an error (M,) is larger than usual during a section."""
    inside, usual = (np.sqrt(np.mean(rest[rows] ** 2)) for rows in (during, outside))
    return bool(inside > STRAYS * usual)


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-300))


@rule("commands of a fixed base", "t q q_des", when="comparable")
def followed(view: LogView) -> Iterator[Finding]:
    """Check that the joints of a machine on a fixed base follow their commands.

    Compares: q_des with q, joint by joint, and their moves within {MOVE:g} s.
    Threshold: correlation below {OPPOSITE:g}; a sign that changes on the way; not
        {SCALED[0]:g} to {SCALED[1]:g} times as far; no change for {COMMANDED:g} s while the
        joint goes {SWEPT:.0%} of its range, or {STRAYS:g} times as far off as else.
    Reason: nothing but its drive moves a joint of an arm as far.
    Remedy: sign, unit or gain of q_des.
    """
    log = view.log
    if not view.on_fixed_base:
        return
    q, asked = view.means(log.q), view.means(log.q_des)
    half = 0.5 * MOVE
    moved, sent = (view.after(x, half) - view.after(x, -half) for x in (log.q, log.q_des))
    for j, name in enumerate(log.joints):
        a, b, column = q[:, j], asked[:, j], f"q_des_{name}"
        if not (a.std() > 0.0 and b.std() > 0.0):
            continue
        alike, when = _correlation(a, b), sign_change(view.at, sent[:, j], moved[:, j], EXPLAINED)
        if when is not None:
            yield turned_round(column, when, f"the moves of q_{name}")
        elif (opposed := _correlation(sent[:, j], moved[:, j])) < OPPOSITE:
            seen = f"correlation with the moves of q_{name} {opposed:.2f}"
            yield Finding((column,), seen, "wrong sign", entries((column,), sign=-1.0))
        elif alike > FOLLOWED and not SCALED[0] < b.std() / a.std() < SCALED[1]:
            scale = float(b.std() / a.std())
            seen = f"{scale:.3g} times as far as q_{name} goes"
            yield Finding((column,), seen, "another unit than its angle's", scaled(column, scale))
        else:
            # After a step of the command, a joint is still moving.
            for seen, during, outside in _holds(view, column, COMMANDED, 0.5 * COMMANDED):
                off, goes = a - b - np.median((a - b)[outside]), np.ptp(a[during])
                moves = goes > STRAYS * np.sqrt(np.mean(off[outside] ** 2))
                if goes > SWEPT * np.ptp(a) or (moves and _strays(off, during, outside)):
                    seen += f" while q_{name} goes on"
                    yield Finding((column,), seen, "a command that was not logged")
                    break
