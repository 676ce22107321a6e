"""A filter over a whole log in one call, for the tests that compare filters."""

import numpy as np

from surefoot.estimator.filter import CoverageSettings, InvariantFilter
from surefoot.estimator.leg import LegFilter
from surefoot.estimator.run import (
    NO_VELOCITIES,
    bounded_velocities,
    every_row,
    gaussian_velocities,
    imu_samples,
)


def rows_of(t, stride):
    """Every stride-th row, by default those that are stored."""
    return every_row(t) if stride is None else np.arange(0, len(t), stride)


def run_imu(t, gyro, accel, state, covariance, noise=None, stride=None):
    imu = imu_samples(t, gyro, accel)
    return InvariantFilter(state, covariance, noise).run(imu, rows=rows_of(imu.t, stride))


def run_velocity(
    t, gyro, accel, rows, v_I, cov, state, covariance, noise=None, stride=None, persistent=None
):
    imu = imu_samples(t, gyro, accel)
    velocities = gaussian_velocities(rows, v_I, cov, len(imu.t))
    one = InvariantFilter(state, covariance, noise, persistent)
    return one.run(imu, velocities, rows_of(imu.t, stride))


def run_coverage(
    t, gyro, accel, rows, v_I, epsilon, gamma, state, covariance, noise=None, stride=None,
    persistent=None, iterations=1,
):  # fmt: skip
    imu = imu_samples(t, gyro, accel)
    velocities = bounded_velocities(rows, v_I, epsilon, len(imu.t))
    one = InvariantFilter(state, covariance, noise, persistent)
    settings = CoverageSettings(gamma, iterations)
    return one.run(imu, velocities, rows_of(imu.t, stride), settings)


def run_leg(
    t, gyro, accel, feet_I, contact, cov, state, covariance, noise=None, foot_radius=0.0,
    foot_rates_I=None, slip_gate=None, stride=None, rows=None, v_I=None, v_cov=None,
):  # fmt: skip
    imu = imu_samples(t, gyro, accel)
    feet = feet_I.shape[1] if feet_I.ndim == 3 else 0
    one = LegFilter(state, covariance, noise, foot_radius, feet, slip_gate)
    legs = one.legs(feet_I, contact, cov, foot_rates_I)
    none = rows is None
    velocities = NO_VELOCITIES if none else gaussian_velocities(rows, v_I, v_cov, len(imu.t))
    return one.run(imu, legs, velocities, rows_of(imu.t, stride))
