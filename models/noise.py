"""Noise of a resting robot's IMU, and the densities that explain it.

A reading x = white noise of density N [unit/sqrt(Hz)] + a bias that walks with the density K
[unit/s/sqrt(Hz)] has, averaged over tau, the Allan variance (IEEE Std 952-1997, annex C)

    sigma^2(tau) = N^2 / tau + K^2 tau / 3.

Both squares are fitted to the overlapping Allan variance at octaves of tau, weighted by its degrees
of freedom (Riley, NIST Special Publication 1065, table 5: the fewer of white and of random walk
frequency noise), neither below zero.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log

LONGEST = 1 / 5
"""Longest averaging time, as a share of the record; longer ones leave only a few differences."""
SHORTEST_REST = 64
"""Least number of samples; with fewer, no octave has a variance known to a third."""
NEIGHBOURS = 0.53, 0.88
"""Correlation of the overlapping variances at neighbouring octaves, for white noise and for a
random walk, from 1500 simulated records of 4096 samples each. At a distance of n octaves it is at
most its n-th power.
"""
Z = 1.96
"""Half width of a 95 % interval, in standard deviations."""
QUIET_WINDOW, QUIET_BLOCKS = 0.5, 10
"""Length of a window [s], and number of blocks that it is divided into: means over 50 ms suppress
white noise but not a robot's motion.
"""
QUIET_GYRO, QUIET_ACCEL = 0.03, 0.5
"""Standard deviation of these means, in rad/s and m/s^2, up to which a robot is at rest."""
TURNED = 0.01
"""Difference between the means of successive windows up to which they belong to one rest: of the
gyro [rad/s] and, in units of 10 m/s^2, of the accelerometer.
"""


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviations sigma (M,) [unit] at averaging times tau (M,) [s], and the degrees of
    freedom (M,) of their squares.
    """

    tau: np.ndarray
    sigma: np.ndarray
    freedom: np.ndarray


@dataclass(frozen=True)
class Density:
    """A noise density and its 95 % interval, which begins at zero if it is insignificant."""

    value: float
    low: float
    high: float

    @property
    def resolved(self) -> bool:
        """Whether the density differs significantly from zero."""
        return self.low > 0.0


@dataclass(frozen=True)
class AxisNoise:
    """Noise of one axis of a sensor.

    Attributes:
        curve: its Allan deviation.
        white: density of the white noise [unit/sqrt(Hz)].
        walk: density of the bias's random walk [unit/s/sqrt(Hz)].
    """

    curve: AllanCurve
    white: Density
    walk: Density


