"""How the logs of a machine show its feet: by joint angles, or by the positions that they give."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from surefoot.sim.common.kernels import kernel
from surefoot.sim.log import Log, foot_velocity, joint_velocity
from surefoot.sim.robot.kinematics import Legs, feet, leg_forward


@dataclass(frozen=True)
class LegFeet:
    """The L feet at the ends of legs, known by joint angles. Round ones roll on the ground.

    `place` and `rate` are N rows of the readings that show the feet, here (N, J) in rad, and their
    derivatives.

    Attributes:
        legs: geometry of the legs.
        radius: of the feet (L,) [m].
        R_BI: rotation of the IMU (3, 3).
        p_BI: its origin in B (3,) [m].
        groups: groups of a log's columns with the readings; a log that shows the feet has the
            first.
        roll_unknown: whether it is unknown by how much a foot rolls as it turns.
    """

    legs: Legs
    radius: np.ndarray
    R_BI: np.ndarray
    p_BI: np.ndarray
    groups: ClassVar[tuple[str, ...]] = ("q", "dq")
    roll_unknown: ClassVar[bool] = False

    def readings(self, log: Log) -> tuple[np.ndarray, np.ndarray]:
        """`place` and `rate` in a log's rows. Raises LogError where it lacks them."""
        return log.q, joint_velocity(log)

    def imu_velocity(
        self,
        place: np.ndarray,
        rate: np.ndarray,
        omega: np.ndarray,
        up: np.ndarray,
        standing: np.ndarray,
    ) -> np.ndarray:
        """Velocity of the IMU in I (N, L, 3) [m/s] by each standing foot; NaN for the others.

        With v_foot = 0 at the contact point of a foot that rolls on its sphere of radius r, v_I =
        -J dq - omega x f + (omega + omega_foot) x r n, all in I.

        Args:
            place: readings.
            rate: their derivatives.
            omega: rate (N, 3) [rad/s] of the IMU, in I.
            up: the ground's unit normal n (N, 3) in I.
            standing: feet (N, L) for which to compute it.
        """
        R_IB = self.R_BI.T
        # Contiguous, so that it is compiled once.
        rows = (np.ascontiguousarray(x) for x in (place, rate, omega @ R_IB, up @ R_IB, standing))
        return _leg_velocity_B(self.legs, self.radius, self.p_BI, *rows) @ self.R_BI

    def heights(
        self, place: np.ndarray, p_GI: np.ndarray, up: np.ndarray, standing: np.ndarray
    ) -> np.ndarray:
        """Height (N, L) [m] of each standing foot's sole in the world; NaN for the others.

        p_GI (N, 3) [m] and the vertical `up` (N, 3) in I are those of the IMU.
        """
        feet_I, _, _ = feet(self.legs, np.ascontiguousarray(place), self.R_BI, self.p_BI)
        return _heights(feet_I, p_GI, up, standing) - self.radius

    def rates_I(self, place: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Angular velocity (N, L, 3) of each foot relative to the base, in I [rad/s]."""
        q = np.ascontiguousarray(place, dtype=float)
        _, _, axes = feet(self.legs, q, self.R_BI, self.p_BI)
        return np.einsum("nlij,nlj->nli", axes, np.asarray(rate, dtype=float)[:, self.legs.joints])


@dataclass(frozen=True)
class PointFeet:
    """Feet whose positions in I a log gives, as of `LegFeet`. How they turn is not known, so that
    they are points.

    `place` and `rate` are (N, L, 3) in m and m/s.
    """

    groups: ClassVar[tuple[str, ...]] = ("foot",)
    roll_unknown: ClassVar[bool] = True

    def readings(self, log: Log) -> tuple[np.ndarray, np.ndarray]:
        """As of `LegFeet`."""
        return log.foot_I, foot_velocity(log)

    def imu_velocity(
        self,
        place: np.ndarray,
        rate: np.ndarray,
        omega: np.ndarray,
        up: np.ndarray,
        standing: np.ndarray,
    ) -> np.ndarray:
        """As of `LegFeet`, for feet that are standing; up is of no use to points.

        A foot that does not move over the ground gives v_I = -rate - omega x place.
        """
        v_I = -rate - np.cross(omega[:, None], place)
        return np.where(standing[..., None], v_I, np.nan)

    def heights(
        self, place: np.ndarray, p_GI: np.ndarray, up: np.ndarray, standing: np.ndarray
    ) -> np.ndarray:
        """As of `LegFeet`."""
        return _heights(place, p_GI, up, standing)

    def rates_I(self, place: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """As of `LegFeet`: points do not turn."""
        return np.zeros_like(rate)


Feet = LegFeet | PointFeet
"""The feet of a machine, and which readings say where they are."""


def shown_feet(log: Log, feet: Feet | None) -> Feet | None:
    """The feet of a machine where a log shows them, else None."""
    return feet if feet is not None and log.has(feet.groups[0]) else None


def _heights(
    feet_I: np.ndarray, p_GI: np.ndarray, up: np.ndarray, standing: np.ndarray
) -> np.ndarray:
    """Height (N, L) [m] in the world of each standing foot at feet_I (N, L, 3); else NaN."""
    z = p_GI[:, 2, None] + np.einsum("nj,nlj->nl", up, feet_I)
    return np.where(standing, z, np.nan)


@kernel
def _leg_velocity_B(legs, radius, p_BI, q, dq, omega, up, standing):
    """Velocity (M, L, 3) [m/s] of the IMU in B by each standing leg; NaN for the others.

    Args:
        legs: geometry of the legs, as of `leg_forward`.
        radius: (L,) [m], of the feet.
        p_BI: (3,) [m], the IMU's origin in B.
        q: (M, J) [rad].
        dq: (M, J) [rad/s].
        omega: (M, 3) [rad/s] in B.
        up: (M, 3), the ground's normal in B.
        standing: (M, L) bool.
    """
    out = np.full((len(q), standing.shape[1], 3), np.nan)
    most = legs.q_zero.shape[1]
    foot, J, axes = np.empty(3), np.empty((3, most)), np.empty((3, most))
    for k in range(len(q)):
        sole, spin = up[k], omega[k]
        for leg in range(standing.shape[1]):
            if not standing[k, leg]:
                continue
            leg_forward(legs, leg, q[k], foot, J, axes)
            r = radius[leg]
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                # omega x (r n - (foot - p_BI)), then omega_foot x r n and J dq, joint by joint
                v = spin[b] * (r * sole[c] - foot[c] + p_BI[c])
                v -= spin[c] * (r * sole[b] - foot[b] + p_BI[b])
                for j in range(legs.joint_count[leg]):
                    roll = r * (axes[b, j] * sole[c] - axes[c, j] * sole[b])
                    v += dq[k, legs.joints[leg, j]] * (roll - J[a, j])
                out[k, leg, a] = v
    return out
