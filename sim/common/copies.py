"""Copies of arrays inside compiled loops.

For an array that is assigned to a slice, numba also compiles the formatting of its error message
for a wrong shape: two to four seconds in every process. A loop takes a tenth of a second.
"""

from surefoot.sim.common.kernels import kernel


@kernel
def copy_row(x, out):
    """Copy x (n,) into out (n,)."""
    for i in range(out.shape[0]):
        out[i] = x[i]


@kernel
def copy_corner(x, out):
    """Copy the first rows and columns of x into all of out (n, m)."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = x[i, j]
