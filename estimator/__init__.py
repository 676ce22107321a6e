"""Recursive filters on SE_2(3), their measurement updates, and trajectory metrics."""

from sim.kernel_cache import forget_stale_kernels

forget_stale_kernels(__file__)
