"""Contact points in the state: rolling, insertion, removal and update (Hartley 2020, Sec. IV-V).

Extra k of the packed state is the centre d of foot k in G while the foot stands, and zero with a
zero covariance while it swings. Leg kinematics measure f = R_GI^T (d - p), a right-invariant output
with

    H = R_GI^T [0 0 I ... -I ...] on (position, that contact).

A spherical foot of radius r that rolls without slipping on ground of normal e_z (G) moves its
centre at omega x r e_z, with omega = R_GI (gyro - b_g + rate of the foot relative to the body).
With W = omega dt the error of the contact point follows

    xi_d' = xi_d + r [W]x [e_z]x xi_R + ([d']x - r [e_z]x) B_R delta b_g.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from surefoot.estimator.core.checks import (
    MOST_RATE,
    MOST_REACH,
    all_within,
    is_sound,
    is_step,
    symmetric_definite,
)
from surefoot.estimator.core.propagation import (
    add_cross_columns,
    propagate_covariance,
    propagate_mean,
)
from surefoot.estimator.core.state import B_A, B_G, EXTRA, P, V
from surefoot.estimator.evaluation.innovation_sums import (
    LEFT_OUT,
    RESTARTED,
    add_innovation,
)
from surefoot.estimator.updates.velocity import gaussian_update
from surefoot.sim.common.copies import copy_corner
from surefoot.sim.common.kernels import OWN_1, OWN_2, kernel

AVERAGED = 0.02
"""Time constant of the running mean of innovations [s]: in it, a slip of 0.5 m/s moves a foot by 1
cm, five standard deviations of a foot's position.
"""
HOLD = 0.1
"""Time for which a foot that slipped is left out [s]: a third of a stance."""
PROVEN = 0.05
"""Time for which a foot must pass its test to be trusted [s]: short compared with a stance, long
compared with AVERAGED, so that a sliding foot has failed by then.
"""
WAY_BACK = 1.0
"""Time without a trusted foot, while some are sensed in contact, after which the estimate is
doubted instead [s]. Every foot has then landed anew and failed, twice in most gaits, and a tilt of
0.02 rad has caused 0.2 m/s.
"""
REOPENED = np.array([0.05, 1.0, 0.1, 5e-3])
"""Standard deviations of tilt [rad], velocity [m/s] and biases [m/s^2, rad/s] after such a reset,
for tilt and velocity in addition to the filter's own. Those of a start from gravity alone
(`surefoot.estimator.initial`), except for the velocity, which is the speed of a walk.
"""


class ContactModel(NamedTuple):
    """Constants of the leg filter.

    Attributes:
        imu_noise: (4, 3), from `FilterNoise.packed`.
        contact_noise: squared densities along G's axes (3,) [m^2/s].
        rolling_noise: squared density of the error of the feet's rates [rad^2/s].
        radius: of the feet (K,) [m].
        gate: squared Mahalanobis distance beyond which a foot slips.
    """

    imu_noise: np.ndarray
    contact_noise: np.ndarray
    rolling_noise: float
    radius: np.ndarray
    gate: float


class ContactMemory(NamedTuple):
    """State carried from sample to sample, changed in place.

    Attributes:
        mean: (7+K, 3), see `surefoot.estimator.core.state`.
        covariance: (15+3K, 15+3K).
        columns: (15+3K, 6), work space.
        rotation_columns: (3K, 3), work space.
        standing: feet in the state (K,) bool.
        drift: running means of their whitened innovations (K, 3).
        held: time for which a foot that slipped is still left out (K,) [s].
        passed: time for which a foot has passed its test (K,) [s].
        clock: times [s] SINCE the last update, and for which all feet sensed in contact were
            UNPROVEN (2,).
        rates: of the feet at the last prediction (K, 3) [rad/s], NaN before the first.
        biases: b_a and b_g at the start (2, 3).
    """

    mean: np.ndarray
    covariance: np.ndarray
    columns: np.ndarray
    rotation_columns: np.ndarray
    standing: np.ndarray
    drift: np.ndarray
    held: np.ndarray
    passed: np.ndarray
    clock: np.ndarray
    rates: np.ndarray
    biases: np.ndarray


SINCE, UNPROVEN = 0, 1
"""Indices into the clock of a ContactMemory."""


def contact_memory(mean: np.ndarray, covariance: np.ndarray) -> ContactMemory:
    """Initial memory of a filter with this mean (7+K, 3) and covariance (15+3K, 15+3K)."""
    feet = len(mean) - EXTRA
    return ContactMemory(
        mean,
        covariance,
        columns=np.zeros((15 + 3 * feet, 6)),
        rotation_columns=np.zeros((3 * feet, 3)),
        standing=np.zeros(feet, dtype=np.bool_),
        drift=np.zeros((feet, 3)),
        held=np.zeros(feet),
        passed=np.zeros(feet),
        clock=np.zeros(2),
        rates=np.full((feet, 3), np.nan),
        biases=mean[[B_A, B_G]],
    )


@kernel
def propagate_contacts(memory, model, gyro, accel, dt: float, rates):
    """One IMU step with rolling contact points, in place.

    Args:
        memory: ContactMemory.
        model: ContactModel.
        gyro: mean over the step (3,) [rad/s], in I.
        accel: mean over the step (3,) [m/s^2], in I.
        dt: the step [s].
        rates: the feet's angular velocities relative to the body (K, 3) [rad/s] now, in I; averaged
            with the last call's over the step.
    """
    mean, covariance = memory.mean, memory.covariance
    columns, rotation_columns = memory.columns, memory.rotation_columns
    standing, radius = memory.standing, model.radius
    omega = np.empty(3)
    W = np.empty(3)
    for i in range(3):
        omega[i] = gyro[i] - mean[B_G, i]
    propagate_mean(mean, gyro, accel, dt, columns)
    known = standing.shape[0] > 0 and not np.isnan(memory.rates[0, 0])
    for k in range(standing.shape[0]):
        at = 15 + 3 * k
        rotation_columns[3 * k : 3 * k + 3] = 0.0
        columns[at : at + 3] = 0.0
        if not standing[k]:
            continue
        r = radius[k]
        for i in range(3):
            # -B_R maps a rate in I to an angle in G, with the step's mean attitude.
            W[i] = 0.0
            for m in range(3):
                before = memory.rates[k, m] if known else rates[k, m]
                W[i] -= columns[i, 3 + m] * (omega[m] + 0.5 * (before + rates[k, m]))
        mean[EXTRA + k, 0] += r * W[1]
        mean[EXTRA + k, 1] -= r * W[0]
        rotation_columns[3 * k, 0] = -r * W[2]
        rotation_columns[3 * k + 1, 1] = -r * W[2]
        rotation_columns[3 * k + 2, 0] = r * W[0]
        rotation_columns[3 * k + 2, 1] = r * W[1]
        add_cross_columns(mean[EXTRA + k], columns, at)
        for j in range(3, 6):
            columns[at, j] += r * columns[1, j]
            columns[at + 1, j] -= r * columns[0, j]
    propagate_covariance(covariance, columns, rotation_columns, dt, model.imu_noise)
    for k in range(standing.shape[0]):
        if standing[k]:
            for i in range(3):
                roll = radius[k] ** 2 * model.rolling_noise if i < 2 else 0.0
                at = 15 + 3 * k + i
                covariance[at, at] += (model.contact_noise[i] + roll) * dt
    copy_corner(rates, memory.rates)
    memory.clock[SINCE] += dt


_ARRAYS = (*4 * (OWN_2,), types.boolean[::1], OWN_2, *3 * (OWN_1,), *2 * (OWN_2,))
_MEMORY = types.NamedTuple(_ARRAYS, ContactMemory)
_MODEL = types.NamedTuple((OWN_2, OWN_1, types.float64, OWN_1, types.float64), ContactModel)
PREDICT_CONTACTS = types.boolean(_MEMORY, _MODEL, OWN_1, OWN_1, types.float64, OWN_2)
UPDATE_CONTACTS = types.boolean(
    _MEMORY, types.float64, OWN_2, types.boolean[::1], types.float64[:, :, ::1]
)
"""Signatures of the two functions that follow."""


@kernel
def predict_contacts(memory, model, gyro, accel, dt: float, rates) -> bool:
    """`propagate_contacts` for a robot's own loop: False, with nothing changed, where sample or
    state fail the checks.

    Args:
        memory: ContactMemory.
        model: ContactModel.
        gyro: mean over the step (3,) [rad/s], in I.
        accel: mean over the step (3,) [m/s^2], in I.
        dt: the step [s].
        rates: the feet's angular velocities relative to the body (K, 3) [rad/s] now, in I.
    """
    if not is_step(gyro, accel, dt) or not all_within(rates.reshape(-1), MOST_RATE):
        return False
    if rates.shape != memory.rates.shape or not is_sound(memory.mean, memory.covariance):
        return False
    propagate_contacts(memory, model, gyro, accel, dt, rates)
    return True


@kernel
def update_contacts_checked(memory, gate: float, feet_I, in_contact, measurement_cov) -> bool:
    """`update_contacts` for a robot's own loop: False, with nothing changed, where measurements or
    state fail the checks.

    Args:
        memory: ContactMemory.
        gate: of `ContactModel`.
        feet_I: centres of the feet (K, 3) [m] in I.
        in_contact: (K,) bool.
        measurement_cov: of feet_I (K, 3, 3) [m^2].
    """
    feet = memory.standing.shape[0]
    if feet_I.shape != (feet, 3) or measurement_cov.shape != (feet, 3, 3):
        return False
    if in_contact.shape[0] != feet or not all_within(feet_I.reshape(-1), MOST_REACH):
        return False
    symmetric = np.empty((3, 3))
    for k in range(feet):
        if not np.isfinite(measurement_cov[k]).all():
            return False
        if in_contact[k] and not symmetric_definite(measurement_cov[k], symmetric):
            return False
    if not is_sound(memory.mean, memory.covariance):
        return False
    unread = np.zeros((feet, 10))
    update_contacts(memory, gate, feet_I, in_contact, measurement_cov, unread)
    return True


@kernel
def update_contacts(memory, gate: float, feet_I, in_contact, measurement_cov, sums):
    """Remove lifted feet, update with the standing ones and insert new ones, in place.

    A foot found slipping (see `_slips`) leaves the state and stays out for HOLD, or until it lifts
    off. If no foot sensed in contact is trusted for WAY_BACK, the estimate rather than the feet is
    at fault, and its covariance is increased (see `_reopen`).

    Args:
        memory: ContactMemory.
        gate: of `ContactModel`.
        feet_I: centres of the feet (K, 3) [m] in I.
        in_contact: (K,) bool.
        measurement_cov: of feet_I (K, 3, 3) [m^2].
        sums: of each foot's innovations, to add to (K or more, 10), see
            `surefoot.estimator.evaluation.innovation_sums`.
    """
    mean, covariance, standing = memory.mean, memory.covariance, memory.standing
    held, passed, feet = memory.held, memory.passed, memory.standing.shape[0]
    n = covariance.shape[0]
    PHt, S, residual = np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
    since = memory.clock[SINCE]
    memory.clock[SINCE] = 0.0
    for k in range(feet):
        held[k] -= since
        if held[k] < 0.5 * since or not in_contact[k]:
            held[k] = 0.0
        if standing[k] and not in_contact[k]:
            _remove(memory, k)
    claimed = believed = False
    for k in range(feet):
        claimed |= in_contact[k]
        if not standing[k]:
            continue
        contact_output(mean, covariance, k, feet_I[k], PHt, S, residual)
        if np.isfinite(gate) and _slips(
            S, measurement_cov[k], residual, gate, min(since / AVERAGED, 1.0), memory.drift[k]
        ):
            _remove(memory, k)
            held[k] = HOLD
        else:
            distance = gaussian_update(mean, covariance, feet, PHt, S, residual, measurement_cov[k])
            add_innovation(sums[k], distance, residual, S, measurement_cov[k])
            passed[k] += since
            believed |= passed[k] > PROVEN
    if believed:
        memory.clock[UNPROVEN] = 0.0
    elif claimed:
        memory.clock[UNPROVEN] += since
    if memory.clock[UNPROVEN] > WAY_BACK and np.any(held > 0.0):
        memory.clock[UNPROVEN] = 0.0
        for k in range(feet):
            sums[k, RESTARTED] += in_contact[k]
            held[k] = 0.0
            if standing[k]:
                _remove(memory, k)
        _reopen(mean, covariance, memory.biases)
    for k in range(feet):
        if held[k] > 0.0:
            sums[k, LEFT_OUT] += 1.0
        elif in_contact[k] and not standing[k]:
            _insert(mean, covariance, k, feet_I[k], measurement_cov[k])
            standing[k] = True
            passed[k] = 0.0
            for i in range(3):
                memory.drift[k, i] = 0.0


@kernel
def _reopen(mean, covariance, biases):
    """Increase the covariance of tilt, velocity and biases, in place; no foot is in the state.

    Biases restart from their initial values, since wrong updates may have driven them anywhere.
    Independent errors d of tilt in G add (d, [v]x d, [p]x d) to the right-invariant error, as in
    `surefoot.estimator.initial.start_covariance`; position and yaw keep their covariance.

    Args:
        mean: (7+K, 3), the packed mean.
        covariance: (15+3K, 15+3K).
        biases: b_a [m/s^2] and b_g [rad/s] at the start (2, 3).
    """
    copy_corner(biases, mean[B_A : B_G + 1])
    covariance[9:15, :] = 0.0
    covariance[:, 9:15] = 0.0
    for axis in range(2):
        direction = np.zeros(9)
        direction[axis] = 1.0
        for at, row in ((3, V), (6, P)):  # [x]x e_axis
            direction[at + (axis + 1) % 3] = mean[row, (axis + 2) % 3]
            direction[at + (axis + 2) % 3] = -mean[row, (axis + 1) % 3]
        for i in range(9):
            for j in range(9):
                covariance[i, j] += REOPENED[0] ** 2 * direction[i] * direction[j]
    for i in range(3):
        covariance[3 + i, 3 + i] += REOPENED[1] ** 2
        covariance[9 + i, 9 + i] += REOPENED[2] ** 2
        covariance[12 + i, 12 + i] += REOPENED[3] ** 2


@kernel
def _slips(S, measurement_cov, residual, gate: float, newest: float, drift) -> bool:
    """Chi-square test (3 degrees of freedom) of one innovation and of their running mean.

    Innovations of a consistent filter are white with covariance S + R. A slip of 0.5 m/s moves a
    foot by only a millimetre per update, which no single innovation reveals, but the exponential
    mean `drift` of the whitened ones does, whose variance is newest / (2 - newest).

    Args:
        S: (3, 3) [m^2], H Sigma H^T.
        measurement_cov: (3, 3) [m^2], of the measured foot position.
        residual: (3,) [m] in I, the innovation.
        gate: threshold of chi-square.
        newest: weight of this innovation in the running mean, > 0.
        drift: (3,), the running mean of whitened innovations, in place.
    """
    L = np.zeros((3, 3))
    white = np.empty(3)
    single = 0.0
    running = 0.0
    for i in range(3):
        white[i] = residual[i]
        for j in range(i + 1):
            total = S[i, j] + measurement_cov[i, j]
            for m in range(j):
                total -= L[i, m] * L[j, m]
            L[i, j] = np.sqrt(total) if i == j else total / L[j, j]
            if j < i:
                white[i] -= L[i, j] * white[j]
        white[i] /= L[i, i]
        drift[i] += newest * (white[i] - drift[i])
        single += white[i] ** 2
        running += drift[i] ** 2 * (2.0 - newest)
    return max(single, running / newest) > gate if newest > 0.0 else single > gate


@kernel
def contact_output(mean, covariance, k: int, foot_I, PHt, S, residual):
    """Predicted output of the contact of foot k.

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (n, n), n = 15+3E.
        k: index of the foot.
        foot_I: (3,) [m], measured foot position f in I.
        PHt: (n, 3), filled with Sigma H^T.
        S: (3, 3) [m^2], filled with H Sigma H^T.
        residual: (3,) [m], filled with f - R^T (d - p).
    """
    at = 15 + 3 * k
    for i in range(covariance.shape[0]):
        for j in range(3):
            PHt[i, j] = 0.0
            for m in range(3):
                PHt[i, j] += (covariance[i, 6 + m] - covariance[i, at + m]) * mean[m, j]
    for j in range(3):
        residual[j] = foot_I[j]
        for m in range(3):
            residual[j] -= mean[m, j] * (mean[EXTRA + k, m] - mean[P, m])
        for i in range(j + 1):
            S[i, j] = 0.0
            for m in range(3):
                S[i, j] += mean[m, i] * (PHt[6 + m, j] - PHt[at + m, j])
            S[j, i] = S[i, j]


@kernel
def _remove(memory, k: int):
    """Remove foot k: zero its row of the mean, and its rows and columns of the covariance."""
    at = 15 + 3 * k
    memory.standing[k] = False
    memory.mean[EXTRA + k] = 0.0
    memory.covariance[at : at + 3, :] = 0.0
    memory.covariance[:, at : at + 3] = 0.0


@kernel
def _insert(mean, covariance, k: int, foot_I, measurement_cov):
    """Insert foot k at d = p + R f, so xi_d = xi_p + R n_f (Hartley 2020, eq. 32).

    Args:
        mean: (7+E, 3), the packed mean, in place.
        covariance: (15+3E, 15+3E), in place.
        k: index of the foot.
        foot_I: (3,) [m], measured foot position f in I.
        measurement_cov: (3, 3) [m^2], its covariance in I.
    """
    at = 15 + 3 * k
    for i in range(3):
        mean[EXTRA + k, i] = mean[P, i]
        for m in range(3):
            mean[EXTRA + k, i] += mean[i, m] * foot_I[m]
    copy_corner(covariance[6:9], covariance[at : at + 3])
    copy_corner(covariance[:, 6:9], covariance[:, at : at + 3])
    for i in range(3):
        for j in range(3):
            for a in range(3):
                for b in range(3):
                    covariance[at + i, at + j] += mean[i, a] * measurement_cov[a, b] * mean[j, b]
