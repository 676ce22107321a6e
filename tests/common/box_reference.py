"""An independent reference for box moments: brute force in the given axis order, no windows.

Composite Gauss-Legendre with hundreds of nodes over the whole box in two dimensions, and the third
by another composite rule; weights relative to the largest density met. Nothing is shared with
`estimator.box`: no faces, no axis order, no closed form.
"""

import numpy as np
from scipy.optimize import lsq_linear


def composite(lower: float, upper: float, panels: int, order: int = 16):
    nodes, weights = np.polynomial.legendre.leggauss(order)
    edges = np.linspace(lower, upper, panels + 1)
    half, middle = 0.5 * np.diff(edges)[:, None], 0.5 * (edges[1:] + edges[:-1])[:, None]
    return (middle + half * nodes).ravel(), (half * weights).ravel()


def reference(mean, cov, lower, upper, panels=(12, 12, 12)):
    """(log_prob, mean, cov) by brute force; the box must be finite."""
    L = np.linalg.cholesky(cov)
    axes = [composite(lower[i], upper[i], panels[i]) for i in range(3)]
    middle = 0.5 * (np.asarray(lower) + np.asarray(upper))
    (x0, w0), (x1, w1), (x2, w2) = axes
    best, sums = -np.inf, np.zeros(10)
    for a, wa in zip(x0, w0, strict=True):
        y0 = (a - mean[0]) / L[0, 0]
        y1 = (x1 - mean[1] - L[1, 0] * y0) / L[1, 1]
        y2 = (x2[None] - mean[2] - L[2, 0] * y0 - L[2, 1] * y1[:, None]) / L[2, 2]
        log = -0.5 * (y0 * y0 + y1[:, None] ** 2 + y2 * y2)
        top = log.max()
        if top > best:
            sums *= np.exp(best - top)
            best = top
        if top < best - 45:
            continue
        weight = np.exp(log - best) * w1[:, None] * w2 * wa
        d0, d1, d2 = a - middle[0], x1 - middle[1], x2 - middle[2]
        by1, by2 = weight.sum(axis=1), weight.sum(axis=0)
        m0 = by1.sum()
        sums += [m0, d0 * m0, d1 @ by1, d2 @ by2, d0 * d0 * m0, d0 * (d1 @ by1), d0 * (d2 @ by2),
                 d1**2 @ by1, d1 @ weight @ d2, d2**2 @ by2]  # fmt: skip
    first = sums[1:4] / sums[0]
    second = np.empty((3, 3))
    second[np.triu_indices(3)] = sums[4:] / sums[0]
    second = np.triu(second) + np.triu(second, 1).T
    log_prob = np.log(sums[0]) + best - 1.5 * np.log(2 * np.pi) - np.log(np.diag(L)).sum()
    return log_prob, middle + first, second - np.outer(first, first)


def worst_error(found, wanted, cov) -> float:
    """Largest error of log_prob, and of the moments in units of the truncated deviations."""
    s = np.sqrt(np.diag(wanted[2]))
    return max(
        abs(found[0] - wanted[0]),
        np.max(np.abs(found[1] - wanted[1]) / s),
        np.max(np.abs(found[2] - wanted[2]) / np.outer(s, s)),
    )


def trimmed(mean, cov, lower, upper, depth=45.0):
    """The box (lower, upper), cut to where the density is above exp(-depth) of its largest.

    For boxes far out, most of which holds nothing. Ends are found by bisection on bounded least
    squares: the largest density with one axis held.
    """
    W = np.linalg.inv(np.linalg.cholesky(cov))

    def fall(held, x):
        rest = [b for b in range(3) if b != held]
        target = W @ mean if held is None else W @ mean - W[:, held] * x
        best = lsq_linear(W[:, rest], target, (lower[rest], upper[rest]), method="bvls", tol=1e-14)
        return best.cost, best.x

    least, mode = fall(None, 0.0)
    low, high = lower.copy(), upper.copy()
    for axis in range(3):
        for end, bounds in ((lower[axis], low), (upper[axis], high)):
            near, far = mode[axis], end
            if fall(axis, far)[0] - least <= depth:
                continue
            for _ in range(40):
                middle = 0.5 * (near + far)
                deeper = fall(axis, middle)[0] - least > depth
                near, far = (near, middle) if deeper else (middle, far)
            bounds[axis] = far
    return low, high
