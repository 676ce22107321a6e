"""Motion of a foot in soft ground: its depth and velocity during stance.

MuJoCo models a contact as a critically damped spring with time constant T. For a foot at depth z
with impedance i of at most d,

    z'' = -b z' - k z + R F - c_z,    b = 2 / (d T),    k = i / (d T)^2,    R = (1 - i) / (i m)

and along the ground v' = -b v + c. F is the load, 1 / m the acceleration of the foot per unit of
force, and c the acceleration from the robot's rates alone, which a contact does not feel (MuJoCo
documentation, "Computation", on constraints). A foot thus sinks by its speed at touchdown and
settles where its load is supported: at 5 mm for spot with T = 0.024 s, and four times as deep at
twice that.

Only feet are assumed to touch. If they sink so deep that a shank touches as well (spot's from T =
0.05 s), it takes a part of the load, and `trace` finds too small a size or another effect.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from surefoot.models.residuals.binning import (
    Bins,
    ReferenceMotion,
    at_torques,
    bin_mean,
)
from surefoot.models.residuals.torques import feet_wrenches
from surefoot.sim.common.copies import copy_row
from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.common.kernels import kernel
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.ground.tiles import SOLIMP, SOLREF
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.physics.loads import once_for_loads
from surefoot.sim.physics.scene import TIMESTEP
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.stances import stances_between_swings

TOUCHDOWN_WINDOW = 0.004
"""Time before and after touchdown over which a foot's velocity is averaged [s]."""
SETTLED_SHARE = 0.5
"""Share of a stance after which a foot has settled."""
RATE_STEP = 1e-4
"""Time step for the acceleration from constant rates [s]."""
STANCE_ITERATIONS = 3
"""Iterations of a stance, after which its end and its start agree on the ground's height."""


class Stances(NamedTuple):
    """The K stances of a foot.

    Attributes:
        first: first row of each (K,).
        last: row after the last of each (K,).
        landed: whether the touchdown is in the log (K,).
        v_G: velocity at touchdown (K, 3) [m/s].
    """

    first: np.ndarray
    last: np.ndarray
    landed: np.ndarray
    v_G: np.ndarray


def foot_sinking(
    log: Log, robot: Robot, motion: ReferenceMotion, bins: Bins
) -> tuple[np.ndarray, np.ndarray]:
    """Depth (M, L) [m] and velocity (M, L, 3) [m/s], in I, of each standing foot's sole, as bin
    means.

    Relative to a foot on hard ground.

    Args:
        log: the measured log.
        robot: as declared, with the ground's softness.
        motion: reference motion of the log.
        bins: means over bins.
    """
    load = foot_loads(log, robot, motion, bins)
    swept_G = np.einsum("nij,nlj->nli", bins.R_GI, acceleration_at_constant_rates(robot, bins))
    rows = [interpolate_rows(log.t, bins.t, swept_G), load[..., None]]
    rows = np.nan_to_num(np.concatenate(rows, axis=2))

    def height_and_stances() -> tuple[np.ndarray, list[Stances]]:
        above = np.einsum("nj,nlj->nl", motion.R_GI[:, 2], robot.feet_I(log.q))
        dq, legs = joint_velocity(log), range(load.shape[1])
        stances = [foot_stances(log, robot, motion, leg, dq) for leg in legs]
        return motion.p_GI[:, 2, None] + above, stances

    # The same for every softness.
    height, stances = log.once(
        "height of feet, and stances",
        ["q", "dq", "contact"],
        height_and_stances,
        *(motion, robot.legs, robot.foot_radius, robot.R_BI, robot.p_BI),
    )
    model = robot.dynamics.model  # with the declared masses
    give = [model.body_invweight0[model.body(name).id, 0] for name in robot.foot_bodies]  # 1/kg
    depth, v_G = np.zeros(height.shape), np.zeros((*height.shape, 3))
    for leg, s in enumerate(stances):
        for T, sign in ((SOLREF[0] + robot.extras.softness, 1.0), (SOLREF[0], -1.0)):
            moved = (depth[:, leg], v_G[:, leg])
            _add_stances(log.t, height[:, leg], rows[:, leg], s, give[leg], T, sign, *moved)
    mean = bin_mean(motion)
    return mean(depth), np.einsum("nji,nlj->nli", bins.R_GI, mean(v_G))


