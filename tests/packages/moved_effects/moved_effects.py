"""Three bundled effects as a package of a user's own would have them: an error of a reading, a
property of the body, and a delay. All that `trace` knows of them is in the class."""

from dataclasses import replace

from surefoot.extend import Delay, DriveEffect, Offset, Prior, Traced


class TorqueBias(Offset):
    """A joint's measured torque has a constant offset."""

    name = "torque_bias"
    unit = "N m"
    bounds = (-2e3, 2e3)
    readings = ("tau",)
    traced = Traced(
        channels=("joint_torque", "base_wrench", "command"),
        step=0.1,
        belongs_to="run",
        chain_rule="readings",
        bounds_on_legs=(-200.0, 200.0),
        prior=Prior(20.0, "amplifiers on the bench of the package's author"),
        motion="let the joint hang: a bias of the torque stays",
    )


class ViscousFriction(DriveEffect):
    """A joint's drive has more viscous friction than the model."""

    name = "viscous_friction"
    unit = "N m s/rad"
    bounds = (0.0, 1e4)
    traced = replace(
        DriveEffect.traced,
        bounds_on_legs=(0.0, 100.0),
        prior=Prior(10.0, "oils of the package's author"),
        motion="move the joint at several rates: a viscous torque grows with them",
        spread=0.5,
    )

    def resist(self, spec, joint):
        joint.damping[0] = self.left_of(joint.damping[0], joint.name)

    def lost_torque(self, t, rate, torque):
        return rate


class RateDelay(Delay):
    """Joint rates arrive late relative to the angles by a constant time."""

    name = "rate_delay"
    delayed = ("dq",)
    traced = replace(
        Delay.traced,
        channels=("joint_rate", "leg_velocity", "joint_torque", "base_wrench"),
        needs=("dq",),
        step=4e-3,
        prior=Prior(0.04, "drives of the package's author"),
        motion="swing the joint faster: a delay's error grows with the acceleration",
    )
