"""A residual channel of a user's own: one class, named in the package's entry points."""

import numpy as np

from surefoot.extend import BIN, Channel, Column, bin_mean

FORCE_NOISE = 4.0  # N, of the sum


class SupportForce(Channel):
    """What the force sensors of all feet read minus what the robot's mass and acceleration take."""

    name = "support_force"
    unit = "N"
    label = "force of all feet"
    needs = ("force", "imu", "reference")

    def columns(self, limbs):
        return (Column("support", self.unit, "support", "support"),) if limbs.legs else ()

    def residual(self, inputs):
        if not (inputs.log.has("force") and inputs.log.has("imu")):
            return None
        mass = inputs.robot.mass + inputs.robot.extras.payload
        taken = mass * np.sum(inputs.log.accel * inputs.motion.up_I, axis=1)
        support = inputs.log.force.sum(axis=1) - taken
        return bin_mean(inputs.motion)(support)[:, None]

    def noise(self, sensors, rate, evenness):
        return FORCE_NOISE / np.sqrt(BIN * rate)