def foot_loads(log: Log, robot: Robot, motion: ReferenceMotion, bins: Bins) -> np.ndarray:
    """Force (N, legs) [N] along the ground's normal on each standing foot, zero on the others.

    J^T f = inverse dynamics - measured torque, the former as means over bins. Without torques, or
    for legs with other than three joints, the standing feet share the weight evenly.

    Args:
        log: the measured log.
        robot: as declared.
        motion: reference motion of the log.
        bins: means over bins.
    """

    def made() -> np.ndarray:
        stands = log.contact
        if not np.isfinite(bins.tau).any() or not robot.limbs.point_feet:
            weight = -GRAVITY_G[2] * (robot.mass + robot.extras.payload)
            return weight * stands / np.maximum(stands.sum(axis=1, keepdims=True), 1)
        _, taken = robot.dynamics.inverse(bins.q_step, bins.dq_step, bins.ddq, bins.base)

        def normal(q: np.ndarray, up_B: np.ndarray, on: np.ndarray, taken: np.ndarray):
            wrench = feet_wrenches(robot.legs, np.zeros(on.shape), q, up_B, on, taken)
            # Torques of a leg that is straight do not depend on its load.
            return np.nan_to_num(np.einsum("nla,na->nl", wrench[..., :3], up_B))

        up_B, every = bins.normal_I @ robot.R_BI.T, np.ones_like(bins.standing)
        from_motion = normal(bins.q_step, up_B, every, taken)
        motor = normal(at_torques(log.q, motion), motion.normal_I @ robot.R_BI.T, stands, log.tau)
        load = interpolate_rows(log.t, bins.t, from_motion) - motor
        return np.where(stands, np.maximum(load, 0.0), 0.0)

    given = motion, robot.extras.payload
    return once_for_loads("foot loads along the normal", log, robot, made, *given)


def acceleration_at_constant_rates(robot: Robot, bins: Bins) -> np.ndarray:
    """Acceleration (M, L, 3) [m/s^2], in I, of each sole at constant rates of the joints and the
    base, and constant velocity of the base's origin in the world.
    """
    up, every = bins.R_GI[:, 2], np.ones(bins.standing.shape, dtype=bool)
    at_origin = replace(robot.feet, p_BI=np.zeros(3))

    def soles(time: float) -> np.ndarray:
        turned = up - time * np.cross(bins.omega, up)
        q = bins.q + time * bins.dq
        return -at_origin.imu_velocity(q, bins.dq, bins.omega, turned, every)

    now = soles(0.0)
    return np.cross(bins.omega[:, None], now) + (soles(RATE_STEP) - now) / RATE_STEP


def foot_stances(
    log: Log, robot: Robot, motion: ReferenceMotion, leg: int, dq: np.ndarray
) -> Stances:
    """Stances of a foot, from its contacts.

    Args:
        log: the measured log.
        robot: as declared.
        motion: reference motion of the log.
        leg: index of the foot.
        dq: joint rates (N, J) [rad/s].
    """
    first, last = stances_between_swings(log.t, log.contact[:, leg])
    around = max(1, round(TOUCHDOWN_WINDOW * log.rate))
    rows = np.clip(first[:, None] + np.arange(-around, around + 1), 0, len(log.t) - 1)
    at, only = rows.ravel(), np.zeros((rows.size, log.contact.shape[1]), dtype=bool)
    only[:, leg] = True
    turning = motion.gyro[at], motion.R_GI[at, 2]
    v_I = robot.feet.imu_velocity(log.q[at], dq[at], *turning, only)[:, leg]
    v_G = np.einsum("nij,nj->ni", motion.R_GI[at], motion.v_I[at] - v_I).reshape(*rows.shape, 3)
    return Stances(first, last, first > 0, np.nan_to_num(v_G.mean(axis=1)))