def allan_curve(x: np.ndarray, rate: float) -> AllanCurve:
    """Overlapping Allan deviation of readings x (N,) at `rate` [Hz].

    Raises SurefootError where they are too few, or all equal.
    """
    n = len(x)
    if n < SHORTEST_REST:
        raise SurefootError(f"noise: {n} samples at rest, at least {SHORTEST_REST} are needed")
    if np.ptp(x) == 0.0:
        raise SurefootError(
            f"noise: an axis reads {x[0]:.4g} in all {n} samples at rest: it hangs, or "
            "is simulated without noise"
        )
    total = np.concatenate([[0.0], np.cumsum(x - np.mean(x))]) / rate
    m = 2 ** np.arange(int(np.log2(LONGEST * n)) + 1)
    tau = m / rate
    steps = [total[2 * k :] - 2.0 * total[k:-k] + total[: -2 * k] for k in m]
    sigma = np.array([np.sqrt(np.mean(d**2) / 2.0) for d in steps]) / tau
    white = (1.5 * (n - 1) / m - 2.0 * (n - 2) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    return AllanCurve(tau, sigma, np.maximum(np.minimum(white, n / m - 1.0), 1.0))


def axis_noise(x: np.ndarray, rate: float) -> AxisNoise:
    """White noise and bias walk of readings x (N,) at `rate` [Hz] of a sensor at rest."""
    curve = allan_curve(x, rate)
    A = np.column_stack([1.0 / curve.tau, curve.tau / 3.0])
    measured = curve.sigma**2

    def solved(variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        weight = np.sqrt(0.5 * curve.freedom) / np.maximum(variance, 1e-12 * measured.max())
        return nnls(A * weight[:, None], measured * weight)[0], weight

    squares, weight = solved(measured)
    for _ in range(4):  # the variance of a variance goes with its own size
        squares, weight = solved(A @ squares)
    gain = np.linalg.pinv(A * weight[:, None])
    apart = np.abs(np.subtract.outer(np.arange(len(weight)), np.arange(len(weight))))
    std = [np.sqrt(g @ rho**apart @ g) for g, rho in zip(gain, NEIGHBOURS, strict=True)]
    white, walk = (_density(square, spread) for square, spread in zip(squares, std, strict=True))
    return AxisNoise(curve, white, walk)


def _density(square: float, std: float) -> Density:
    """The density from its square and that square's standard deviation.

    A significant one has an interval of its logarithm, since the deviation is proportional to the
    square.
    """
    if square > Z * std:
        factor = np.exp(0.5 * Z * std / square)
        return Density(*(float(np.sqrt(square) * f) for f in (1.0, 1.0 / factor, factor)))
    return Density(float(np.sqrt(square)), 0.0, float(np.sqrt(square + Z * std)))


@dataclass(frozen=True)
class RestNoise:
    """Noise of a log at rest.

    Attributes:
        begin: of the rest [s].
        end: of the rest [s].
        gyro: noise of each axis, in rad/s.
        accel: noise of each axis, in m/s^2.
    """

    begin: float
    end: float
    gyro: tuple[AxisNoise, ...]
    accel: tuple[AxisNoise, ...]


def rest_of(log: Log) -> np.ndarray:
    """Rows of the longest section of a log in which its IMU is at rest.

    Windows are quiet if gyro and accelerometer vary by less than QUIET_GYRO and QUIET_ACCEL.
    Successive quiet windows are joined if their means agree to TURNED. Raises SurefootError where
    no window is quiet.
    """
    log.require("imu")
    block = max(round(QUIET_WINDOW * log.rate / QUIET_BLOCKS), 1)
    size = block * QUIET_BLOCKS
    count = len(log.t) // size
    gyro, accel = (
        x[: count * size].reshape(count, QUIET_BLOCKS, block, 3).mean(axis=2)
        for x in (log.gyro, log.accel)
    )
    quiet = (gyro.std(axis=1).max(axis=1) < QUIET_GYRO) & (
        accel.std(axis=1).max(axis=1) < QUIET_ACCEL
    )
    if not quiet.any():
        raise SurefootError(
            f"{log.name}: nowhere at rest: no {QUIET_WINDOW} s in which the gyro moves by less "
            f"than {QUIET_GYRO} rad/s and the accelerometer by less than {QUIET_ACCEL} m/s^2"
        )
    turned = np.abs(np.diff(gyro.mean(axis=1), axis=0)).max(axis=1) > TURNED
    tilted = np.abs(np.diff(accel.mean(axis=1), axis=0)).max(axis=1) > 10.0 * TURNED
    joined = quiet[1:] & quiet[:-1] & ~turned & ~tilted
    begins = np.flatnonzero(quiet & ~np.r_[False, joined])
    ends = np.flatnonzero(quiet & ~np.r_[joined, False])
    best = np.argmax(ends - begins)
    return np.arange(begins[best] * size, (ends[best] + 1) * size)


def rest_noise(log: Log) -> RestNoise:
    """Noise of the IMU during the longest rest of a log.

    Raises SurefootError where there is no rest, or only too short ones.
    """
    rows = rest_of(log)
    t = log.t[rows]
    gyro, accel = (
        tuple(axis_noise(x[rows, axis], log.rate) for axis in range(3))
        for x in (log.gyro, log.accel)
    )
    return RestNoise(float(t[0]), float(t[-1]), gyro, accel)
