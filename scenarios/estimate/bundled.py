"""The bundled estimators, one class each, and the streams they run as."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from surefoot.estimator.core.checks import check_velocity, spd
from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.filter import CoverageSettings, InvariantFilter
from surefoot.estimator.leg import LegFilter, LegNoise, encoder_covariance
from surefoot.estimator.run import (
    NO_VELOCITIES,
    Velocities,
    bounded_velocities,
    gaussian_velocities,
    imu_samples,
)
from surefoot.estimator.updates.bias_states import PersistentError
from surefoot.models.calibration.bias_model import BiasModel
from surefoot.models.calibration.bounds import Bounds
from surefoot.models.observer.observer import SIGNALS, Observer
from surefoot.models.observer.predict import ObserverStream, Prediction, predict
from surefoot.scenarios.estimate.contract import (
    Beginning,
    Learnt,
    Needs,
    Parameter,
    Parameters,
    Sample,
    Update,
    check_sample,
    measured,
)
from surefoot.scenarios.estimate.radar_velocity import radar_of, with_radar
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log
from surefoot.sim.log.derived import CausalDerivative
from surefoot.sim.robot.robot import NO_ROBOT, Robot


def _imu_parameters(accel: float) -> tuple[Parameter, ...]:
    # Larger with velocity updates, whose errors are correlated for long: with the data sheet's
    # noise, the IMU would propagate each of these errors.
    return (
        Parameter("accel", accel, "m/s^2/sqrt(Hz)", "noise density of the accelerometer"),
        Parameter("gyro", 3e-4, "rad/s/sqrt(Hz)", "noise density of the gyro"),
        Parameter("accel_walk", 1e-4, "m/s^3/sqrt(Hz)", "accelerometer bias random walk", True),
        Parameter("gyro_walk", 1e-5, "rad/s^2/sqrt(Hz)", "gyro bias random walk", True),
    )


VELOCITY = _imu_parameters(0.03)
PERSISTENT = (
    *VELOCITY,
    Parameter(
        "persistent", 1.0, "1", "factor of the prior standard deviations of the persistent error"
    ),
)
LEG = (
    *_imu_parameters(0.01),
    Parameter("contact", 0.02, "m/s/sqrt(Hz)", "velocity noise density of a foot in stance"),
    Parameter(
        "encoder", 2e-3, "rad", "std of a joint angle: resolution, zero, compliance of drives", True
    ),
    Parameter(
        "kinematics", 2e-3, "m", "std of a foot's position: links, mounts, shape of the foot", True
    ),
)
LEG_SLIP = (
    *LEG,
    Parameter("slip_gate", 16.27, "1", "largest squared Mahalanobis distance (3 dof)"),
)


class ByObserver:
    """An estimator with the velocities of an observer, used as `fusion` says."""

    parameters = VELOCITY

    def fusion(
        self, robot: Robot, learnt: Learnt, parameters: Parameters
    ) -> tuple[Observer, Fusion]:
        """The observer, and how its velocities are used."""
        raise NotImplementedError

    def start(
        self, robot: Robot, learnt: Learnt, parameters: Parameters, beginning: Beginning
    ) -> ObserverFusion:
        """A stream; see `surefoot.scenarios.estimate.contract.Estimator`."""
        observer, fusion = self.fusion(robot, learnt, parameters)
        return ObserverFusion(observer, robot, beginning, fusion, imu_noise(parameters))


class Coverage(ByObserver):
    """Set-coverage updates with the bounds of the mse observer."""

    name, color, line = "coverage", "#D55E00", "-"
    description = "Set-coverage IEKF, bounds of the mse observer."
    needs = Needs(learnt=("observers", "bounds"))
    proposed = 1
    loss: str | None = None

    def bounded_by(self, learnt: Learnt) -> tuple[Observer, Bounds]:
        """The observer and the bounds that it uses."""
        return learnt.bounded(self.loss)

    def fusion(self, robot, learnt, parameters):
        """Bounds on each velocity."""
        observer, bounds = self.bounded_by(learnt)
        return observer, Fusion(partial(bounds.epsilon_at, robot.R_BI), bounds.gamma)


class CoverageGml(Coverage):
    """Coverage with the gml observer, whose bounds follow its predicted uncertainty."""

    name, color, line = "coverage_gml", "#E0AC65", ":"
    description = (
        "Set-coverage IEKF, bounds of the gml observer: multiples of the std that it predicts."
    )
    variant, proposed = True, 0
    loss = "gml"


class CoveragePersistent(ByObserver):
    """Set-coverage updates with the persistent error as states."""

    name = "coverage_persistent"
    color, line = "#7A3DFF", "--"
    description = (
        "Set-coverage IEKF with the observer's persistent error as states, bounds on window means."
    )
    needs = Needs(learnt=("observers", "bounds"))
    parameters = PERSISTENT
    variant, proposed = True, 2

    def fusion(self, robot, learnt, parameters):
        """Bounds on the means of windows."""
        observer, bounds = learnt.bounded()
        part, model = persistent_error(robot, bounds, parameters)
        return observer, Fusion(lambda _: part.epsilon, bounds.gamma, model=model)


class Velocity(ByObserver):
    """Gaussian velocity updates with the covariance that the gml observer predicts."""

    name, color, line = "velocity", "#009E73", "-"
    description = "Gaussian-velocity IEKF, covariance predicted by the gml observer."
    needs = Needs(learnt=("observers",))

    def fusion(self, robot, learnt, parameters):
        """The predicted covariance."""
        inflation = parameters.get("inflation", 1.0)
        return learnt.gaussian(), Fusion(cov=lambda predicted: inflation * predicted)


class VelocityInflated(Velocity):
    """Velocity with the covariance multiplied by a factor."""

    name = "velocity_inflated"
    color, line = "#455815", ":"
    variant = True
    description = (
        "velocity with its covariance times a factor chosen on training and calibration courses."
    )
    parameters = (
        *VELOCITY,
        Parameter("inflation", 150.0, "1", "factor of the covariance that the observer predicts"),
    )


class VelocityPersistent(ByObserver):
    """Gaussian velocity updates with the persistent error as states."""

    name = "velocity_persistent"
    color, line = "#28C3DA", "--"
    description = (
        "Gaussian-velocity IEKF with the persistent error as states, covariance of the rest."
    )
    needs = Needs(learnt=("observers", "persistent"))
    parameters = PERSISTENT
    variant = True

    def fusion(self, robot, learnt, parameters):
        """The covariance of the mixing error."""
        observer, bounds = learnt.bounded()
        part, model = persistent_error(robot, bounds, parameters)
        return observer, Fusion(cov=lambda _: part.within, model=model)


class Leg:
    """Contact-aided leg filter, with contact points as states."""

    name, color, line = "leg", "#2F86D1", "-"
    description = "Contact-aided leg IEKF (Hartley)."
    needs = Needs(log=("imu", "contact"), robot=False, feet=True)
    parameters = LEG
    of_legs, rejecting = True, "leg_slip"

    def start(
        self, robot: Robot | None, learnt: Learnt, parameters: Parameters, beginning: Beginning
    ) -> LegStream:
        """A stream; see `surefoot.scenarios.estimate.contract.Estimator`."""
        return LegStream(robot, beginning, parameters)


class LegSlip(Leg):
    """Leg filter with a gate for contacts that slip."""

    name, color, line = "leg_slip", "#3663EC", "--"
    description = "Leg IEKF that restarts a contact whose innovation fails a chi-square gate."
    parameters = LEG_SLIP
    variant, rejecting = True, ""


class RadarLeg(Leg):
    """`leg_slip` with ego velocities from a radar.

    GaRLILEO (arXiv 2511.13216) couples velocity and gravity by additional factors; in a
    right-invariant filter, the velocities alone make roll and pitch observable.
    """

    name, color, line = "radar_leg", "#C4BA15", "-"
    description = (
        "Perceptive: a simulated radar's ego velocity with leg_slip; sees gravity through the IEKF."
    )
    parameters = (
        *LEG_SLIP,
        Parameter("radar", 16.0, "1", "factor of the covariance of a radar frame"),
    )
    needs = Needs(log=("imu", "contact"), feet=True)
    variant, perceptive, rejecting = True, True, ""

    def prepare(self, log: Log, robot: Robot) -> Log:
        """Add the velocities of a simulated radar to a log without any."""
        return with_radar(log, robot)


class Imu:
    """Integration of the IMU alone: the baseline of all other estimators."""

    name, color, line = "imu", "#7F3485", "-"
    description = "Integration of the IMU alone."
    needs = Needs(robot=False)
    parameters = _imu_parameters(0.01)
    floor = True
    drawn = False  # it leaves every picture within seconds and would hide the others

    def start(
        self, robot: Robot | None, learnt: Learnt, parameters: Parameters, beginning: Beginning
    ) -> ImuStream:
        """A stream; see `surefoot.scenarios.estimate.contract.Estimator`."""
        return ImuStream(beginning, imu_noise(parameters))


def imu_noise(parameters: Parameters) -> FilterNoise:
    """Noise of the IMU with these parameters."""
    names = ("gyro", "accel", "gyro_walk", "accel_walk")
    return FilterNoise(*(parameters[name] for name in names))


def persistent_error(
    robot: Robot, bounds: Bounds, parameters: Parameters
) -> tuple[BiasModel, PersistentError]:
    """The persistent part of bounds, and the filter's model of it, with its prior deviations times
    the parameter `persistent`.
    """
    part, factor = bounds.persistent_at(robot.R_BI), parameters["persistent"] ** 2
    prior, course = factor * part.covariance, factor * part.course
    model = PersistentError(prior, part.time_constant, part.window, part.max_error, course)
    return part, model


class FilterStream:
    """The estimate of a filter."""

    filter: Any

    @property
    def state(self) -> NavState:
        """The estimate."""
        return self.filter.state

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (15, 15) of its error."""
        return self.filter.covariance


