"""Drives of a machine on a fixed base: torques against what its model asks for along the motion,
commanded angles against those that follow them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from surefoot.sim.physics.inverse_dynamics import body_changes, dynamics_of
from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.plausibility.joints import sign_change
from surefoot.sim.plausibility.streams import LIMITED, stretches_without_change
from surefoot.sim.plausibility.view import LogView

OPPOSITE = -0.5
"""Correlation with what the model asks for below which a torque has the other sign, and of moves of
a command with those of its joint: measured drives have 0.7 and more, 0 where they are touched, -0.2
where the commands are less than a servo's play."""
TOLD = 0.7
"""Correlation with what model and friction ask for from which a torque's size and sign are told."""
SCALED = (0.4, 2.0)
"""Of what the model asks for: measured drives have 0.6 to 1.3 of it, by friction and by masses
that are not quite as published; a torque of the motor's side has one part of its gear's ratio."""
STRAYS = 3.0
"""Times as far off as at other times: a torque that hangs, of what model and friction ask for; a
command, of its joint's angle."""
SLIDES = 0.05
"""rad/s below which dry friction has not its full size."""
FOLLOWED = 0.8
"""Correlation of an angle with its command from which it follows."""
MOVE = 0.5
"""s over which moves of a joint are compared with those of its command: servos are 0.1 s late."""
COMMANDED = 1.0
"""s without a change of a command while its joint goes on, from which on the command hangs."""
SWEPT = 0.5
"""Of its range, that a joint goes meanwhile, or STRAYS times as far off the command as else."""


@dataclass(frozen=True)
class _Torque:
    """A joint's mean torque tau (M,), what its model asks for (M,), and that with the drive's own
    friction, fitted (M,), with the share `scale` of the model's part in it."""

    joint: str
    tau: np.ndarray
    rigid: np.ndarray
    friction: np.ndarray

    def fitted(self, where: np.ndarray) -> tuple[np.ndarray, float]:
        """What model and friction make of it (M,), and the model's share, sized on times `where`
        (M,), bool."""
        terms = np.column_stack([self.rigid, self.friction])
        sizes = np.linalg.lstsq(terms[where], self.tau[where], rcond=None)[0]
        return terms @ sizes, float(sizes[0])


def _torques(view: LogView) -> list[_Torque]:
    """The torques of drives whose model is known and is asked for something."""
    log, machine = view.log, view.machine
    if machine is None or not (view.on_fixed_base and view.comparable):
        return []
    if not (log.has("q") and log.has("tau")) or any(d.startswith("tau") for d in log.meta.derived):
        return []
    dq = view.changes(log.q)
    ddq = np.gradient(dq, view.at, axis=0)
    dynamics = dynamics_of(machine.file, machine.joint_names)
    rigid = dynamics.inverse(view.means(log.q), dq, ddq, changes=body_changes(machine))[1]
    tau, sense = view.means(log.tau), np.tanh(dq / SLIDES)
    return [
        _Torque(name, tau[:, j], rigid[:, j], np.column_stack([sense[:, j], dq[:, j]]))
        for j, name in enumerate(log.joints)
        if tau[:, j].std() > 0.0 and rigid[:, j].std() > 0.0
    ]


def driving(view: LogView) -> Iterator[Finding]:
    """Torques of drives on a fixed base are what moves it."""
    everywhere = np.ones(len(view.at), dtype=bool)
    for one in _torques(view):
        column = f"tau_{one.joint}"
        hangs = _hangs(view, column, one)
        if hangs is not None:
            told = f"no change from {hangs[0]:.2f} to {hangs[1]:.2f} s while what it drives goes on"
            yield Finding((column,), told, "a sensor that hangs")
            continue
        alike, (fitted, scale) = _correlation(one.tau, one.rigid), one.fitted(everywhere)
        # Of a machine that pushes against something the model alone tells little.
        told_by_model = _correlation(one.tau, fitted) > TOLD
        when = sign_change(view.at, one.tau, one.rigid, TOLD)
        if when is not None:
            told = f"from {when:.2f} s on minus what the model asks for, before it is that, or"
            cause = "its sign, or its angle's, changes on the way"
            yield Finding((column,), f"{told} the other way round", cause)
        elif told_by_model and alike < OPPOSITE:
            told = f"correlation with what the model asks for {alike:.2f}"
            yield Finding((column,), told, "wrong sign", f"{column} = {{ ..., sign = -1 }}")
        elif told_by_model and not SCALED[0] < scale < SCALED[1]:
            told = f"{scale:.3g} times what the model asks for"
            line = f"{column} = {{ ..., gain = {1.0 / scale:.3g} }}"
            yield Finding((column,), told, "another unit, or of the motor's side", line)


