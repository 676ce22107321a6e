"""A log cut into strides, for measuring how its robot walks."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from surefoot.models.residuals.leg_velocity import leg_velocity
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log, joint_velocity, reference_velocity
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.stances import stance_phase, stances_between_swings
from surefoot.sim.walking.imitation import moving, strides

FEWEST_STANCES = 8
"""Strides of a foot below which a log is no walk: a stride bootstrap has nothing to draw from."""


@dataclass(frozen=True)
class WalkView:
    """A walk: its log, its robot as declared, and what is derived of them once.

    Raises SurefootError, one line, where the log lacks IMU, angles, contacts or a reference, or has
    too few strides.
    """

    log: Log
    robot: Robot

    def __post_init__(self):
        self.log.require("imu", "q", "contact", "reference")
        if len(self.clock) < FEWEST_STANCES:
            raise SurefootError(
                f"{self.log.name}: no foot makes more than {len(self.clock)} strides; "
                f"a walk has {FEWEST_STANCES} at least"
            )

    @cached_property
    def strides(self) -> tuple[np.ndarray, ...]:
        """Of each foot, the times (K, 3) [s] at which it lands, lifts and lands again."""
        return tuple(strides(self.log.t, stands) for stands in self.log.contact.T)

    @cached_property
    def clock(self) -> np.ndarray:
        """Beginnings (S,) [s] of the strides of the foot that makes the most."""
        return max(self.strides, key=len)[:, 0]

    @cached_property
    def stances(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Of each foot, the first row, and one past the last, of its stances (K,) while it walks:
        those that begin and end within the strides, and in which the base moves all along."""
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
        """Rows (N,) at which the base moves and the feet step."""
        return moving(self.log) & (self.log.t >= self.clock[0]) & (self.log.t <= self.clock[-1])

    @cached_property
    def heading(self) -> np.ndarray:
        """Rotation (N, 3, 3) from G to axes that are level and look where the base does."""
        forward = (self.log.ref_R_GI @ self.robot.R_BI.T)[:, :2, 0]
        c, s = (forward / np.linalg.norm(forward, axis=1, keepdims=True)).T
        R = np.zeros((len(c), 3, 3))
        R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1], R[:, 2, 2] = c, s, -s, c, 1.0
        return R

    @cached_property
    def velocity(self) -> np.ndarray:
        """Velocity (N, 3) [m/s] of the IMU by the reference: forward, to the left, up."""
        return np.einsum("nij,nj->ni", self.heading, reference_velocity(self.log))

    @cached_property
    def standing_velocity(self) -> np.ndarray:
        """Velocity over the ground (N, L, 3) [m/s] of what each sensed foot stands on, by the
        declared legs and the reference: forward, to the left, up. NaN in the air and where there is
        no reference. Zero for a foot that stands still and legs that are as declared."""
        log = self.log
        stands = log.contact & (self.walks & log.ref_ok)[:, None]
        R_GI = log.ref_R_GI
        by_leg = leg_velocity(self.robot, log.q, self.dq, log.gyro, R_GI[:, 2], stands)
        turned = np.einsum("nij,njk,nlk->nli", self.heading, R_GI, by_leg)
        return self.velocity[:, None] - turned

    @cached_property
    def dq(self) -> np.ndarray:
        """Rates (N, J) [rad/s], derived from the angles where none were logged."""
        return joint_velocity(self.log)

    @cached_property
    def phase(self) -> np.ndarray:
        """Share (N, L) of its stance that each foot has behind it; NaN in the air."""
        return np.column_stack([stance_phase(stands) for stands in self.log.contact.T])

    @cached_property
    def outward(self) -> np.ndarray:
        """(L,): 1 for legs on the left, -1 for those on the right."""
        home_B = self.robot.feet_I(self.robot.q_home[None])[0] @ self.robot.R_BI.T + self.robot.p_BI
        return np.sign(home_B[:, 1])

    def stride_of(self, t: np.ndarray) -> np.ndarray:
        """Number (K,) of the stride that each time t (K,) [s] falls into."""
        return np.clip(np.searchsorted(self.clock, t, side="right") - 1, 0, len(self.clock) - 1)
