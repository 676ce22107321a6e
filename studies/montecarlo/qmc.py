"""Box moments by the paper's method, randomized quasi-Monte Carlo, for comparison with ours.

Genz's separation of variables (Genz, Numerical computation of multivariate normal probabilities,
J. Comput. Graph. Stat. 1, 1992) maps the box to the unit cube: with Sigma = L L^T, each y_i is a
truncated standard normal given those before it, and the product of their masses is the weight of
the point. The cube is filled with a Richtmyer lattice (fractional parts of multiples
of sqrt 2, sqrt 3, sqrt 5), shifted at random and folded (baker's transform).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from surefoot.estimator import box_moments_kernel
from surefoot.extend import kernel

SAMPLE_COUNTS = (100, 500, 1000, 5000, 10000)
"""The paper's N."""
PAPER = {
    100: (0.0125, 3.12e-4, 1.03e-1, 2.32e-1),
    500: (0.0372, 8.07e-5, 2.10e-2, 6.72e-2),
    1000: (0.0664, 2.00e-5, 1.48e-2, 3.14e-2),
    5000: (0.302, 5.33e-6, 3.46e-3, 6.46e-3),
    10000: (0.532, 1.06e-6, 2.06e-3, 3.20e-3),
}
"""The paper's table: ms on an i9-13950HX, and errors of probability, mean and covariance."""
_NODES = 48


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(map(float, text.split()))


# Coefficients of Wichura's rational functions: eight of the numerator, eight of the denominator.
_MIDDLE = _numbers(
    "3.3871328727963666080 1.3314166789178437745e2 1.9715909503065514427e3 "
    "1.3731693765509461125e4 4.5921953931549871457e4 6.7265770927008700853e4 "
    "3.3430575583588128105e4 2.5090809287301226727e3 "
    "1.0 4.2313330701600911252e1 6.8718700749205790830e2 5.3941960214247511077e3 "
    "2.1213794301586595867e4 3.9307895800092710610e4 2.8729085735721942674e4 "
    "5.2264952788528545610e3 "
)
_TAIL = _numbers(
    "1.42343711074968357734 4.63033784615654529590 5.76949722146069140550 "
    "3.64784832476320460504 1.27045825245236838258 2.41780725177450611770e-1 "
    "2.27238449892691845833e-2 7.74545014278341407640e-4 "
    "1.0 2.05319162663775882187 1.67638483018380384940 6.89767334985100004550e-1 "
    "1.48103976427480074590e-1 1.51986665636164571966e-2 5.47593808499534494600e-4 "
    "1.05075007164441684324e-9 "
)
_FAR = _numbers(
    "6.65790464350110377720 5.46378491116411436990 1.78482653991729133580 "
    "2.96560571828504891230e-1 2.65321895265761230930e-2 1.24266094738807843860e-3 "
    "2.71155556874348757815e-5 2.01033439929228813265e-7 "
    "1.0 5.99832206555887937690e-1 1.36929880922735805310e-1 1.48753612908506148525e-2 "
    "7.86869131145613259100e-4 1.84631831751005468180e-5 1.42151175831644588870e-7 "
    "2.04426310338993978564e-15 "
)


@dataclass(frozen=True)
class Accuracy:
    """One row of the runtime-accuracy table; errors are root mean squares over boxes and shifts.

    samples is None for the deterministic `box_moments`. milliseconds: time per evaluation,
    the fastest of several rounds over all boxes; probability: absolute; mean: Euclidean norm;
    covariance: Frobenius norm, both in units of the prior's deviations.
    """

    samples: int | None
    milliseconds: float
    probability: float
    mean: float
    covariance: float


@kernel(error_model="numpy")
def qmc_moments(mean, cov, lower, upper, samples: int, shift, out_mean, out_cov) -> float:
    """Moments of N(mean, cov) on a box from a randomized lattice; returns the probability.

    Args:
        mean: (3,) of the Gaussian.
        cov: (3, 3) of the Gaussian.
        lower: (3,), the box's lower bounds.
        upper: (3,), its upper bounds.
        samples: number of points.
        shift: (3,) in [0, 1), randomizes the lattice.
        out_mean: (3,), filled.
        out_cov: (3, 3), filled.
    """
    L = np.linalg.cholesky(cov)
    low, high = lower - mean, upper - mean
    step = np.sqrt(np.array([2.0, 3.0, 5.0]))
    y, x = np.empty(3), np.empty(3)
    total, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for k in range(samples):
        weight = 1.0
        for i in range(3):
            at = 0.0
            for j in range(i):
                at += L[i, j] * y[j]
            below = _phi((low[i] - at) / L[i, i])
            mass = _phi((high[i] - at) / L[i, i]) - below
            u = ((k + 1) * step[i] + shift[i]) % 1.0
            u = abs(2.0 * u - 1.0)
            y[i] = _phi_inverse(min(max(below + u * mass, 1e-300), 1.0 - 1e-16))
            x[i] = at + L[i, i] * y[i]
            weight *= mass
        total += weight
        for i in range(3):
            first[i] += weight * x[i]
            for j in range(i, 3):
                second[i, j] += weight * x[i] * x[j]
    for i in range(3):
        out_mean[i] = mean[i] + first[i] / total
        for j in range(i, 3):
            value = second[i, j] / total - first[i] * first[j] / (total * total)
            out_cov[i, j] = out_cov[j, i] = value
    return total / samples


