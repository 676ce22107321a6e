"""Compile the kernels of observers and filters before they are used, while another process works.

On a fresh machine that takes half a minute, and the processes that need the same kernel at the same
time would each compile it. With a warm cache it takes a second.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from surefoot.estimator.core.state import NavState
from surefoot.estimator.ego_velocity import ego_velocities
from surefoot.estimator.filter import CoverageSettings, InvariantFilter
from surefoot.estimator.leg import LegFilter
from surefoot.estimator.run import bounded_velocities, imu_samples
from surefoot.models.observer.gru import scan, scan_backward
from surefoot.models.observer.inference import gru_states
from surefoot.scenarios.stages import end_processes, processes, submitted
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import compile_quietly, lacks_code


@contextmanager
def filters_compiled_meanwhile() -> Iterator[None]:
    """Context in which another process compiles the filters, if the cache lacks them and can keep
    them; its end waits for them, but after an error.
    """
    if not lacks_code(LegFilter.__module__):
        yield
        return
    with processes(2) as pool:
        assert pool is not None
        submitted(pool, (compile_filters,))
        try:
            yield
        except Exception:
            end_processes()
            raise


def compile_filters() -> None:
    """Run every kind of kernel on a few rows, in the order in which the demo needs them."""
    compile_quietly()
    x, W, b = (np.zeros(shape, np.float32) for shape in ((2, 4), (4, 12), 12))
    states, saved = scan(np.zeros((2, 1, 12), np.float32), W, b, x[:1])
    scan_backward(states[1:], states, saved, W.reshape(12, 4))
    gru_states(x, x[0], W, b, W, b)

    t, still = np.arange(3) * 0.01, np.zeros((3, 3))
    accel = np.tile([0.0, 0.0, GRAVITY], (3, 1))
    start, covariance = NavState(), 1e-4 * np.eye(15)
    imu = imu_samples(t, still, accel)
    # One loop holds the updates of all filters with a velocity.
    velocities = bounded_velocities(np.array([1, 2]), still[1:], np.full(3, 0.1), len(t))
    settings = CoverageSettings(0.8)
    InvariantFilter(start, covariance).run(imu, velocities, settings=settings)
    feet, standing = np.tile(-0.3 * np.eye(3)[2], (3, 1, 1)), np.ones((3, 1), dtype=bool)
    noise = np.tile(1e-4 * np.eye(3), (3, 1, 1, 1))
    leg = LegFilter(start, covariance, feet=1)
    leg.run(imu, leg.legs(feet, standing, noise))
    ahead = np.eye(3)
    ego_velocities(np.zeros(3, dtype=np.int64), ahead, np.zeros(3), 1, 0.1)
