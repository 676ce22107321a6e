"""A log with the quantities that several plausibility rules need, computed once."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.common.quaternion import continuous
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.log import Log
from surefoot.sim.plausibility.comparison import AxesMatch, lag_of, match_axes
from surefoot.sim.plausibility.limits import FEWEST, MIDDLE, RESTS
from surefoot.sim.plausibility.stance import Stance, feet_at, stance_of
from surefoot.sim.robot.machine import Machine
from surefoot.sim.robot.robot import Robot

GYRO, ACCEL, REF_P, REF_V = (
    tuple(f"{kind}_{a}" for a in "xyz") for kind in ("gyro", "accel", "ref_p", "ref_v")
)
REF_Q = tuple(f"ref_q_{a}" for a in "wxyz")
STEP = 0.02
"""Interval between the times at which streams are compared [s]: some tens per stride."""
MEAN = 0.06
"""Averaging time of the streams [s], which suppresses impacts and the noise of derivatives."""
MOST_COMPARED, COMPARED_A_ROW = 1_000_000, 5
"""Largest number of times at which streams are compared, in all and per row (a log at 10 Hz has
five per row). A clock that was set during the log, or stamps in nanoseconds, would require more
memory than there is.
"""
_STILL = 0.02
"""RMS rate below which a body is at rest [rad/s], so that only a gyro's bias and noise would be
compared.
"""


@dataclass(frozen=True)
class LogView:
    """A log with its machine, None if unknown.

    Streams that are compared with each other are averaged over MEAN seconds at the M times `at`.
    """

    log: Log
    machine: Machine | None = None

    @cached_property
    def t(self) -> np.ndarray:
        """Times of the rows (N,) [s]."""
        return self.log.t

    @cached_property
    def at(self) -> np.ndarray:
        """Times of comparison (M,) [s]; empty if the stamps span far more time than there are rows
        for.
        """
        begin, end = self.t[0] + MEAN, self.t[-1] - MEAN
        most = max(MOST_COMPARED, COMPARED_A_ROW * len(self.t))
        return np.arange(begin, end if end - begin < most * STEP else begin, STEP)

    @property
    def comparable(self) -> bool:
        """Whether the log is long enough to compare streams."""
        return len(self.at) >= FEWEST and len(self.t) > 20

    @property
    def robot(self) -> Robot | None:
        """The machine, if it is a robot with a model of its legs."""
        return None if self.machine is None else self.machine.legged

    @cached_property
    def chains(self) -> np.ndarray | None:
        """Joints (L, C) of each leg; None where feet are not known by them, or legs differ."""
        chains = () if self.robot is None or self.log.has("foot") else self.robot.limbs.chains
        return np.array(chains) if len({len(chain) for chain in chains}) == 1 else None

    @property
    def on_fixed_base(self) -> bool:
        """Whether the machine is known and has no legs."""
        return self.machine is not None and self.machine.fixed

    @property
    def torque_is_measured(self) -> bool:
        """Whether torques were not derived from something else."""
        return not any(one.startswith("tau") for one in self.log.meta.derived)

    def columns(
        self, kind: str, which: np.ndarray | list[int] | list[np.intp] | slice = slice(None)
    ) -> tuple[str, ...]:
        """Columns of a kind, such as gyro, q or contact; of those parts that `which` selects, by
        their numbers or a mask.
        """
        of_legs_or_joints = self.log.legs if kind == "contact" else self.log.joints
        parts = "xyz" if kind in ("gyro", "accel") else of_legs_or_joints
        return tuple(np.array([f"{kind}_{part}" for part in parts])[which].tolist())

    @cached_property
    def middle(self) -> "LogView":
        """The section of at most MIDDLE seconds in the middle of the log."""
        off = np.abs(self.t - 0.5 * (self.t[0] + self.t[-1]))
        return LogView(self.log.rows(off <= 0.5 * MIDDLE), self.machine)

    @cached_property
    def step(self) -> float:
        """Usual time between rows [s]."""
        return float(np.median(np.diff(self.t)))

    def least_lag(self, least: float) -> float:
        """Smallest delay [s] between streams that is evidence, `least` where rows are dense.

        What is averaged over the step before a row lags by half a row what is sampled at it.
        """
        return least + 0.5 * self.step

    def delay(
        self, lagging: np.ndarray, witness: np.ndarray, least: float, most: float
    ) -> tuple[float, float]:
        """Delay [s] of `lagging` (M, D) relative to `witness` (M, D), 0 where it is smaller than
        `least`, and their correlation at it; at most `most` [s].
        """
        found, alike = lag_of(lagging, witness, STEP, most)
        return (found if abs(found) > self.least_lag(least) else 0.0), alike

    def means(self, x: np.ndarray) -> np.ndarray:
        """Means (M, D) of a stream x (N, D), sampled at the rows, about the times `at`."""
        return self.changes(cumulative_trapezoid(x, self.t, axis=0, initial=0.0))

    def _averages(self, x: np.ndarray) -> np.ndarray:
        """Means (M, D) of an IMU's x (N, D), averaged over the step before each row."""
        return self.changes(np.cumsum(x * np.diff(self.t, prepend=self.t[0])[:, None], axis=0))

    def between_samples(self, rates: np.ndarray, x: np.ndarray | None = None) -> np.ndarray:
        """Relative error (D,) of integrals of `rates` (N, D), as they are known at the rows alone.

        By Richardson's extrapolation of the trapezoidal rule, from every other row: of the rates or
        of the steps of their integral x (N, D), whichever are smoother. Infinite where a period has
        less than four rows, or there is mostly noise.
        """
        error = np.full(rates.shape[1], np.inf)
        for y in [rates] if x is None else [rates, np.diff(x, axis=0) / np.diff(self.t)[:, None]]:
            bend, size = y[1:-1] - 0.5 * (y[2:] + y[:-2]), y.std(axis=0)
            missed = np.sqrt(np.mean(bend**2, axis=0)) / np.where(size > 0.0, size, 1e-12)
            error = np.minimum(error, np.where(size > 0.0, missed, np.inf))
        return np.where(error < 1.0, error / 6.0, np.inf)

    @cached_property
    def resolves(self) -> bool:
        """Whether the rows are dense enough to show how most joints, else the body, move."""
        log = self.log
        if len(self.t) < 4:
            return False
        if log.has("q"):
            moves = np.ptp(log.q, axis=0) > RESTS
            rates = log.dq if log.has("dq") else np.gradient(log.q, self.t, axis=0)
            errors = self.between_samples(rates, log.q)[moves]
        else:
            errors = self.between_samples(log.gyro) if log.has("imu") else np.zeros(0)
        return not len(errors) or bool(np.isfinite(np.median(errors)))

    def changes(self, x: np.ndarray) -> np.ndarray:
        """Derivatives (M, D) of x (N, D) over MEAN seconds about the times `at`."""
        return (self.after(x, 0.5 * MEAN) - self.after(x, -0.5 * MEAN)) / MEAN

    def after(self, x: np.ndarray, seconds: float) -> np.ndarray:
        """Values (M, D) of x (N, D) some seconds after the times `at`."""
        return interpolate_rows(self.at + seconds, self.t, x)

    @cached_property
    def ok(self) -> np.ndarray:
        """Mask (M,) of the times about which the reference was measured."""
        return self.means(self.log.ref_ok[:, None].astype(float))[:, 0] > 0.999

    @cached_property
    def gyro(self) -> np.ndarray:
        """Mean angular rate (M, 3) [rad/s] in I."""
        return self._averages(self.log.gyro)

    @cached_property
    def accel(self) -> np.ndarray:
        """Mean specific force (M, 3) [m/s^2] in I."""
        return self._averages(self.log.accel)

    def attitudes(self, after: float, where: np.ndarray | None = None) -> Rotation:
        """Attitudes of the reference `after` seconds from the times `at` (M,), or from those in the
        mask `where` (M,).
        """
        mean = self.after(continuous(self.log.ref_q), after)
        return Rotation.from_quat(mean if where is None else mean[where], scalar_first=True)

    @cached_property
    def R_GI(self) -> Rotation:
        """Attitudes (M,) of the reference."""
        return self.attitudes(0.0)

    @cached_property
    def turning(self) -> np.ndarray:
        """Angular rate (M, 3) [rad/s] in I of the reference's attitudes."""
        begin, end = self.attitudes(-0.5 * MEAN), self.attitudes(0.5 * MEAN)
        return (begin.inv() * end).as_rotvec() / MEAN

    @property
    def compares_turning(self) -> bool:
        """Whether the log has gyro and reference, and rotates for long enough to compare them."""
        if not (self.comparable and self.log.has("imu") and self.log.has("reference")):
            return False
        moves = max(self.gyro.std(axis=0).max(), self.turning.std(axis=0).max()) > _STILL
        return bool(moves) and int(self.ok.sum()) >= FEWEST

    @cached_property
    def gyro_match(self) -> AxesMatch:
        """Match of the gyro's axes with the reference's rotation."""
        return match_axes(self.gyro[self.ok], self.turning[self.ok])

    @property
    def trusts_reference(self) -> bool:
        """Whether the reference turns as the gyro does; what else is wrong with it is for rules to
        find that come before.
        """
        return self.compares_turning and self.gyro_match.alike

    @cached_property
    def ref_v(self) -> np.ndarray:
        """Velocity (M, 3) [m/s] in G, from the reference's positions."""
        return self.changes(self.log.ref_p)

    @cached_property
    def ref_a(self) -> np.ndarray:
        """Acceleration (M, 3) [m/s^2] in G, from the reference's positions."""
        return np.gradient(self.ref_v, STEP, axis=0)

    @cached_property
    def felt(self) -> np.ndarray:
        """Specific force (M, 3) [m/s^2] in I for the motion of the reference."""
        return self.R_GI.inv().apply(self.ref_a - GRAVITY_G)

    @cached_property
    def v_I(self) -> np.ndarray:
        """Velocity (M, 3) [m/s] of the reference, in I."""
        return self.R_GI.inv().apply(self.ref_v)

    @cached_property
    def up_by_body(self) -> np.ndarray | None:
        """Up in I (3,) by the body: the robot's z, else opposite to its feet. None where neither is
        known.
        """
        if self.robot is not None:
            return self.robot.R_BI[2]
        if self.feet is None:
            return None
        below = self.feet.foot.mean(axis=(0, 1))
        return -below / max(float(np.linalg.norm(below)), 1e-9)

    @cached_property
    def feet(self) -> Stance | None:
        """Motion of the feet, where feet and contacts are known, of a log of any length."""
        feet = feet_at(self.log, self.robot)
        if feet is None or not (len(self.at) and self.resolves and self.log.has("contact")):
            return None
        gyro = self.gyro if self.log.has("imu") else np.zeros((len(self.at), 3))
        v_I = self.v_I if self.trusts_reference else np.full(gyro.shape, np.nan)
        used = self.ok if self.log.has("reference") else np.ones(len(self.at), dtype=bool)
        return stance_of(self.log, feet, self.at, gyro, v_I, used)

    @property
    def stance(self) -> Stance | None:
        """Motion of the feet, where feet and contacts are known and the log is long enough."""
        return self.feet if self.comparable else None
