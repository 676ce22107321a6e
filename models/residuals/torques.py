"""Residuals of joint torques: against inverse dynamics in swing, and the wrench on the base.

All terms of the equation of motion are means over the same time steps of a bin; an acceleration is
the change of a rate over them. Joint rates are too noisy for a single bin, so the residual of the
equation is smoothed over three, with weights 1/4, 1/2, 1/4.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from surefoot.models.residuals.binning import BIN, Bins, ReferenceMotion, bin_mean
from surefoot.sim.common.kernels import kernel
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.log.derived import JOINT_WINDOW, derivative, steady_rate
from surefoot.sim.robot import Robot
from surefoot.sim.robot.inertia import LinkChange
from surefoot.sim.robot.inverse_dynamics import Dynamics
from surefoot.sim.robot.kinematics import leg_forward
from surefoot.sim.robot.machine import Machine


@dataclass(frozen=True)
class DynamicsInputs:
    """Inputs of inverse dynamics in each of M bins, for J joints and L feet.

    Attributes:
        q: angles (M, J) [rad].
        dq: rates (M, J) [rad/s].
        ddq: accelerations (M, J) [rad/s^2].
        tau: measured torques (M, J) [N m].
        base: angular rate, its derivative and specific force of the base (M, 9), in B.
        up_B: the ground's normal in B (M, 3).
        standing: feet in stance (M, L).
        swings: joints whose foot is in the air for three bins (M, J).
        steady: bins in which, and next to which, no foot lands or lifts (M,).
        sunk: reduction of the distance from a foot's centre to its contact point (M, L) [m].
        curved: means over the rows of each bin of the torques by inverse dynamics, less those at
            the means (M, J) [N m]; zero on a walk.
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    tau: np.ndarray
    base: np.ndarray
    up_B: np.ndarray
    standing: np.ndarray
    swings: np.ndarray
    steady: np.ndarray
    sunk: np.ndarray
    curved: np.ndarray


def dynamics_inputs(bins: Bins, robot: Machine) -> DynamicsInputs:
    """Prepare the bins of a log for inverse dynamics."""
    whole = np.zeros(len(bins.t), dtype=bool)
    gaps = np.abs(np.diff(bins.t) - BIN) < 0.25 * BIN
    whole[1:-1] = gaps[1:] & gaps[:-1]
    # The equation is smoothed over three bins, each of which needs the rate before it.
    whole = _always(whole)
    stays, lifted = _always(bins.standing), _always(bins.lifted)
    up_B = np.zeros((len(bins.t), 3))
    if robot.legged is not None:
        up_B = bins.normal_I @ robot.legged.R_BI.T
        # Joints that belong to no leg carry no foot's load.
        swings = np.ones_like(bins.q, dtype=bool)
        if bins.q.shape[1] == len(robot.limbs.joints):  # else the log has no angles
            for leg, chain in enumerate(robot.limbs.chains):
                swings[:, chain] = lifted[:, [leg]]
        steady = (stays | lifted).all(axis=1) & stays.any(axis=1)
    else:
        swings, steady = np.ones_like(bins.q, dtype=bool), np.zeros(len(bins.t), dtype=bool)
    return DynamicsInputs(
        q=bins.q_step,
        dq=bins.dq_step,
        ddq=bins.ddq,
        tau=bins.tau,
        base=bins.base,
        up_B=up_B,
        standing=bins.standing,
        swings=swings & whole[:, None],
        steady=steady & whole,
        sunk=np.zeros(bins.standing.shape),
        curved=np.zeros_like(bins.q),
    )


def curvature(log: Log, motion: ReferenceMotion, dynamics: Dynamics) -> np.ndarray:
    """Means over the rows of each bin of the torques by inverse dynamics, less those at the means
    (M, J) [N m]: within a bin, inertia and weight do not change linearly.
    """

    def made() -> np.ndarray:
        q, mean = log.q, bin_mean(motion)
        slow = derivative(log.t, q, JOINT_WINDOW, causal=False) if motion.rates_of_angles else None
        dq = steady_rate(log.t, joint_velocity(log) if slow is None else slow)
        rates = q, dq, np.gradient(dq, log.t, axis=0)
        _, of_rows = dynamics.inverse(*rates)
        _, of_means = dynamics.inverse(*map(mean, rates))
        return mean(of_rows) - of_means

    return log.once("curvature of torques", ("q", "dq"), made, dynamics, motion)


