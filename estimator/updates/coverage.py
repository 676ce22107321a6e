"""The coverage update: the KL-minimal posterior under a set-mass constraint, moment matched.

The posterior of Theorem 1 (eq. posterior_piecewise) rescales the prior p inside and outside the set
C. Written with its truncation p_C it is a mixture of two densities,

    q = (1 - alpha) p + alpha p_C,     alpha = (gamma - pi) / (1 - pi),

since inside C this is p ((1 - alpha) + alpha / pi) = p gamma / pi, and outside it is p (1 - gamma)
/ (1 - pi). Its moments therefore need no moments of the complement (eq. complement_moments), whose
subtraction loses all digits as pi -> 1:

    mu+    = (1 - alpha) mu + alpha mu_C,
    Sigma+ = (1 - alpha) Sigma + alpha Sigma_C + alpha (1 - alpha) (mu_C - mu)(mu_C - mu)^T,

the values of eq. moment_matching, positive definite by construction for every pi in [0, gamma).

The mass pi+ of the matched Gaussian p+ in C satisfies pi < pi+ <= gamma (observed in the paper's
remark) for every set C and every gamma. q has the least KL divergence to the prior, kl(gamma || pi)
for two outcomes; matching moments projects q on the Gaussians, of which the prior is one, so

    kl(gamma || pi) = KL(q || p) = KL(q || p+) + KL(p+ || p) >= kl(gamma || pi+) + kl(pi+ || pi),

where the last step holds because distinguishing only C from its complement loses divergence. For
two outcomes the left side exceeds the right one by (gamma - pi+) (logit pi+ - logit pi), which is
therefore >= 0: pi+ lies between pi and gamma. It equals one of them only if p+ = p, which no box
allows (a truncated variance is smaller). The projection can therefore be repeated, and pi rises
towards gamma: `iterations`.
"""

import numpy as np
from numba import types

from surefoot.estimator.box import box_moments_kernel
from surefoot.estimator.core.checks import is_bounded, is_sound
from surefoot.estimator.core.state import EXTRA
from surefoot.estimator.updates.bias_states import accumulate_window, restart_window, window_output
from surefoot.estimator.updates.velocity import (
    GATHERED,
    LIMITS,
    VelocityMemory,
    is_outlier,
    lift,
    no_contacts,
    velocity_output,
)
from surefoot.sim.common.copies import copy_corner, copy_row
from surefoot.sim.common.kernels import GIVEN_1, OWN_2, kernel

FLOOR = 1e-6
"""Standard deviation [m/s] added to S. The set update adds no noise of its own; without a floor,
repeated statements about a motionless robot would make S singular to working precision.
"""


@kernel(inline="always")  # compiled by itself it would be another copy of the box's moments
def posterior_moments(mean, cov, lower, upper, gamma: float, mean_plus, cov_plus) -> float:
    """Moment-matched posterior of N(mean, cov) under P(lower <= z <= upper) >= gamma.

    mean (3,), cov (3, 3) and the bounds (3,) describe the prior and the box (eq.
    output_space_prior); mean_plus (3,) and cov_plus (3, 3) receive eq. moment_matching. Returns pi
    (eq. pi_def_error_state); where pi >= gamma the prior is returned unchanged.
    """
    truncated_mean, truncated_cov = np.empty(3), np.empty((3, 3))
    pi = np.exp(box_moments_kernel(mean, cov, lower, upper, truncated_mean, truncated_cov))
    alpha, keep = 0.0, 1.0
    if pi < gamma:  # keep is 1 - alpha, to the last digit where gamma is next to one
        alpha, keep = (gamma - pi) / (1.0 - pi), (1.0 - gamma) / (1.0 - pi)
    for i in range(3):
        mean_plus[i] = mean[i] + alpha * (truncated_mean[i] - mean[i])
        for j in range(3):
            between = (truncated_mean[i] - mean[i]) * (truncated_mean[j] - mean[j])
            cov_plus[i, j] = keep * cov[i, j] + alpha * (truncated_cov[i, j] + keep * between)
    return pi