class ImuStream(FilterStream):
    """The invariant filter without measurements."""

    def __init__(self, beginning: Beginning, noise: FilterNoise, model=None):
        self.filter = InvariantFilter(beginning.state, beginning.covariance, noise, model)

    def step(self, sample: Sample) -> Update | None:
        """Predict."""
        sample = check_sample(sample, self.filter.t)
        if not np.isnan(self.filter.t):
            self.filter.predict(sample.gyro, sample.accel, sample.t - self.filter.t)
        self.filter.t = sample.t
        return None

    def run(self, log: Log, rows: np.ndarray, more: bool = False) -> Trajectory:
        """Predict over the rows of a log; returns the estimates at `rows` of them."""
        return self.filter.run(imu_samples(log.t, log.gyro, log.accel, self.filter.t), rows=rows)


class Fusion(NamedTuple):
    """How an observer's velocity is used, by functions of its predicted covariances (M, 3, 3): with
    bounds (3,) or (M, 3) [m/s] of the joint level gamma, or with covariances (3, 3) or (M, 3, 3).
    `model` is that of its persistent error, where that is estimated.
    """

    epsilon: Callable[[Any], np.ndarray] | None = None
    gamma: float = 0.0
    cov: Callable[[Any], np.ndarray] = np.asarray
    model: PersistentError | None = None

    def velocities(self, rows, v_I, predicted, n: int) -> Velocities:
        """The updates at these rows of n."""
        if self.epsilon is not None:
            return bounded_velocities(rows, v_I, self.epsilon(predicted), n)
        return gaussian_velocities(rows, v_I, self.cov(predicted), n)


