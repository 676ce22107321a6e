"""Recursive filters on SE_2(3), their measurement updates, and trajectory metrics.

Public here is the mathematics that docs/equations.md refers to, for whoever compares with it or
builds a filter of the same parts; what ends in `_kernel`, and the updates, are compiled functions.
Each name is imported when it is first used.
"""

# ruff: noqa: F401
from typing import TYPE_CHECKING

from surefoot.lazy import lazy_names

if TYPE_CHECKING:
    from surefoot.estimator.box import box_moments, box_moments_kernel
    from surefoot.estimator.core.lie import gammas, hat
    from surefoot.estimator.core.propagation import propagate
    from surefoot.estimator.core.state import EXTRA, retract
    from surefoot.estimator.initial import InitialStd, start_covariance
    from surefoot.estimator.run import bounded_velocities, gaussian_velocities, imu_samples
    from surefoot.estimator.updates.coverage import FLOOR, posterior_moments, update_coverage
    from surefoot.estimator.updates.velocity import lift, velocity_memory, velocity_output

__getattr__, __dir__ = lazy_names(globals())
