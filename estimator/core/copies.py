"""Copies of arrays inside compiled loops."""

from surefoot.sim.common.kernels import kernel


@kernel
def copy_corner(x, out):
    """Copy the first rows and columns of x into all of out (n, m).

    Element by element: for an array assignment, numba also compiles the formatting of its error
    message, which takes four seconds.
    """
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = x[i, j]