def smooth_121(x: np.ndarray) -> np.ndarray:
    """Smooth x (M, ...) with weights 1/4, 1/2, 1/4; the ends stay as they are."""
    out = x.copy()
    out[1:-1] = 0.25 * x[:-2] + 0.5 * x[1:-1] + 0.25 * x[2:]
    return out


def slope(x: np.ndarray) -> np.ndarray:
    """Central difference of x (M, ...) per second."""
    out = np.zeros_like(x)
    out[1:-1] = (x[2:] - x[:-2]) / (2 * BIN)
    return out


@dataclass(frozen=True)
class InverseDynamics:
    """Wrench (M, 6) on the base, in B about its origin, and joint torques (M, J) for the motion."""

    wrench: np.ndarray
    torque: np.ndarray


def inverse_dynamics(s: DynamicsInputs, robot: Machine) -> InverseDynamics | None:
    """Inverse dynamics of the declared model with its declared masses; None without a model.

    Bins that no residual needs are zero.
    """
    if robot.dynamics is None:
        return None
    use = needed_bins(s)
    wrench, torque = np.zeros((len(s.q), 6)), np.zeros_like(s.q)
    wrench[use], torque[use] = robot.dynamics.inverse(s.q[use], s.dq[use], s.ddq[use], s.base[use])
    return InverseDynamics(wrench + load_wrench(s, robot), torque + s.curved)


def needed_bins(s: DynamicsInputs) -> np.ndarray:
    """Bins (M,) whose inverse dynamics a residual needs."""
    return dilate(s.swings.any(axis=1) | s.steady)


def link_jacobians(s: DynamicsInputs, dynamics: Dynamics) -> np.ndarray:
    """Derivatives (5, J, nv, K) of the generalised forces by each link's mass, centre and inertia,
    in the K needed bins.
    """
    use = needed_bins(s)
    return dynamics.link_derivatives(s.q[use], s.dq[use], s.ddq[use], s.base[use])


def with_link_change(
    needed: InverseDynamics,
    change: LinkChange,
    by_links: np.ndarray,
    s: DynamicsInputs,
    dynamics: Dynamics,
) -> InverseDynamics:
    """Inverse dynamics with one more change of a link, to first order.

    Args:
        needed: inverse dynamics without the change.
        change: of one link.
        by_links: `link_jacobians` of the robot.
        s: inputs of both.
        dynamics: of the robot.
    """
    sizes = (change.mass, *change.com, change.inertia)
    gained = np.tensordot(sizes, by_links[:, change.joint], 1).T
    use, wrench, torque = needed_bins(s), needed.wrench.copy(), needed.torque.copy()
    more = dynamics.parted(gained)
    wrench[use] += more[0]
    torque[use] += more[1]
    return InverseDynamics(wrench, torque)


def load_wrench(s: DynamicsInputs, machine: Machine) -> np.ndarray:
    """Wrench (M, 6) for the declared payload and shift of the base's centre of mass."""
    wrench, robot = np.zeros((len(s.q), 6)), machine.legged
    if robot is None or not (robot.extras.payload or robot.extras.com_shift.any()):
        return wrench
    omega, spin, force = s.base[:, :3], s.base[:, 3:6], s.base[:, 6:]
    body = robot.dynamics.model.body(robot.base_name)
    shift, mass, place = robot.extras.com_shift, float(body.mass[0]), body.ipos
    felt = [
        force + np.cross(spin, c) + np.cross(omega, np.cross(omega, c))
        for c in (place, place + shift)
    ]
    wrench[:, :3] = mass * (felt[1] - felt[0]) + robot.extras.payload * force
    wrench[:, 3:] = mass * (np.cross(place + shift, felt[1]) - np.cross(place, felt[0]))
    return wrench


