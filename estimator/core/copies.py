"""Copies of arrays inside compiled loops."""

from surefoot.sim.common.kernels import kernel


@kernel
def copy_corner(x, out):
    """The first rows and columns of x into the whole of out (n, m).

    Number by number: of an assignment of arrays numba compiles the words of its error, which takes
    four seconds.
    """
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = x[i, j]
