"""Means of a log's readings and of its reference over bins of 20 ms.

A bin is short compared with a step of a walk and long compared with a sample.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.integrate import cumulative_trapezoid

from surefoot.sim.common.series import low_pass, white_noise, without_low_pass
from surefoot.sim.log import Log, joint_velocity, reference_velocity
from surefoot.sim.log.derived import JOINT_WINDOW, derivative, steady_rate
from surefoot.sim.robot import Robot
from surefoot.sim.robot.feet import shown_feet
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine
from surefoot.sim.sensors.stances import inside_stances
from surefoot.sim.sensors.streams import imu_between_states

BIN = 0.02
"""Length of a bin [s]."""
STANCE_MARGIN = 0.03
"""Margin at either end of a stance that is left out [s]: the foot still lands or already lifts."""
LOG_ENDS = 0.06
"""Ends of a log that nothing is fitted to [s]: where a delay is compensated, readings are missing
there. Bounds of the joints' and the IMU's delays are a little shorter.
"""
LEAST_NOISE_RATIO = 1.5
"""Noise ratio of accelerations from rates to those from angles above which angles are used; below
it rates are preferred, since they need no smoothing window.
"""


def inner_bins(t: np.ndarray) -> np.ndarray:
    """Mask (M,) of the bins of a log, at times t (M,) [s], that are not at its ends."""
    return (t >= t[0] + LOG_ENDS) & (t <= t[-1] - LOG_ENDS)


@dataclass(frozen=True)
class ReferenceMotion:
    """Motion that readings are compared with; constant while effects are tried.

    N rows, M bins, L feet. A log of a machine on a fixed base without a reference has `ok`
    everywhere and zero motion.

    Attributes:
        gyro: angular rate (N, 3) [rad/s] that the reference implies, by the exact inverse of
            `sim.sensors.streams`.
        accel: specific force (N, 3) [m/s^2], likewise.
        v_I: velocity (N, 3) [m/s] of the IMU in I.
        p_GI: position (N, 3) [m].
        R_GI: attitude (N, 3, 3).
        ok: rows that have a reference (N,).
        moved: rows whose preceding step has one (N,).
        standing: feet well inside a stance (N, L).
        lifted: feet well inside a swing (N, L).
        first: first row of each bin (M,).
        count: number of rows of each bin (M,).
        t: mean time of each bin (M,) [s].
    """

    gyro: np.ndarray
    accel: np.ndarray
    v_I: np.ndarray
    p_GI: np.ndarray
    R_GI: np.ndarray
    ok: np.ndarray
    moved: np.ndarray
    standing: np.ndarray
    lifted: np.ndarray
    first: np.ndarray
    count: np.ndarray
    t: np.ndarray
    level: bool = False
    """Whether the ground is level, so that heights of feet depend on the robot alone."""
    unevenness: float = 0.0
    """Standard deviation [m] of footholds from the planes through those around them, where the
    ground is not level.
    """
    early: float = 0.0
    """Time for which feet still move after their contacts begin [s]."""
    late: float = 0.0
    """Time for which feet already move before their contacts end [s]."""
    by_reference: bool = True
    """Whether the motion is from a reference. Without one, velocity and position are zero, and feet
    are compared with each other (`models.residuals.motion`).
    """
    normal_G: np.ndarray | None = None
    """Normal of the ground (N, 3) in the world, where it is not vertical."""
    rates_of_angles: bool = False
    """Whether inverse dynamics uses slopes of the angles for the rates (`angles_are_quieter`)."""

    @property
    def up_I(self) -> np.ndarray:
        """The world's vertical (N, 3) in I."""
        return self.R_GI[:, 2]

    @cached_property
    def normal_I(self) -> np.ndarray:
        """The ground's normal (N, 3) in I."""
        if self.normal_G is None:
            return self.up_I
        return np.einsum("nji,nj->ni", self.R_GI, self.normal_G)

    @cached_property
    def means(self) -> dict[str, np.ndarray]:
        """Those fields of `Bins` that follow from the motion and the stances alone."""
        mean = bin_mean(self)
        return {
            "v_I": mean(self.v_I),
            "p_GI": mean(self.p_GI),
            "R_GI": mean(self.R_GI),
            "normal_I": mean(self.normal_I),
            "standing": mean(self.standing.astype(float)) >= 0.5,
            "lifted": mean(self.lifted.astype(float)) >= 0.999,
        }