def _hangs(view: LogView, column: str, one: _Torque) -> tuple[float, float] | None:
    """From when to when [s] a torque stays as it is although the motion asks for another; None
    where it does not, as of drives at their limit or switched off."""
    for first, last in stretches_without_change(view.t, view.log.frame[column].to_numpy(), LIMITED):
        during = (view.at > view.t[first]) & (view.at < view.t[last])
        if during.sum() < 3 or (~during).sum() < 3:
            continue
        rest = one.tau - one.fitted(~during)[0]
        inside, outside = (np.sqrt(np.mean(rest[rows] ** 2)) for rows in (during, ~during))
        if inside > STRAYS * outside:
            return float(view.t[first]), float(view.t[last])
    return None


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-300))


def followed(view: LogView) -> Iterator[Finding]:
    """Joints of a machine on a fixed base go where they are commanded."""
    log = view.log
    if not (view.on_fixed_base and view.comparable and log.has("q") and log.has("q_des")):
        return
    q, asked = view.means(log.q), view.means(log.q_des)
    gone, sent = (_moves(view, x) for x in (log.q, log.q_des))
    for j, name in enumerate(log.joints):
        a, b, column = q[:, j], asked[:, j], f"q_des_{name}"
        if not (a.std() > 0.0 and b.std() > 0.0):
            continue
        alike, when = _correlation(a, b), sign_change(view.at, sent[:, j], gone[:, j], TOLD)
        if when is not None:
            told = f"from {when:.2f} s on q_{name} goes the other way than before"
            yield Finding((column,), told, "its sign, or its angle's, changes on the way")
        elif (opposed := _correlation(sent[:, j], gone[:, j])) < OPPOSITE:
            told = f"correlation with the moves of q_{name} {opposed:.2f}"
            yield Finding((column,), told, "wrong sign", f"{column} = {{ ..., sign = -1 }}")
        elif alike > FOLLOWED and not SCALED[0] < b.std() / a.std() < SCALED[1]:
            scale = float(b.std() / a.std())
            line = f"{column} = {{ ..., gain = {1.0 / scale:.3g} }}"
            told = f"{scale:.3g} times as far as q_{name} goes"
            yield Finding((column,), told, "another unit than its angle's", line)
        else:
            yield from _hanging_command(view, name, a, b)


def _moves(view: LogView, x: np.ndarray) -> np.ndarray:
    """How far streams x (N, D) go within MOVE seconds about the times `at`, (M, D)."""
    ahead, behind = (
        np.column_stack([np.interp(view.at + shift, view.t, one) for one in x.T])
        for shift in (0.5 * MOVE, -0.5 * MOVE)
    )
    return ahead - behind


def _hanging_command(
    view: LogView, joint: str, angle: np.ndarray, asked: np.ndarray
) -> Iterator[Finding]:
    """A command that stays while its joint sweeps its range, or goes far from it."""
    command = view.log.frame[f"q_des_{joint}"].to_numpy()
    for first, last in stretches_without_change(view.t, command, COMMANDED):
        # After a step a joint is still on its way.
        late = view.t[first] + 0.5 * COMMANDED
        during = (view.at > late) & (view.at < view.t[last])
        outside = (view.at < view.t[first]) | (view.at > view.t[last] + 0.5 * COMMANDED)
        if not (during.any() and outside.any()):
            continue
        off = angle - asked
        off -= np.median(off[outside])
        strays, usual = (np.sqrt(np.mean(off[rows] ** 2)) for rows in (during, outside))
        goes = np.ptp(angle[during])
        if goes > SWEPT * np.ptp(angle) or min(strays, goes) > STRAYS * usual:
            told = f"no change from {view.t[first]:.2f} to {view.t[last]:.2f} s while q_{joint}"
            yield Finding((f"q_des_{joint}",), f"{told} goes on", "a command that was not logged")
            return
