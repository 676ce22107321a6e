"""A log cut into strides and stances, from which the realism quantities are computed."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from surefoot.models.residuals.binning import at_rows
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log, joint_velocity, reference_velocity
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.stances import stance_phase, stances_between_swings
from surefoot.sim.walking.imitation import moving, strides

FEWEST_STRIDES = 8
"""Strides of one foot that the bootstrap needs."""


@dataclass(frozen=True)
class WalkView:
    """A log and its declared robot, with strides, stances and velocities computed on first use.

    N rows, L legs, J joints; S strides of the foot that makes the most. Raises SurefootError where
    the log lacks IMU, joint angles, contacts or a reference, or has too few strides.
    """

    log: Log
    robot: Robot

    def __post_init__(self):
        self.log.require("imu", "q", "contact", "reference")
        if len(self.clock) < FEWEST_STRIDES:
            raise SurefootError(
                f"{self.log.name}: no foot makes more than {len(self.clock)} strides; "
                f"a walk has {FEWEST_STRIDES} at least"
            )

    @cached_property
    def strides(self) -> tuple[np.ndarray, ...]:
        """For each foot, (K, 3) [s]: when it lands, lifts off and lands again in each stride."""
        return tuple(strides(self.log.t, stands) for stands in self.log.contact.T)

    @cached_property
    def clock(self) -> np.ndarray:
        """Start times (S,) [s] of the strides of the foot that makes the most."""
        return max(self.strides, key=len)[:, 0]

    @cached_property
    def stances(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """For each foot, first rows (K,) of its stances, and the rows (K,) after their last.

        Only stances that lie within the strides and during which the base moves throughout.
        """
        still = np.concatenate([[0], np.cumsum(~self.walks)])
        found = []
        for stands in self.log.contact.T:
            first, end = stances_between_swings(self.log.t, stands)
            whole = (self.log.t[first] >= self.clock[0]) & (end < len(stands))
            whole &= still[end] == still[first]
            found.append((first[whole], end[whole]))
        return tuple(found)

    @cached_property
    def walks(self) -> np.ndarray:
        """(N,) bool: whether the base moves, between the first and the last stride."""
        return moving(self.log) & (self.log.t >= self.clock[0]) & (self.log.t <= self.clock[-1])

    @cached_property
    def heading(self) -> np.ndarray:
        """Rotations (N, 3, 3) from G to the heading frame: z up, x forward as the base."""
        forward = (self.log.ref_R_GI @ self.robot.R_BI.T)[:, :2, 0]
        c, s = (forward / np.linalg.norm(forward, axis=1, keepdims=True)).T
        R = np.zeros((len(c), 3, 3))
        R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1], R[:, 2, 2] = c, s, -s, c, 1.0
        return R

    @cached_property
    def velocity(self) -> np.ndarray:
        """Reference velocity (N, 3) [m/s] of the IMU in the heading frame: forward, left, up."""
        return np.einsum("nij,nj->ni", self.heading, reference_velocity(self.log))

    @cached_property
    def standing_velocity(self) -> np.ndarray:
        """Apparent velocity (N, L, 3) [m/s] of standing feet over the ground, in the heading frame.

        It is the reference velocity minus the one by leg odometry: zero where the foot does not
        slide and the legs are as declared. NaN in swing and where there is no reference.
        """
        log = self.log
        stands = log.contact & (self.walks & log.ref_ok)[:, None]
        R_GI = log.ref_R_GI
        v_I = self.robot.feet.imu_velocity(log.q, self.dq, at_rows(log.gyro), R_GI[:, 2], stands)
        by_leg = np.einsum("nij,njk,nlk->nli", self.heading, R_GI, v_I)
        return self.velocity[:, None] - by_leg

    @cached_property
    def dq(self) -> np.ndarray:
        """Joint rates (N, J) [rad/s], derived from the angles where none were logged."""
        return joint_velocity(self.log)

    @cached_property
    def phase(self) -> np.ndarray:
        """Phase (N, L) of each foot's stance, 0 at touch-down and 1 at lift-off; NaN in swing."""
        return np.column_stack([stance_phase(stands) for stands in self.log.contact.T])

    @cached_property
    def outward(self) -> np.ndarray:
        """(L,): 1 for legs on the left of the base, -1 for those on the right."""
        return np.sign(self.robot.home_feet_B[:, 1])

    def stride_of(self, t: np.ndarray) -> np.ndarray:
        """Number (K,) of the stride that contains each time t (K,) [s]."""
        return np.clip(np.searchsorted(self.clock, t, side="right") - 1, 0, len(self.clock) - 1)
