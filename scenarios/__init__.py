"""Scenario files, experiments, reports, rerun recordings and the command line."""

import estimator
from sim.kernel_cache import forget_stale_kernels

forget_stale_kernels(__file__, estimator.__file__)
