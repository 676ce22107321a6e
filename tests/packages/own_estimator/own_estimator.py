"""An estimator of a user's own: the velocity that standing feet give, as Gaussian updates."""

import numpy as np

from surefoot.extend import FilterNoise, InvariantFilter, Needs, Parameter, Update


class StandingFeet:
    name = "standing_feet"
    description = "Mean velocity of the standing feet, each as if it were fixed to the ground."
    needs = Needs(log=("imu", "q", "dq", "contact"))
    parameters = (
        Parameter("accel", 0.02, "m/s^2/sqrt(Hz)", "noise density of the accelerometer"),
        Parameter("spread", 0.1, "m/s", "deviation of the feet's velocity"),
    )

    def start(self, robot, learnt, parameters, beginning):
        return Walking(robot, parameters, beginning)


class Walking:
    def __init__(self, robot, parameters, beginning):
        noise = FilterNoise(accel=parameters["accel"])
        self.filter = InvariantFilter(beginning.state, beginning.covariance, noise)
        self.robot, self.cov = robot, parameters["spread"] ** 2 * np.eye(3)
        self.t = None

    @property
    def state(self):
        return self.filter.state

    @property
    def covariance(self):
        return self.filter.covariance

    def step(self, sample):
        if self.t is not None:
            self.filter.predict(sample.gyro, sample.accel, sample.t - self.t)
        self.t = sample.t
        if not sample.contact.any():
            return None
        feet = self.robot.feet_I(sample.q[None])[0]
        jacobian = self.robot.feet_jacobian_I(sample.q[None])[0]
        rates = sample.dq.reshape(len(feet), -1)
        moving = np.einsum("kij,kj->ki", jacobian, rates) + np.cross(sample.gyro, feet)
        v_I = -moving[sample.contact].mean(axis=0)
        self.filter.update_velocity(v_I, self.cov)
        return Update(v_I)
