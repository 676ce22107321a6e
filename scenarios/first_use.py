"""Compile the kernels of observers and filters before they are used, while another process works.

On a fresh machine that takes half a minute in each of two processes, and those that need the same
kernel at the same time would each compile it. With a warm cache it takes a second.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from surefoot.estimator.core.state import NavState
from surefoot.estimator.ego_velocity import ego_velocities
from surefoot.estimator.filter import CoverageSettings, InvariantFilter
from surefoot.estimator.leg import LegFilter
from surefoot.estimator.run import ImuSamples, bounded_velocities, imu_samples
from surefoot.models.observer.gru import scan, scan_backward
from surefoot.models.observer.inference import gru_states
from surefoot.scenarios.stages import end_processes, processes, submitted
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import compile_quietly, lacks_code


@contextmanager
def filters_compiled_meanwhile() -> Iterator[None]:
    """Context in which other processes compile the filters, if the cache lacks them and can keep
    them; its end waits for them, but after an error.
    """
    if not lacks_code(LegFilter.__module__):
        yield
        return
    with processes(len(COMPILATIONS)) as pool:
        assert pool is not None
        for compiled in COMPILATIONS:
            submitted(pool, (compiled,))
        try:
            yield
        except Exception:
            end_processes()
            raise


def compile_others() -> None:
    """Run every kind of kernel on a few rows, except those of filters with a velocity."""
    compile_quietly()
    x, W, b = (np.zeros(shape, np.float32) for shape in ((2, 4), (4, 12), 12))
    states, saved = scan(np.zeros((2, 1, 12), np.float32), W, b, x[:1])
    scan_backward(states[1:], states, saved, W.reshape(12, 4))
    gru_states(x, x[0], W, b, W, b)

    imu, start = _at_rest()
    feet, standing = np.tile(-0.3 * np.eye(3)[2], (3, 1, 1)), np.ones((3, 1), dtype=bool)
    noise = np.tile(1e-4 * np.eye(3), (3, 1, 1, 1))
    leg = LegFilter(*start, feet=1)
    leg.run(imu, leg.legs(feet, standing, noise))
    ahead = np.eye(3)
    ego_velocities(np.zeros(3, dtype=np.int64), ahead, np.zeros(3), 1, 0.1)


def compile_velocity_filters() -> None:
    """Run a filter with a velocity on a few rows: one loop holds the updates of all of them."""
    compile_quietly()
    imu, start = _at_rest()
    known = bounded_velocities(np.array([1, 2]), np.zeros((2, 3)), np.full(3, 0.1), len(imu.t))
    InvariantFilter(*start).run(imu, known, settings=CoverageSettings(0.8))


COMPILATIONS = compile_velocity_filters, compile_others
"""What compiles all of them, each in a process of its own; the first takes longer."""


def _at_rest() -> tuple[ImuSamples, tuple[NavState, np.ndarray]]:
    """Three samples of an IMU at rest, and a start of a filter."""
    accel = np.tile([0.0, 0.0, GRAVITY], (3, 1))
    imu = imu_samples(np.arange(3) * 0.01, np.zeros((3, 3)), accel)
    return imu, (NavState(), 1e-4 * np.eye(15))
