"""Effects of elasticity: springs between motors and joints, and between feet and their links.

The deflection of a spring is its load times its compliance. The simulation includes rotor, spring
and damping (`sim.physics.drives`); a model that compensates a spring takes the load from the log.
"""

from functools import partial

import mujoco
import numpy as np

from surefoot.sim.effects.base import Effect, Prior, Traced
from surefoot.sim.log import Log
from surefoot.sim.log.derived import local_quadratic
from surefoot.sim.physics.drives import add_foot_springs, add_joint_spring
from surefoot.sim.physics.loads import feet_jacobian_B, foot_loads_B, joint_loads, once_for_loads
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import last_links

LOAD_WINDOW = 0.05
"""Window of the quadratic fits to a load before differentiation [s].

They pass 98 % at 10 Hz and 76 % at 20 Hz, the range in which a foot takes up load. A mean over 0.03
s, with three quarters of their noise, passes 86 % and 50 %, which would make springs appear softer.
"""


_spring = partial(Traced, chain_rule="readings", uses_loads=True)


class LegCompliance(Effect):
    """A spring between the encoder, on the motor's side, and the link: q reads q + tau / k.

    The size is 1 / k, of one joint, of all joints of a kind (legs are built alike), or of all
    joints. Harmonic drives have 5e3 to 5e4 N m/rad by their catalogues, plastic legs and belts a
    tenth of that; belts, brackets and links of plastic together are taken to give up to 25 times as
    much as a gear.
    """

    unit = "rad/(N m)"
    bounds = (0.0, 0.02)
    targets = "joint"
    groups = True
    by_torque = True
    traced = _spring(
        channels=("leg_velocity", "foot_height", "base_wrench", "joint_torque"),
        step=2e-5,
        needs=("q",),
        unseen_by=("joint_rate", "command"),
        prior=Prior(0.005, "25 times that of gears in the Harmonic Drive catalogue: plastic parts"),
        motion="load and unload the joint at one angle, as in stance and swing: a spring yields",
        # No published figure was found: manufacturers of gears state typical stiffnesses only.
        spread=0.25,
    )

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        for joint in self.members(robot.limbs):
            add_joint_spring(spec, robot.joint_names[robot.limbs.joints.index(joint)], self.value)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        deflection = once_for_loads(
            "deflection of joints", log, robot, lambda: _deflection(log, -joint_loads(log, robot))
        )
        return _deflected(log, self.value, deflection, self.members(robot.limbs)), robot


class FootElasticity(Effect):
    """The feet yield under load, along or across the vertical of the home pose.

    Feet of rubber or foam have 1e4 to 1e5 N/m.
    """

    unit = "m/N"
    bounds = (0.0, 1e-4)
    targets = ("normal", "tangential")
    traced = _spring(
        channels=("leg_velocity", "foot_height"),
        step=1e-6,
        needs=("q", "contact", "imu"),
        unseen_by=("joint_torque", "base_wrench", "joint_rate", "command"),
        prior=Prior(1e-4, "no figure of a robot's foot found: rubber and foam of 1e4 N/m"),
        motion="stand and shift the weight from foot to foot: a foot yields under load",
    )

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        for leg in range(len(robot.limbs.legs)):
            add_foot_springs(spec, robot, leg, self._axes(), self.value)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        deflection = once_for_loads(
            f"deflection of feet, {self.target}",
            log,
            robot,
            lambda: _deflection(log, _angles_of_yielding_feet(log, robot, self._axes())),
        )
        return _deflected(log, self.value, deflection, log.joints), robot

    def _axes(self) -> tuple[int, ...]:
        return (2,) if self.target == "normal" else (0, 1)


def _angles_of_yielding_feet(log: Log, robot: Robot, axes: tuple[int, ...]) -> np.ndarray:
    """Change of the joints' angles (N, J) [rad] of a stiff leg that moves the feet like their load
    does with a compliance of 1 m/N along these axes of the base.
    """
    force_B, along = foot_loads_B(log, robot), np.eye(3)[list(axes)]
    rows, legs = np.nonzero(force_B.any(axis=2))
    # The springs rotate with the last link; in the home pose their axes are the base's.
    links_B = log.once("last links", ["q"], lambda: last_links(robot.legs, log.q), robot.legs)
    at_home = last_links(robot.legs, robot.q_home[None])
    axes_B = links_B[rows, legs] @ (np.swapaxes(at_home, 2, 3) @ along.T)[0, legs]
    given_B = axes_B @ (np.swapaxes(axes_B, 1, 2) @ force_B[rows, legs, :, None])
    J_B = feet_jacobian_B(log, robot)
    by_leg, J = np.zeros((*J_B.shape[:2], J_B.shape[3])), J_B[rows, legs]
    # A leg with more than three joints uses the least-norm solution.
    three = robot.limbs.point_feet
    by_leg[rows, legs] = (np.linalg.solve(J, given_B) if three else np.linalg.pinv(J) @ given_B)[
        ..., 0
    ]
    turned = np.zeros_like(log.q)
    for leg, chain in enumerate(robot.limbs.chains):
        turned[:, chain] = by_leg[:, leg, : len(chain)]
    return turned


def _deflection(log: Log, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles (N, J) [rad] of joints with a compliance of one, and their rates (N, J) [rad/s]."""
    # A difference between rows would amplify the load's noise beyond that of the rate.
    smooth = local_quadratic(log.t, angle, LOAD_WINDOW)[0]
    return angle, np.gradient(smooth, log.t, axis=0)


def _deflected(
    log: Log, compliance: float, by: tuple[np.ndarray, np.ndarray], joints: tuple[str, ...]
) -> Log:
    """Deflect some joints of a log by a compliance times a `_deflection`."""
    columns = {}
    for joint in joints:
        at = log.joints.index(joint)
        for name, moved in zip((f"q_{joint}", f"dq_{joint}"), by, strict=True):
            if name in log.columns:
                columns[name] = log.columns[name] + compliance * moved[:, at]
    return log.with_columns(columns)