class ObserverFusion(ImuStream):
    """The invariant filter with the velocities of an observer."""

    def __init__(
        self,
        observer: Observer,
        robot: Robot,
        beginning: Beginning,
        fusion: Fusion,
        noise: FilterNoise,
    ):
        """Begin at the first sample.

        Args:
            observer: whose velocities are used.
            robot: of the samples.
            beginning: state, covariance, rate and joints.
            fusion: how the velocities are used.
            noise: of the IMU.
        """
        super().__init__(beginning, noise, fusion.model)
        self._observer, self._robot = observer, robot
        self._beginning, self._fusion = beginning, fusion
        self.unlike = np.nan
        """Distance of the walk so far from the observer's training walks, 1 being the farthest."""

    @cached_property
    def _stream(self) -> ObserverStream:
        """The observer, for a log that does not come at once."""
        at = self._beginning
        return ObserverStream(self._observer, self._robot, at.rate, at.joints, at.derived)

    def step(self, sample: Sample) -> Update | None:
        """Predict, and update when the observer has a velocity."""
        sample = check_sample(sample, self.filter.t)
        each = ((name, getattr(sample, name)) for name in SIGNALS)
        readings = {name: x[None] for name, x in each if x is not None}
        seen = self._stream.advance(np.array([sample.t]), readings)
        super().step(sample)
        if not len(seen.rows):
            return None
        self.unlike = float(seen.unlike[-1])
        v_I, predicted, fusion = seen.v_I[0], seen.covariance, self._fusion
        if fusion.epsilon is not None:
            epsilon = fusion.epsilon(predicted).reshape(3)
            pi = self.filter.update_coverage(v_I, epsilon, fusion.gamma)
            active = bool(pi < fusion.gamma)
            return Update(v_I, epsilon, pi, active) if np.isfinite(pi) else None
        distance = self.filter.update_velocity(v_I, fusion.cov(predicted).reshape(3, 3))
        return Update(v_I, active=bool(np.isfinite(distance)))

    def run(self, log: Log, rows: np.ndarray, more: bool = False) -> Trajectory:
        """Predict and update over the rows of a log; returns the estimates at `rows` of them.

        A whole log at once is predicted as one batch, as in `surefoot.models.observer.predict`.
        """
        if np.isnan(self.filter.t) and not more:
            seen = predict(self._observer, log, self._robot)
        else:
            readings = {name: getattr(log, name) for name in SIGNALS if log.has(name)}
            seen = self._stream.advance(log.t, readings)
        imu = imu_samples(log.t, log.gyro, log.accel, self.filter.t)
        velocities = self._fusion.velocities(seen.rows, seen.v_I, seen.covariance, len(imu.t))
        settings = CoverageSettings(self._fusion.gamma)
        estimate = self.filter.run(imu, velocities, rows, settings)
        return replace(estimate, unlike=self._unlike(seen, rows[: len(estimate.t)]))

    def _unlike(self, seen: Prediction, rows: np.ndarray) -> np.ndarray:
        """Distances (L,) from the observer's training walks, at `rows`."""
        known = np.append(self.unlike, seen.unlike)
        self.unlike = float(known[-1])
        return known[np.searchsorted(seen.rows, rows, side="right")]


