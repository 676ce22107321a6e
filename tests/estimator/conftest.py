import estimator
import sim
from sim.kernel_cache import forget_stale_kernels

# Kernels of tests inline those of the library, as theirs do.
forget_stale_kernels(__file__, estimator.__file__, sim.__file__)