@lru_cache(maxsize=16)
def declared(file: Path) -> Robot:
    """The robot as in its file."""
    return Robot.load(file)


def torque_residual(s: DynamicsInputs, needed: InverseDynamics) -> np.ndarray:
    """Measured torque minus inverse dynamics (M, J) [N m], NaN where a foot is loaded."""
    return np.where(s.swings, smooth_121(s.tau - needed.torque), np.nan)


def wrench_residual(s: DynamicsInputs, needed: InverseDynamics, robot: Robot) -> np.ndarray:
    """Wrench of the feet on the base minus inverse dynamics (M, 6), in B; NaN where unsteady."""
    return np.where(s.steady[:, None], smooth_121(unbalanced_wrench(s, needed, robot)), np.nan)


def unbalanced_wrench(s: DynamicsInputs, needed: InverseDynamics, robot: Robot) -> np.ndarray:
    """Wrench (M, 6), in B, of the standing feet on the base minus inverse dynamics.

    The leg rows of the equation of motion give each standing foot's force: J^T f = inverse dynamics
    - measured torque.
    """
    return standing_feet_wrenches(s, s.q, needed.torque - s.tau, robot).sum(axis=1) - needed.wrench


def standing_feet_wrenches(
    s: DynamicsInputs, q: np.ndarray, taken: np.ndarray, robot: Robot
) -> np.ndarray:
    """Wrench (M, L, 6) of each standing foot on the base, at angles q (M, J).

    taken (M, J): J^T f, torques by inverse dynamics minus measured ones.
    """
    radius = np.maximum(robot.foot_radius - s.sunk, 0.0)
    return feet_wrenches(robot.legs, radius, q, s.up_B, s.standing, np.ascontiguousarray(taken))


@kernel
def feet_wrenches(legs, radius, q, up, standing, taken):
    """Force and moment (M, L, 6) [N, N m] of each standing foot on the base, in B about its origin.

    For legs of three joints.

    Args:
        legs: geometry of the legs, as of `leg_forward`.
        radius: (M, L) [m], of the feet.
        q: (M, J) [rad].
        up: (M, 3), the ground's normal in B.
        standing: (M, L) bool.
        taken: (M, J) [N m], J^T f.
    """
    out = np.zeros((len(q), standing.shape[1], 6))
    foot, f, J, axes = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(q)):
        for leg in range(standing.shape[1]):
            if not standing[k, leg]:
                continue
            leg_forward(legs, leg, q[k], foot, J, axes)
            # At the contact point, below the sphere's centre.
            for a in range(3):
                foot[a] -= radius[k, leg] * up[k, a]
            for j in range(3):
                for a in range(3):
                    b, c = (a + 1) % 3, (a + 2) % 3
                    J[a, j] -= radius[k, leg] * (axes[b, j] * up[k, c] - axes[c, j] * up[k, b])
            # Solve J^T f = taken by Cramer's rule.
            f[:], volume = 0.0, 0.0
            for j in range(3):
                m, n = (j + 1) % 3, (j + 2) % 3
                for a in range(3):
                    b, c = (a + 1) % 3, (a + 2) % 3
                    normal = J[b, m] * J[c, n] - J[c, m] * J[b, n]
                    f[a] += taken[k, legs.joints[leg, j]] * normal
                    if j == 0:
                        volume += J[a, 0] * normal
            for a in range(3):
                f[a] = f[a] / volume if volume else np.nan
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                out[k, leg, a] = f[a]
                out[k, leg, 3 + a] = foot[b] * f[c] - foot[c] * f[b]
    return out


def dilate(flag: np.ndarray) -> np.ndarray:
    """Bins (M,) that have the flag or are next to one that has it."""
    out = flag.copy()
    out[1:] |= flag[:-1]
    out[:-1] |= flag[1:]
    return out


def _always(flag: np.ndarray) -> np.ndarray:
    """Bins (M, L) that have the flag, as do both their neighbours."""
    out = np.zeros_like(flag)
    out[1:-1] = flag[:-2] & flag[1:-1] & flag[2:]
    return out