class LegStream(FilterStream):
    """The leg filter with the kinematics of a robot's legs, and a radar's velocities if any.

    If the samples contain foot positions instead of joints, no robot is needed; the feet are then
    points, since their rotation while rolling is unknown.
    """

    def __init__(self, robot: Robot | None, beginning: Beginning, parameters: Parameters):
        noise = LegNoise(imu_noise(parameters), parameters["contact"])
        if beginning.feet:
            robot = None
        elif robot is None:
            raise SurefootError(NO_ROBOT)
        radius = np.zeros(len(beginning.feet)) if robot is None else robot.foot_radius
        self._robot, self._inflation = robot, parameters.get("radar")
        self._kinematics = parameters["encoder"], parameters["kinematics"]
        self._rates = CausalDerivative()
        start, gate = (beginning.state, beginning.covariance), parameters.get("slip_gate")
        self.filter = LegFilter(*start, noise, radius, len(radius), gate)

    def _feet(self, t, place, dq):
        """Foot centres (N, K, 3) [m], their covariances and the feet's rates at successive rows.

        Without a robot the rates are None and, since the lever arms of the joints are unknown, an
        error of the angles is assumed to act through the arm from the IMU to the foot.

        Args:
            t: (N,) [s].
            place: joint angles (N, J) [rad] or, without a robot, the foot centres.
            dq: (N, J) [rad/s], or None to derive it.
        """
        robot = self._robot
        if robot is None:
            arm = np.linalg.norm(place, axis=-1)[..., None, None] * np.eye(3)
            return place, encoder_covariance(arm, *self._kinematics), None
        dq = self._rates(t, place) if dq is None else dq
        cov = encoder_covariance(robot.feet_jacobian_I(place), *self._kinematics)
        return robot.feet_I(place), cov, robot.feet.rates_I(place, dq)

    def step(self, sample: Sample) -> Update | None:
        """Predict, and update with the contacts."""
        sample = check_sample(sample, self.filter.t)
        radar = self._radar(sample)
        place, contact = measured(sample, "foot_I" if self._robot is None else "q", "contact")
        dq = None if sample.dq is None else sample.dq[None]
        feet_I, cov, rates = self._feet(np.array([sample.t]), place[None], dq)
        if not np.isnan(self.filter.t):
            now = None if rates is None else rates[0]
            self.filter.predict(sample.gyro, sample.accel, sample.t - self.filter.t, now)
        self.filter.t = sample.t
        self.filter.update_contacts(feet_I[0], contact, cov[0])
        if radar is not None:
            self.filter.update_velocity(*radar)
        return None

    def _radar(self, sample: Sample) -> tuple[np.ndarray, np.ndarray] | None:
        """Velocity (3,) [m/s] of a radar and its covariance (3, 3); None where it has none."""
        if self._inflation is None or sample.extra is None:
            return None
        rows, v_I, cov = radar_of({name: np.array([x]) for name, x in sample.extra.items()})
        if not len(rows):
            return None
        return check_velocity(v_I[0]), spd("x_radar_cov", self._inflation * cov[0], 3)

    def run(self, log: Log, rows: np.ndarray, more: bool = False) -> Trajectory:
        """Predict and update over the rows of a log; returns the estimates at `rows` of them."""
        imu = imu_samples(log.t, log.gyro, log.accel, self.filter.t)
        place = log.foot_I if self._robot is None else log.q
        dq = log.dq if log.has("dq") else None
        feet_I, cov, rates = self._feet(imu.t, place, dq)
        velocities = NO_VELOCITIES
        if self._inflation is not None:
            at, v_I, v_cov = radar_of(log.frame)
            velocities = gaussian_velocities(at, v_I, self._inflation * v_cov, len(imu.t))
        legs = self.filter.legs(feet_I, log.contact, cov, rates)
        return self.filter.run(imu, legs, velocities, rows)
