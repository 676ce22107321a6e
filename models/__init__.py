"""What is learnt from data: the velocity observer, its calibration, residuals and their causes."""

import sim
from sim.kernel_cache import forget_stale_kernels

forget_stale_kernels(__file__, sim.__file__)
