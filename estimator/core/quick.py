"""Checks and work in one compiled call, for a robot's own loop.

A call from Python costs more than the arithmetic of a step, and checks in Python more than the
call. These take C-contiguous float arrays alone (TypeError otherwise); where the numbers are not
allowed nothing is changed, and the caller finds out what is wrong with them.
"""

import numpy as np

from surefoot.estimator.core.propagation import propagate
from surefoot.estimator.core.state import definite_3
from surefoot.estimator.updates.velocity import update_velocity
from surefoot.sim.common.kernels import kernel


@kernel
def _finite_3(x) -> bool:
    return x.shape[0] == 3 and np.isfinite(x[0]) and np.isfinite(x[1]) and np.isfinite(x[2])


@kernel(signature="b1(f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8, f8[:,::1], f8[:,::1], f8[:,::1])")
def quick_predict(mean, covariance, gyro, accel, dt, noise, columns, rotation_columns) -> bool:
    """`propagate` for finite gyro (3,) and accel (3,) and dt > 0: True, or False undone."""
    if not (_finite_3(gyro) and _finite_3(accel) and 0.0 < dt < np.inf):
        return False
    propagate(mean, covariance, gyro, accel, dt, noise, columns, rotation_columns)
    return True


@kernel(signature="f8(f8[:,::1], f8[:,::1], i8, f8[::1], f8[:,::1])")
def quick_velocity(mean, covariance, contacts, v_I, cov) -> float:
    """`update_velocity` for a finite v_I (3,) and a positive definite cov (3, 3); -1 undone."""
    if not _finite_3(v_I) or cov.shape != (3, 3) or not definite_3(cov):
        return -1.0
    return update_velocity(mean, covariance, contacts, v_I, cov)
