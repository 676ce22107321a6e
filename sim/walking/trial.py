"""One second of walking, tried before it is said that a robot walks in simulation."""

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.physics.scene import World
from surefoot.sim.physics.stepper import Fallen
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import LEGS
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import SETTLING_TIME, Plan, plan, simulate_motion

_TRIAL = Scenario("trial", (Segment(1.0, forward=0.4),), Ground(mu=0.8), robot="spot_class")
_OUTSIDE = 0.01
"""Least excess of the standing posture over a joint's limits that is a fault [rad]."""
_UNEVEN = 0.05
"""Largest height difference of the feet in the standing posture, as a share of the leg."""
_BELOW = 0.005
"""Least depth in the ground of a shape that reaches below the feet [m]."""
_CARRIED = 0.8
"""Least share of its weight that a standing robot's feet must feel."""
_WALKED = 0.5
"""Least share of the course that a robot must have walked."""
_ADVICE = "check masses, torque limits, joint ranges and the shapes of the feet in the picture (-o)"


def why_not(robot: Robot) -> str:
    """What keeps a robot from walking in simulation, and what to change, in one line; empty if it
    walks.

    It stands up and walks for a second on flat ground, the same way each time.
    """
    try:
        made = plan(_TRIAL, robot, seed=0)
        return (
            _posture(robot)
            or _touching(made.world, made.world.start, _BELOW)
            or _walked(made, robot)
        )
    except SurefootError as error:
        return str(error).removeprefix(f"robot {robot.name}: ")


def _posture(robot: Robot) -> str:
    """What is wrong with the standing posture."""
    low, high = robot.joint_range.T
    outside = np.maximum(low - robot.q_home, robot.q_home - high)
    worst = int(np.argmax(outside))
    if outside[worst] > _OUTSIDE:
        return (
            f"the keyframe home puts joint {robot.joint_names[worst]} at {robot.q_home[worst]:.2f} "
            f"rad, outside of its range of {low[worst]:.2f} to {high[worst]:.2f}; correct either"
        )
    bottom = robot.home_feet_B[:, 2] - robot.foot_radius
    first, last = int(np.argmax(bottom)), int(np.argmin(bottom))
    if (apart := bottom[first] - bottom[last]) > _UNEVEN * robot.leg_length:
        return (
            f"the feet of the standing posture are not level: foot {LEGS[first]} is "
            f"{1e3 * apart:.0f} mm above {LEGS[last]}; check the joint ranges of both, which count "
            "along each joint's own axis, or add a keyframe home in which it stands"
        )
    return ""


def _touching(world: World, qpos: np.ndarray, depth: float) -> str:
    """Which shape touches the ground beside the feet, at least so deep [m].

    Args:
        world: of the robot.
        qpos: (nq,) of a robot that stands.
        depth: m.
    """
    model, data = world.model, mujoco.MjData(world.model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    soles = [model.site(f"sole_{leg}").id for leg in LEGS]
    for contact in data.contact[: data.ncon]:
        bodies = model.geom_bodyid[contact.geom]
        away = np.linalg.norm(data.site_xpos[soles] - contact.pos, axis=1)
        felt = bool((away < model.site_size[soles, 0]).any())
        if min(bodies) == 0 and contact.dist < -depth and not felt:
            return (
                f"a shape of body {model.body(max(bodies)).name} reaches as low as foot "
                f"{LEGS[int(np.argmin(away))]} or lower when the robot stands; shorten it, let it "
                "not collide (contype and conaffinity 0), or add a sphere for the foot at the end "
                "of the leg"
            )
    return ""


def _walked(made: Plan, robot: Robot) -> str:
    """Why it did not stand, or did not walk, in a simulation of both."""
    try:
        motion = simulate_motion(made.world, robot, made.gait, made.course)
    except Fallen as fall:
        when = fall.time - SETTLING_TIME - made.scenario.stand
        doing = f"after {when:.1f} s of walking" if when > 0.0 else "while it stands"
        return f"it falls {doing}, {fall.how}; {_weakness(robot) or _ADVICE}"
    stood = int(np.searchsorted(motion.t, SETTLING_TIME))
    carried = motion.force[stood // 2 : stood].sum(axis=1).mean() / (robot.mass * GRAVITY)
    if carried < _CARRIED:
        qpos = made.world.start.copy()
        qpos[:3], qpos[3:7] = motion.p_GB[stood], quaternion_from_matrix(motion.R_GB[stood])
        qpos[made.world.qpos_adr] = motion.q[stood]
        return _touching(made.world, qpos, 0.0) or (
            f"its feet carry {100 * carried:.0f} % of its weight when it stands; put the colliding "
            "shape of each foot on the foot's own body"
        )
    way, asked = motion.p_GB[-1, 0] - motion.p_GB[stood, 0], made.course.pose[-1, 0]
    if way < _WALKED * asked:
        return f"it walks {way:.2f} m instead of {asked:.2f} m; {_ADVICE}"
    return ""


def _weakness(robot: Robot) -> str:
    """Which motor is too weak to carry half of the weight on its leg, as a trot does."""
    up_I, J = robot.R_BI[2], robot.feet_jacobian_I(robot.q_home[None])[0]
    torque = 0.5 * robot.mass * GRAVITY * np.abs(np.einsum("lij,i->lj", J, up_I)).ravel()
    worst = int(np.argmax(torque / robot.torque_limit))
    name, limit = robot.joint_names[worst], robot.torque_limit[worst]
    if torque[worst] <= limit:
        return ""
    return (
        f"the motor of joint {name} gives {limit:.3g} N m, and a trot takes {torque[worst]:.3g} "
        "N m there: check its limit, gear and the masses"
    )
