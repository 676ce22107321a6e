"""Servos that follow commanded angles, in logs without torques: delay, time constant and backlash.

Each servo is modelled by a delay, a first-order lag, a play of its gears and, per log, a constant
offset under load. The residual of the angle shows what this model lacks. For comparison, the
published model of the machine is simulated with the same commands.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.signal import hilbert, lfilter

from surefoot import Log
from surefoot.extend import Modelled, kernel
from surefoot.scenarios.reporting import AFTER, BEFORE, INK, legend_below, new_figure, set_title
from surefoot.sim.robot.model_file import compiled_model

DELAYS = np.arange(0.0, 0.121, 0.01)
"""Delays on the grid [s]: a bus polled at 50 Hz, and the servo's own loop."""
PLAYS = np.radians([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.3, 1.6, 2.0, 3.0])
"""Plays on the grid [rad], in total: gears of hobby servos have 0.3 to 1 degree, and a control loop
that stops within its dead band adds to it.
"""
SERVO_LAGS = np.array([0.0, 0.02, 0.04, 0.06, 0.1, 0.15, 0.22])
"""Time constants on the grid [s]."""
SWEEP_WINDOW = 4.0
"""Length of the windows in which the response to a sweep of frequencies is measured [s]."""
SWEEP_ROWS = 9
"""Number of windows in the table of the response to a sweep: the last ones."""
DRAWN_SECONDS = 8.0
"""Duration of the part of a run that is plotted [s]."""


@dataclass(frozen=True)
class Servo:
    """Model of a joint's servo: delay [s], time constant [s] and play [rad]."""

    delay: float
    lag: float
    play: float

    def angle(self, t: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        """Angle (N,) [rad], up to a constant, for commanded angles (N,) at t (N,) [s]."""
        late = np.interp(t - self.delay, t, commanded)
        step = float(np.median(np.diff(t)))
        keep = np.exp(-step / self.lag) if self.lag else 0.0
        slow, _ = lfilter([1.0 - keep], [1.0, -keep], late, zi=[keep * late[0]])
        return with_play(slow, 0.5 * self.play)


@kernel
def with_play(angle, half):
    """Output angle (N,) [rad] of gears with a play of 2 `half` [rad], for an input `angle`."""
    out = np.empty_like(angle)
    at = angle[0]
    for k in range(len(angle)):
        at = min(max(at, angle[k] - half), angle[k] + half)
        out[k] = at
    return out


def fit_servo(logs: Sequence[Log], joint: int) -> Servo:
    """The servo on the grid with the smallest residual of a joint's angle in these logs, each with
    its own constant.

    All combinations are tried, since a delay, a lag and a play can replace one another.
    """
    tried = (Servo(float(d), float(g), float(p)) for d in DELAYS for g in SERVO_LAGS for p in PLAYS)
    return min(tried, key=lambda s: sum(float(np.sum(_left(log, joint, s) ** 2)) for log in logs))


def simulated_angles(log: Log, machine: Modelled) -> np.ndarray:
    """Angles (N, J) [rad] of the machine's own file, whose position servos follow the log's
    commands from its initial state.
    """
    model = compiled_model(machine.file)
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in machine.joint_names]
    places = [int(joint.qposadr[0]) for joint in joints]
    servo_of = {int(model.actuator_trnid[k, 0]): k for k in range(model.nu)}
    servos = [servo_of[int(joint.id)] for joint in joints]
    data.qpos[places] = log.q[0]
    found = np.empty_like(log.q)
    for k, now in enumerate(log.t - log.t[0]):
        while data.time < now - 0.5 * model.opt.timestep:
            mujoco.mj_step(model, data)
        found[k] = data.qpos[places]
        data.ctrl[servos] = log.q_des[k]
    return found


def servos_table(
    fitted: Sequence[Log], unseen: Sequence[Log], machine: Modelled
) -> tuple[pd.DataFrame, tuple[Servo, ...]]:
    """One row for each joint: its servo from the fitted logs, and the error [mrad, root mean square
    without each log's mean] of its angle in the unseen ones. Also returns the servos.

    Args:
        fitted: logs.
        unseen: logs that no fit uses.
        machine: whose file is simulated for comparison.
    """
    published = [simulated_angles(log, machine) for log in unseen]
    rows, servos = [], []
    for j, joint in enumerate(machine.joint_names):
        servo = fit_servo(fitted, j)
        alone = [fit_servo([log], j) for log in fitted]
        model = [_centred(log.q[:, j] - q[:, j]) for log, q in zip(unseen, published, strict=True)]
        left = [_left(log, j, servo) for log in unseen]
        commanded = [_centred(log.q[:, j] - log.q_des[:, j]) for log in unseen]
        levels = [1e3 * _rms(parts) for parts in (model, commanded, left)]
        rows.append(
            {
                "joint": joint,
                "delay [ms]": _range([1e3 * s.delay for s in (servo, *alone)]),
                "time constant [ms]": _range([1e3 * s.lag for s in (servo, *alone)]),
                "play [deg]": _range([float(np.degrees(s.play)) for s in (servo, *alone)], 2),
                "published model [mrad]": f"{levels[0]:.1f}",
                "as commanded [mrad]": f"{levels[1]:.1f}",
                "servo [mrad]": f"{levels[2]:.1f}",
                "servo / published [%]": f"{100 * levels[2] / levels[0]:.0f}",
            }
        )
        servos.append(servo)
    return pd.DataFrame(rows), tuple(servos)