@kernel
def _add_stances(t, height, rows, stances, give, T, sign, depth, v_G):
    """Add the motion of a foot in all its stances, with a sign.

    Args:
        t: (N,) [s].
        height: (N,) [m], of the foot in G.
        rows: (N, 4), acceleration from the rates alone in G [m/s^2] and load [N].
        stances: Stances of the foot.
        give: acceleration per unit of load [1/kg].
        T: time constant of the contact [s].
        sign: +1.0 or -1.0.
        depth: (N,) [m], added to.
        v_G: (N, 3) [m/s], added to.
    """
    z, v = np.zeros(len(t)), np.zeros((len(t), 3))
    for s in range(len(stances.first)):
        a, b = stances.first[s], stances.last[s]
        if not stances.landed[s]:
            _integrate_stance(
                t, rows, a, b, _at_rest(rows[a, 3], give, T), np.zeros(3), give, T, z, v
            )
        start = 0.0
        for _ in range(STANCE_ITERATIONS * stances.landed[s]):
            _integrate_stance(t, rows, a, b, start, stances.v_G[s], give, T, z, v)
            # The ground is above the settled foot by its depth.
            half = a + int(SETTLED_SHARE * (b - a))
            start = np.mean(height[half:b] + z[half:b]) - height[a]
            if not start > 0.0:  # nor where there is no reference
                start = 0.0
        for k in range(a, b):
            depth[k] += sign * z[k]
            for axis in range(3):
                v_G[k, axis] += sign * v[k, axis]


@kernel
def _integrate_stance(t, rows, a, b, z, v_start, give, T, depth, v_G):
    """Integrate one stance with the simulation's time step, whose depths are half a step ahead of
    its velocities; those of a log, and so these, are not.

    Args:
        t: (N,) [s].
        rows: (N, 4), acceleration from the rates alone in G [m/s^2] and load [N].
        a: first row of the stance.
        b: its end.
        z: depth at row a [m].
        v_start: (3,) [m/s] in G, velocity at row a.
        give: acceleration per unit of load [1/kg].
        T: time constant of the contact [s].
        depth: (N,) [m], filled from a to b.
        v_G: (N, 3) [m/s], filled likewise.
    """
    v = v_start.copy()
    damping, spring = 2.0 / (SOLIMP[1] * T), 1.0 / (SOLIMP[1] * T) ** 2
    depth[a] = z
    copy_row(v, v_G[a])
    for k in range(a + 1, b):
        steps = max(1, int(np.ceil((t[k] - t[k - 1]) / TIMESTEP - 0.01)))
        h = (t[k] - t[k - 1]) / steps
        z -= 0.5 * h * v[2]
        for j in range(steps):
            share = (j + 1.0) / steps
            for axis in range(3):
                c = rows[k - 1, axis] + share * (rows[k, axis] - rows[k - 1, axis])
                v[axis] += h * (c - damping * v[axis])
            i = _impedance(z)
            load = rows[k - 1, 3] + share * (rows[k, 3] - rows[k - 1, 3])
            v[2] += h * (i * spring * z - (1.0 - i) / i * give * load)
            z -= h * v[2]
        z += 0.5 * h * v[2]
        depth[k] = z
        copy_row(v, v_G[k])


@kernel
def _at_rest(load, give, T):
    """Equilibrium depth of a foot that carries `load`."""
    z = 0.0
    for _ in range(20):
        i = _impedance(z)
        z = (1.0 - i) / i * give * load * (SOLIMP[1] * T) ** 2 / i
    return z


@kernel
def _impedance(z):
    x = min(abs(z) / SOLIMP[2], 1.0)
    y = 2.0 * x * x if x < 0.5 else 1.0 - 2.0 * (1.0 - x) ** 2
    return SOLIMP[0] + (SOLIMP[1] - SOLIMP[0]) * y
