"""Residuals of joint torques: against inverse dynamics in swing, and the wrench on the base.

All terms of the equation of motion are means over the same time steps of a bin; an acceleration is
the change of a rate over them. Joint rates are too noisy for a single bin, so the residual of the
equation is smoothed over three, with weights 1/4, 1/2, 1/4.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from surefoot.models.residuals.binning import BIN, Bins, ReferenceMotion, bin_mean
from surefoot.models.residuals.feet import HALFWAY
from surefoot.sim.common.kernels import kernel
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.log.derived import JOINT_WINDOW, derivative, steady_rate
from surefoot.sim.robot import Robot
from surefoot.sim.robot.inverse_dynamics import Dynamics
from surefoot.sim.robot.kinematics import leg_forward
from surefoot.sim.robot.machine import Machine


@dataclass(frozen=True)
class DynamicsInputs:
    """Inputs of inverse dynamics in each of M bins, for J joints and L feet.

    Attributes:
        bins: means over the bins.
        up_B: the ground's normal in B (M, 3).
        swings: joints whose foot is in the air for three bins (M, J).
        steady: bins in which, and next to which, no foot lands or lifts (M,).
        curved: means over the rows of each bin of the torques by inverse dynamics, less those at
            the means (M, J) [N m]; zero on a walk.
    """

    bins: Bins
    up_B: np.ndarray
    swings: np.ndarray
    steady: np.ndarray
    curved: np.ndarray | float = 0.0

    @cached_property
    def needed(self) -> np.ndarray:
        """Bins (K,) whose inverse dynamics a residual needs."""
        return np.flatnonzero(dilate(self.swings.any(axis=1) | self.steady))

    @cached_property
    def motion(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Angles, rates, accelerations and motion of the base in the needed bins."""
        b, use = self.bins, self.needed
        return b.q_step[use], b.dq_step[use], b.ddq[use], b.base[use]


def dynamics_inputs(bins: Bins, robot: Machine) -> DynamicsInputs:
    """Prepare the bins of a log for inverse dynamics."""
    whole = np.zeros(len(bins.t), dtype=bool)
    gaps = np.abs(np.diff(bins.t) - BIN) < 0.25 * BIN
    whole[1:-1] = gaps[1:] & gaps[:-1]
    # The equation is smoothed over three bins, each of which needs the rate before it.
    whole = np.asarray(minimum_filter1d(whole, 3, mode="constant"), bool)
    up_B = np.zeros((len(bins.t), 3))
    # Joints that belong to no leg carry no foot's load.
    swings, steady = np.ones_like(bins.q, dtype=bool), np.zeros_like(whole)
    if robot.legged is not None:
        up_B = bins.normal_I @ robot.legged.R_BI.T
        stays, lifted = (
            np.asarray(minimum_filter1d(flag, 3, axis=0, mode="constant"), bool)
            for flag in (bins.standing, bins.lifted)
        )
        if bins.q.shape[1] == len(robot.limbs.joints):  # else the log has no angles
            for leg, chain in enumerate(robot.limbs.chains):
                swings[:, chain] = lifted[:, [leg]]
        steady = (stays | lifted).all(axis=1) & stays.any(axis=1)
    return DynamicsInputs(bins, up_B, swings & whole[:, None], steady & whole)


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
    wrench, torque = load_wrench(s.bins, robot), np.zeros_like(s.bins.q)
    more, torque[s.needed] = robot.dynamics.inverse(*s.motion)
    wrench[s.needed] += more
    return InverseDynamics(wrench, torque + s.curved)


def load_wrench(bins: Bins, machine: Machine) -> np.ndarray:
    """Wrench (M, 6) for the declared payload and shift of the base's centre of mass."""
    wrench, robot = np.zeros((len(bins.q), 6)), machine.legged
    if robot is None or not (robot.extras.payload or robot.extras.com_shift.any()):
        return wrench
    omega, spin, force = np.hsplit(bins.base, 3)
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


def unbalanced_wrench(s: DynamicsInputs, needed: InverseDynamics, robot: Robot) -> np.ndarray:
    """Wrench (M, 6), in B, of the standing feet on the base minus inverse dynamics.

    The leg rows of the equation of motion give each standing foot's force: J^T f = inverse dynamics
    - measured torque.
    """
    taken = needed.torque - s.bins.tau
    return standing_feet_wrenches(s, s.bins.q_step, taken, robot).sum(axis=1) - needed.wrench


def standing_feet_wrenches(
    s: DynamicsInputs, q: np.ndarray, taken: np.ndarray, robot: Robot
) -> np.ndarray:
    """Wrench (M, L, 6) of each standing foot on the base, at angles q (M, J).

    taken (M, J): J^T f, torques by inverse dynamics minus measured ones.
    """
    stands, depth = s.bins.standing, s.bins.depth
    sunk = np.zeros(stands.shape) if depth is None else HALFWAY * depth
    radius = np.maximum(robot.foot_radius - sunk, 0.0)
    return feet_wrenches(robot.legs, radius, q, s.up_B, stands, np.ascontiguousarray(taken))


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
    return maximum_filter1d(flag, 3)
