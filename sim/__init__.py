"""The world that makes data: robots, terrain, gait, sensors, effects and the Log."""

from sim.kernel_cache import forget_stale_kernels

forget_stale_kernels(__file__)
