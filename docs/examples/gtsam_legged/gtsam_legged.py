"""gtsam's legged estimators by the contract of `surefoot.extend`.

    pip install "surefoot[gtsam]"
    surefoot compare LOG --plugin gtsam_legged.py -o compared

or `pip install .` in this folder, after which every command has them.

gtsam keeps pose, velocity and a foothold a leg as one element of SE_{2+K}(3), moves it by the IMU
and holds each standing foot to where it touched down. Its biases are constants: here what the
beginning says of them, with the covariance that the beginning states.
"""

import gtsam
import numpy as np

from surefoot.extend import GRAVITY, NavState, Needs, Parameter, check_sample, measured

UNKNOWN = 1.0
"""m, deviation of a foothold that no measurement has reached."""
# gtsam's errors are (rotation, position, velocity), ours (rotation, velocity, position).
OURS = np.r_[0:3, 6:9, 3:6]


class GtsamLeg:
    """The filter: contacts are updates of an invariant Kalman filter, one after the other."""

    name = "gtsam_leg"
    description = "gtsam's LeggedInvariantEKF: a foothold a leg as states, biases held."
    needs = Needs(log=("imu", "contact"), robot=False, feet=True)
    parameters = (
        Parameter("accel", 0.01, "m/s^2/sqrt(Hz)", "noise density of the accelerometer"),
        Parameter("gyro", 3e-4, "rad/s/sqrt(Hz)", "noise density of the gyro"),
        Parameter("contact", 0.02, "m/s/sqrt(Hz)", "velocity noise density of a standing foot"),
        Parameter("kinematics", 3e-3, "m", "of a foot's place in I"),
    )
    of_legs = True
    kind = gtsam.LeggedInvariantEKF

    def start(self, robot, learnt, parameters, beginning):
        """A stream that begins at the state and covariance of `beginning`."""
        return Walking(self.kind, robot, parameters, beginning)


class GtsamLegIterated(GtsamLeg):
    """The same with the contacts of a sample solved together, as a small factor graph."""

    name = "gtsam_leg_iterated"
    description = "gtsam's LeggedInvariantIEKF: the contacts of a sample as one factor graph."
    variant = True
    kind = gtsam.LeggedInvariantIEKF


class Walking:
    """gtsam's estimator `kind` from `beginning` on."""

    def __init__(self, kind, robot, parameters, beginning):
        # The log's own foot positions where it has them, else those of the robot's joints.
        self.robot = None if beginning.feet else robot
        feet = len(beginning.feet) if self.robot is None else len(robot.limbs.legs)
        start = beginning.state
        body = gtsam.NavState(gtsam.Rot3(start.R_GI), start.p_GI, start.v_GI)
        covariance = UNKNOWN**2 * np.eye(9 + 3 * feet)
        to_gtsam = np.linalg.inv(right_from_left(body.AdjointMap()))
        covariance[:9, :9] = to_gtsam @ beginning.covariance[:9, :9] @ to_gtsam.T
        footholds = np.zeros((3, feet))
        self.estimator = kind(body, footholds, covariance, settings(parameters, start), [])
        self.biases, self.t = beginning.covariance[9:, 9:], np.nan
        self.b_a, self.b_g = start.b_a, start.b_g

    def step(self, sample):
        """Predict, and update with the standing feet."""
        check_sample(sample, self.t)
        if self.robot is None:
            feet_I, contact = measured(sample, "foot_I", "contact")
        else:
            q, contact = measured(sample, "q", "contact")
            feet_I = self.robot.feet_I(q[None])[0]
        if not np.isnan(self.t):
            self.estimator.predict(sample.gyro, sample.accel, sample.t - self.t)
        self.t = sample.t
        # gtsam sees by itself which of the feet that stand did not before.
        self.estimator.processContacts([standing(k, feet_I[k]) for k in np.flatnonzero(contact)])

    @property
    def state(self):
        """The estimate, with the biases of the beginning."""
        now = self.estimator.estimate()
        return NavState(now.rotation().matrix(), now.x(1), now.x(0), self.b_a, self.b_g)

    @property
    def covariance(self):
        """Covariance (15, 15) of the right-invariant error."""
        T = right_from_left(self.estimator.estimate().AdjointMap()[:9, :9])
        whole = np.zeros((15, 15))
        whole[:9, :9] = T @ self.estimator.covariance()[:9, :9] @ T.T
        whole[9:, 9:] = self.biases
        return 0.5 * (whole + whole.T)


def settings(parameters, start):
    """What gtsam's estimators are told: IMU in its own frame, noise, biases."""
    imu = gtsam.PreintegrationParams.MakeSharedU(GRAVITY)
    imu.setGyroscopeCovariance(parameters["gyro"] ** 2 * np.eye(3))
    imu.setAccelerometerCovariance(parameters["accel"] ** 2 * np.eye(3))
    imu.setIntegrationCovariance(1e-12 * np.eye(3))
    told = gtsam.LeggedEstimatorParams()
    told.preintegrationParams = imu
    told.body_P_imu = gtsam.Pose3()  # feet are given in I
    told.imuBias = gtsam.imuBias.ConstantBias(start.b_a, start.b_g)
    told.contactCovariance = parameters["kinematics"] ** 2 * np.eye(3)
    told.footholdProcessSigma = parameters["contact"]
    told.footholdInitSigma = UNKNOWN
    told.useFullContactInitialization = False  # the beginning is given
    return told


def standing(foot, foot_I):
    """gtsam's measurement of a foot that stands at foot_I (3,) [m]."""
    contact = gtsam.ContactMeasurement()
    contact.foot, contact.bodyPoint = int(foot), foot_I
    return contact


def right_from_left(adjoint):
    """T (9, 9), right-invariant errors = T times gtsam's.

    gtsam's are left-invariant, X_true = X exp(e), ours X_true = exp(-xi) X: xi = -Ad_X e, in our
    order of velocity and position.
    """
    return -adjoint[OURS]


PLUGINS = {
    "surefoot.estimators": {"gtsam_leg": GtsamLeg, "gtsam_leg_iterated": GtsamLegIterated},
}