@dataclass(frozen=True)
class Bins:
    """Means over M bins, for J joints and L feet.

    Attributes:
        t: time (M,) [s].
        q: joint angles (M, J) [rad], NaN where the log has none, as for `dq` and `tau`.
        dq: joint rates (M, J) [rad/s].
        tau: joint torques (M, J) [N m].
        gyro: angular rate (M, 3) less that of the reference [rad/s], NaN where there is none.
        accel: specific force (M, 3) less that of the reference [m/s^2], NaN where there is none.
        omega: angular rate (M, 3) of the IMU in I, at the rows' own times [rad/s].
        base: angular rate, its derivative and specific force of the base's origin (M, 9), in B.
        v_I: reference velocity (M, 3) [m/s].
        p_GI: reference position (M, 3) [m].
        R_GI: reference attitude (M, 3, 3).
        normal_I: the ground's normal (M, 3).
        standing: feet in stance (M, L).
        lifted: feet in swing (M, L).
        lag: angles less the integral of the rates (M, J) [rad].
        q_step: angles (M, J) at the times of the torques [rad].
        dq_step: rates (M, J) at the times of the torques [rad/s].
        ddq: accelerations (M, J) at the times of the torques [rad/s^2].
        feet: readings that show the feet, and their derivatives (`sim.robot.feet`), NaN where the
            log has none.
        depth: sinkage of the feet in soft ground (M, L) [m], where the model has soft ground.
        v_sole: velocity of the soles in it (M, L, 3) in I [m/s].
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    omega: np.ndarray
    base: np.ndarray
    v_I: np.ndarray
    p_GI: np.ndarray
    R_GI: np.ndarray
    normal_I: np.ndarray
    standing: np.ndarray
    lifted: np.ndarray
    lag: np.ndarray
    q_step: np.ndarray
    dq_step: np.ndarray
    ddq: np.ndarray
    feet: tuple[np.ndarray, np.ndarray]
    depth: np.ndarray | None = None
    v_sole: np.ndarray | None = None


def reference_motion(log: Log, limbs: Limbs, fixed: bool = False) -> ReferenceMotion:
    """Reference motion, stances and bins of a log.

    Raises LogError where it has no reference, unless its base is `fixed`.
    """
    t, legs = log.t, len(limbs.legs)
    number = np.floor((t - t[0]) / BIN + 1e-6).astype(int)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    count = np.diff(np.append(first, len(t)))
    bins = {"first": first, "count": count, "t": np.add.reduceat(t, first) / count}
    standing, lifted = np.zeros((2, len(t), legs), dtype=bool)
    if fixed:
        none, every = np.zeros((len(t), 3)), np.ones(len(t), dtype=bool)
        still = np.broadcast_to(np.eye(3), (len(t), 3, 3))
        return ReferenceMotion(
            none, none, none, none, still, every, ~every, standing, ~lifted, **bins
        )
    log.require("reference")
    R_GI, v_GI, ok = log.ref_R_GI, reference_velocity(log), log.ref_ok
    gyro, accel = (np.concatenate([x[:1], x]) for x in imu_between_states(t, R_GI, v_GI))
    dt = np.diff(t)
    whole = np.concatenate([[False], dt < 1.5 * np.median(dt)])
    if log.has("contact"):
        standing, lifted = (
            inside_stances(t, c, STANCE_MARGIN, STANCE_MARGIN) for c in (log.contact, ~log.contact)
        )
    return ReferenceMotion(
        gyro=gyro,
        accel=accel,
        v_I=np.einsum("nji,nj->ni", R_GI, v_GI),
        p_GI=log.ref_p,
        R_GI=R_GI,
        ok=ok,
        moved=ok & np.concatenate([[False], ok[:-1]]) & whole,
        standing=standing & ok[:, None],
        lifted=lifted & ok[:, None],
        **bins,
    )


def binned(log: Log, robot: Machine, motion: ReferenceMotion) -> Bins:
    """Bin means of a log's readings, with the model's IMU mounting."""
    n, mean, legged = len(motion.ok), bin_mean(motion), robot.legged
    none, angles, rates = np.full((n, max(len(log.joints), 1)), np.nan), ("q",), ("q", "dq")
    q, dq = (log.q, joint_velocity(log)) if log.has("q") else (none, none)
    moving = derivative(log.t, q, JOINT_WINDOW, causal=False) if motion.rates_of_angles else dq
    gyro = accel = np.full((n, 3), np.nan)
    omega, slow = motion.gyro, None if robot.fixed else robot.extras.imu_lowpass
    if log.has("imu") and slow is not None:
        # Over a bin, the noise that this adds averages out.
        omega = without_low_pass(log.gyro, slow, log.rate)
        gyro, accel = (
            np.where(motion.moved[:, None], x - low_pass(known, slow, log.rate), np.nan)
            for x, known in ((log.gyro, motion.gyro), (log.accel, motion.accel))
        )

    def of(name: str, uses: Sequence[str], rows: Callable[[], np.ndarray], *given) -> np.ndarray:
        return log.once(f"binned {name}", uses, lambda: mean(rows()), *given)

    # A reference without velocities is too coarse for accelerations of the base.
    known = log.has("ref_v") or not log.has("imu")
    imu = (motion.gyro, motion.accel) if known else (omega, log.accel)
    mounted = () if legged is None else (legged.R_BI, legged.p_BI)
    feet = shown_feet(log, robot.feet)
    shown = (none, none) if feet is None else feet.readings(log)
    return Bins(
        t=motion.t,
        q=of("q", angles, lambda: q),
        dq=of("dq", rates, lambda: dq),
        tau=of("tau", ("tau",), lambda: log.tau if log.has("tau") else none),
        gyro=_where_most(gyro, motion),
        accel=_where_most(accel, motion),
        omega=of("omega", ("imu",), lambda: at_rows(omega), motion, slow),
        base=of(
            "base",
            () if known else ("imu",),
            lambda: np.zeros((n, 9)) if legged is None else base_motion(log.t, *imu, legged),
            *(motion, *mounted),
        ),
        **motion.means,
        lag=of("lag", rates, lambda: q - cumulative_trapezoid(dq, log.t, axis=0, initial=0.0)),
        q_step=of("q_step", angles, lambda: at_torques(q, motion), motion),
        dq_step=of("dq_step", rates, lambda: at_torques(moving, motion), motion),
        ddq=log.once("ddq", rates, lambda: mean_rate_of_change(moving, log.t, motion), motion),
        feet=log.once(
            "binned feet",
            () if feet is None else feet.groups,
            lambda: (mean(shown[0]), mean(shown[1])),
        ),
    )


def bin_mean(motion: ReferenceMotion):
    """Function that averages rows (N, ...) over each bin."""

    def mean(values: np.ndarray) -> np.ndarray:
        count = motion.count.reshape(-1, *[1] * (values.ndim - 1))
        return np.add.reduceat(values, motion.first, axis=0) / count

    return mean


def at_rows(omega: np.ndarray) -> np.ndarray:
    """Rates (N, ...) at the rows' own times, from rows that hold the mean of the preceding step."""
    return 0.5 * (omega + np.concatenate([omega[1:], omega[-1:]]))