def servos_figure(log: Log, servos: Sequence[Servo], machine: Modelled) -> Figure:
    """Figure: part of a run that no fit has seen, with each joint as measured, as simulated by the
    published model, and by its servo, without means.
    """
    drawn, axes = new_figure(len(servos), 1, (9.0, 1.7 * len(servos)))
    published, t = simulated_angles(log, machine), log.t - log.t[0]
    begin = 0.5 * t[-1]
    shown = (t > begin) & (t < begin + DRAWN_SECONDS)
    for j, (ax, servo) in enumerate(zip(axes[:, 0], servos, strict=True)):
        angle = servo.angle(log.t, log.q_des[:, j])
        for x, color, words in (
            (log.q[:, j], INK, "measured"),
            (published[:, j], BEFORE, "published model"),
            (angle, AFTER, "servo with delay and play"),
        ):
            style = "--" if color == BEFORE else "-"
            ax.plot(t[shown], 1e3 * _centred(x)[shown], style, color=color, label=words)
        ax.set_ylabel("angle [mrad]")
        set_title(ax, machine.joint_names[j], 9.0)
    axes[-1, 0].set_xlabel("time [s]")
    legend_below(drawn, axes[0, 0], 3)
    return drawn


def constants_table(logs: Mapping[str, Log]) -> pd.DataFrame:
    """One row for each joint: mean difference of angle and command in each log [mrad]."""
    names = next(iter(logs.values())).joints
    return pd.DataFrame(
        {
            "joint": joint,
            **{
                run: f"{1e3 * float(np.mean(log.q[:, j] - log.q_des[:, j])):.1f}"
                for run, log in logs.items()
            },
        }
        for j, joint in enumerate(names)
    )


def ceiling_table(logs: Mapping[str, Log], servos: Sequence[Servo]) -> pd.DataFrame:
    """One row for each joint: error [mrad, root mean square] in each log of its servo and, after
    the slash, of the servo on the grid that fits this log best, which is a lower bound.
    """
    names = next(iter(logs.values())).joints
    return pd.DataFrame(
        {
            "joint": joint,
            **{
                run: " / ".join(
                    f"{1e3 * _rms([_left(log, j, one)]):.1f}"
                    for one in (servo, fit_servo([log], j))
                )
                for run, log in logs.items()
            },
        }
        for j, (joint, servo) in enumerate(zip(names, servos, strict=True))
    )


def sweep_table(log: Log) -> pd.DataFrame:
    """One row for each of the last windows of a sweep of frequencies: for each joint, the ratio of
    the angle's amplitude to the command's, the lag of its phase [deg], and what is left [mrad, root
    mean square] of the angle without that sinusoid and a constant.
    """
    t = log.t - log.t[0]
    analytic = np.asarray(hilbert(log.q_des - log.q_des.mean(axis=0), axis=0))
    starts = np.arange(0.0, t[-1] - 0.5 * SWEEP_WINDOW, SWEEP_WINDOW)[-SWEEP_ROWS:]
    rows: list[dict[str, str]] = []
    for start in starts:
        inside = (t >= start) & (t < start + SWEEP_WINDOW)
        row: dict[str, str] = {}
        for j, joint in enumerate(log.joints):
            commanded = analytic[inside, j]
            basis = np.column_stack([commanded.real, commanded.imag, np.ones(len(commanded))])
            found = np.linalg.lstsq(basis, log.q[inside, j])[0]
            response, left = complex(found[0], -found[1]), log.q[inside, j] - basis @ found
            turns = np.diff(np.unwrap(np.angle(commanded))).sum() / (2.0 * np.pi)
            row.setdefault("frequency [Hz]", f"{turns / np.ptp(t[inside]):.2f}")
            lag = float(np.degrees(-np.angle(response))) % 360.0
            row[joint] = f"{abs(response):.2f} / {lag:.0f} / {1e3 * left.std():.1f}"
        rows.append(row)
    return pd.DataFrame(rows)


def _left(log: Log, joint: int, servo: Servo) -> np.ndarray:
    return _centred(log.q[:, joint] - servo.angle(log.t, log.q_des[:, joint]))


def _centred(x: np.ndarray) -> np.ndarray:
    return x - x.mean()


def _rms(parts: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def _range(values: Sequence[float], digits: int = 0) -> str:
    """'60 (40 – 80)': value for all logs, then the least and largest for single ones."""
    first, *others = values
    return f"{first:.{digits}f} ({min(others):.{digits}f} – {max(others):.{digits}f})"