@kernel(inline="always")
def update_coverage(mean, covariance, v_I, epsilon, gamma: float, iterations: int, memory) -> float:
    """Algorithm 1 of the paper on the packed state, in place; returns pi of the prior, nan for an
    outlier.

    With z = H delta X (eq. setup_feasible_set_lie_linear_augmented) the box is v_I - v_I_bar -+
    epsilon. The posterior of z is projected and matched up to `iterations` times and lifted once.
    In a state with a persistent part the statement is about the mean of a window: nan within one
    (see `surefoot.estimator.updates.bias_states`).

    Args:
        mean: packed state (7+E, 3), changed in place; its extras are no contact points.
        covariance: of its error (15+3E, 15+3E), changed in place.
        v_I: (3,) [m/s], pseudo-measurement of the IMU's velocity in I.
        epsilon: (3,) [m/s], its bounds or, of a window, those of the mean mixing error.
        gamma: their JOINT level, P(|v_I - v_I true| <= epsilon) >= gamma.
        iterations: of projection and matching; once in the paper.
        memory: VelocityMemory.
    """
    n, contacts = covariance.shape[0], no_contacts()
    persistent = mean.shape[0] > EXTRA
    PHt, S, residual = np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
    velocity_output(mean, covariance, contacts, v_I, PHt, S, residual)
    copy_corner(S, memory.innovation[:3])
    copy_row(residual, memory.innovation[3])
    if is_outlier(S, residual, memory):
        return np.nan
    if persistent:
        accumulate_window(mean, covariance, PHt, S, residual, 1.0 / memory.window)
        memory.counts[GATHERED] += 1
        if memory.counts[GATHERED] < memory.window:
            return np.nan
        memory.counts[GATHERED] = 0
        window_output(mean, covariance, PHt, S, residual)
    z_mean, z_cov = np.zeros(3), np.empty((3, 3))
    pi = projected(S, residual, epsilon, gamma, iterations, z_mean, z_cov)
    if pi < gamma:
        lift(mean, covariance, contacts, PHt, S, z_mean, z_cov)
    if persistent:
        restart_window(mean, covariance)
    return pi


UPDATE_COVERAGE = types.float64(
    *(OWN_2, OWN_2, GIVEN_1, GIVEN_1, types.float64, types.int64, *LIMITS)
)
"""Signature of `update_coverage_checked`."""


@kernel
def update_coverage_checked(
    mean, covariance, v_I, epsilon, gamma: float, iterations: int, max_error, window: int, counts
) -> float:
    """`update_coverage` for a robot's own loop, in one call.

    Checks measurement and state; returns -1, with nothing changed, if they fail.

    Args:
        mean: packed state (7+E, 3), changed in place.
        covariance: of its error (15+3E, 15+3E), changed in place.
        v_I: measured velocity (3,) [m/s].
        epsilon: bounds (3,) [m/s].
        gamma: their joint level.
        iterations: of the projection.
        max_error: of the VelocityMemory, as are window and counts.
        window: likewise.
        counts: likewise.
    """
    if not is_bounded(v_I, epsilon, gamma, iterations) or not is_sound(mean, covariance):
        return -1.0
    given = np.empty((6, 3))
    v, bounds = given[0], given[1]
    copy_row(v_I, v)
    copy_row(epsilon, bounds)
    memory = VelocityMemory(max_error, window, counts, given[2:])
    return update_coverage(mean, covariance, v, bounds, gamma, iterations, memory)


@kernel(inline="always")
def projected(S, residual, epsilon, gamma: float, iterations: int, z_mean, z_cov) -> float:
    """Project and match z ~ N(0, S) up to `iterations` times; returns pi of the prior.

    Args:
        S: (3, 3) [m^2/s^2]; a floor is added in place.
        residual: (3,) [m/s], the middle of the box.
        epsilon: (3,) [m/s], its half widths.
        gamma: joint level of the box.
        iterations: of projection and matching.
        z_mean: (3,), zeros, receives the posterior's mean.
        z_cov: (3, 3), receives its covariance.
    """
    floor = FLOOR**2 + 1e-10 * (S[0, 0] + S[1, 1] + S[2, 2])
    lower, upper = np.empty(3), np.empty(3)
    for i in range(3):
        S[i, i] += floor
        lower[i], upper[i] = residual[i] - epsilon[i], residual[i] + epsilon[i]
    copy_corner(S, z_cov)
    first = np.nan
    # One place of the call, since each would be another copy of the code.
    for k in range(iterations):
        before, spread = z_mean.copy(), z_cov.copy()
        pi = posterior_moments(before, spread, lower, upper, gamma, z_mean, z_cov)
        if k == 0:
            first = pi
        if not pi < gamma:
            break
    return first