def at_torques(x: np.ndarray, motion: ReferenceMotion) -> np.ndarray:
    """Interpolate x (N, ...) to the time of each row's torque.

    On a walk that is the middle of the preceding step, as for the IMU readings that torques are
    compared with; on a fixed base, without such readings, the row's own time.
    """
    if not motion.moved.any():
        return x
    return np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1])])


def mean_rate_of_change(x: np.ndarray, t: np.ndarray, motion: ReferenceMotion) -> np.ndarray:
    """Mean slope of x (N, ...) over the times of each bin's torques, per second.

    The first bin has no preceding row and starts at its first row.
    """
    x = steady_rate(t, x)
    if not motion.moved.any():
        x = np.concatenate([0.5 * (x[1:] + x[:-1]), x[-1:]])
    last = motion.first + motion.count - 1
    before = np.maximum(motion.first - 1, 0)
    time = np.maximum(t[last] - t[before], 1e-9).reshape(-1, *[1] * (x.ndim - 1))
    return (x[last] - x[before]) / time


def angles_are_quieter(log: Log, motion: ReferenceMotion) -> bool:
    """Whether a log's angles give less noisy accelerations than its rates, by the
    factor LEAST_NOISE_RATIO at the median joint.

    Some drives log rates that jitter by tenths of a rad/s between rows.
    """
    if not (log.has("q") and log.has("dq")):
        return False
    unit = np.random.default_rng(0).normal(size=log.q.shape)
    q, dq = (unit * white_noise(x) for x in (log.q, log.dq))
    slopes = derivative(log.t, q, JOINT_WINDOW, causal=False)
    by_angles, by_rates = (
        np.std(mean_rate_of_change(x, log.t, motion), axis=0) for x in (slopes, dq)
    )
    return bool(np.median(by_rates - LEAST_NOISE_RATIO * by_angles) > 0.0)


def base_motion(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, robot: Robot) -> np.ndarray:
    """Angular rate, its derivative and specific force of the base's origin (N, 9), in B."""
    omega, force = gyro @ robot.R_BI.T, accel @ robot.R_BI.T
    spin, p = np.gradient(omega, t, axis=0), robot.p_BI
    origin = force - np.cross(spin, p) - np.cross(omega, np.cross(omega, p))
    return np.hstack([omega, spin, origin])


def _where_most(values: np.ndarray, motion: ReferenceMotion) -> np.ndarray:
    """Mean over each bin of the rows (N, 3) with a value; NaN where fewer than half have one."""
    there = np.isfinite(values)
    total = np.add.reduceat(np.where(there, values, 0.0), motion.first, axis=0)
    count = np.add.reduceat(there.astype(float), motion.first, axis=0)
    enough = (count >= 0.5 * motion.count[:, None]) & (count > 0)
    return np.where(enough, total / np.maximum(count, 1), np.nan)