def runtime_accuracy(
    rng: np.random.Generator,
    boxes: int = 10,
    shifts: int = 10,
    rounds: int = 5,
    progress: Callable[[float], None] | None = None,
) -> list[Accuracy]:
    """The paper's table in one run: each N of SAMPLES, then `box_moments`, on the same boxes.

    Boxes are ordinary: unit deviations, correlations of a random factor, half widths of 0.5 to 2
    deviations, centres within one. The reference is a tensor rule in three dimensions,
    independent of both.

    Args:
        rng: draws boxes and shifts.
        boxes: their number.
        shifts: lattices of each box.
        rounds: of timing.
        progress: called with the share done.
    """
    means, covs, lowers, uppers = ordinary_boxes(rng, boxes)
    exact = [tensor_moments(*box) for box in zip(means, covs, lowers, uppers, strict=True)]
    rows = []
    for number, samples in enumerate([*SAMPLE_COUNTS, 0]):
        draws = rng.random((shifts if samples else 1, boxes, 3))
        out = evaluate_boxes(means, covs, lowers, uppers, samples, draws)
        errors = [
            (
                (out[0][s, b] - exact[b][0]) ** 2,
                np.sum((out[1][s, b] - exact[b][1]) ** 2),
                np.sum((out[2][s, b] - exact[b][2]) ** 2),
            )
            for s in range(len(draws))
            for b in range(boxes)
        ]
        repeats = np.repeat(draws[:1], max(1, 2000 // max(samples, 50)), axis=0)
        fastest = np.inf
        for _ in range(rounds):
            started = perf_counter()
            evaluate_boxes(means, covs, lowers, uppers, samples, repeats)
            fastest = min(fastest, perf_counter() - started)
        milliseconds = 1e3 * fastest / (len(repeats) * boxes)
        probability, mean, cov = np.sqrt(np.mean(errors, axis=0)).tolist()
        rows.append(Accuracy(samples or None, milliseconds, probability, mean, cov))
        if progress:
            progress((number + 1) / (len(SAMPLE_COUNTS) + 1))
    return rows


def ordinary_boxes(rng: np.random.Generator, count: int):
    """Means (B, 3), covariances (B, 3, 3), lower and upper bounds (B, 3), with unit variances."""
    factors = np.eye(3) + 0.5 * rng.standard_normal((count, 3, 3))
    covs = factors @ np.swapaxes(factors, 1, 2)
    std = np.sqrt(np.einsum("bii->bi", covs))
    covs = covs / std[:, :, None] / std[:, None, :]
    centre, half = rng.uniform(-1.0, 1.0, (count, 3)), rng.uniform(0.5, 2.0, (count, 3))
    return np.zeros((count, 3)), covs, centre - half, centre + half


def tensor_moments(mean, cov, lower, upper) -> tuple[float, np.ndarray, np.ndarray]:
    """Probability and moments by a Gauss-Legendre rule of 48 nodes per axis, for ordinary boxes."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    half, centre = 0.5 * (upper - lower), 0.5 * (upper + lower)
    axes = np.meshgrid(*(centre[:, None] + half[:, None] * nodes), indexing="ij")
    z = np.stack([a.ravel() for a in axes], axis=1) - mean
    w = np.einsum("i,j,k->ijk", weights, weights, weights).ravel() * np.prod(half)
    w = w * np.exp(-0.5 * np.einsum("ni,ij,nj->n", z, np.linalg.inv(cov), z))
    w /= np.sqrt((2 * np.pi) ** 3 * np.linalg.det(cov))
    total = w.sum()
    first = w @ z / total
    centred = z - first
    return float(total), mean + first, np.einsum("n,ni,nj->ij", w, centred, centred) / total


def evaluate_boxes(means, covs, lowers, uppers, samples: int, shifts):
    """Probabilities (S, B), means (S, B, 3) and covariances (S, B, 3, 3).

    Args:
        means: (B, 3), of the Gaussians.
        covs: (B, 3, 3), of the Gaussians.
        lowers: (B, 3), bounds.
        uppers: (B, 3), bounds.
        samples: points of a lattice; 0 for quadrature.
        shifts: (S, B, 3) in [0, 1), of the lattices.
    """
    S, B = shifts.shape[:2]
    out = np.empty((S, B)), np.empty((S, B, 3)), np.empty((S, B, 3, 3))
    _evaluate(means, covs, lowers, uppers, samples, shifts, *out)
    return out


@kernel
def _evaluate(means, covs, lowers, uppers, samples, shifts, prob, mean, cov):
    for s in range(shifts.shape[0]):
        for b in range(shifts.shape[1]):
            box, out = (means[b], covs[b], lowers[b], uppers[b]), (mean[s, b], cov[s, b])
            if samples:
                prob[s, b] = qmc_moments(*box, samples, shifts[s, b], *out)
            else:
                prob[s, b] = math.exp(box_moments_kernel(*box, *out))


@kernel
def _phi(x: float) -> float:
    return 0.5 * math.erfc(-x * 0.7071067811865476)


@kernel
def _phi_inverse(p: float) -> float:
    """Standard normal quantile to 16 digits (Wichura, algorithm AS 241, Applied Statistics 37)."""
    q = p - 0.5
    if abs(q) <= 0.425:
        return q * _ratio(0.180625 - q * q, _MIDDLE)
    r = math.sqrt(-math.log(min(p, 1.0 - p)))
    x = _ratio(r - 1.6, _TAIL) if r <= 5.0 else _ratio(r - 5.0, _FAR)
    return x if q > 0.0 else -x


@kernel
def _ratio(r: float, c) -> float:
    """The quotient of two polynomials of degree seven, lowest coefficients first."""
    above = ((((((c[7] * r + c[6]) * r + c[5]) * r + c[4]) * r + c[3]) * r + c[2]) * r + c[1]) * r
    below = ((((((c[15] * r + c[14]) * r + c[13]) * r + c[12]) * r + c[11]) * r + c[10]) * r) + c[9]
    return (above + c[0]) / (below * r + c[8])
