"""The filters by name: what each needs of a log and of what was learnt, and how it is run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

from surefoot.estimator.evaluation.mounting_tolerance import with_mounting
from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.estimator.filter import run_coverage, run_imu, run_velocity
from surefoot.estimator.initial import initial_state
from surefoot.estimator.leg import encoder_covariance, run_leg
from surefoot.estimator.metrics import Metrics, evaluate
from surefoot.estimator.updates.bias_states import PersistentError
from surefoot.scenarios.estimate.radar_velocity import radar_velocity
from surefoot.scenarios.estimate.tuned import Parameters, imu_noise, leg_noise, tuned
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import compensate_all, effect
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.robot import Robot

if TYPE_CHECKING:  # what legs and IMU need comes without a network's library, which is slow to load
    from surefoot.models.calibration.bias_model import BiasModel
    from surefoot.models.calibration.bounds import Bounds
    from surefoot.models.observer.observer import Observer
    from surefoot.models.observer.predict import Prediction

ENCODER = 2e-3
"""rad, of a joint angle: encoder step, calibration and what a loaded drive gives."""
KINEMATICS = 2e-3
"""m, of a foot's place: links, mounts and the foot's shape."""


@dataclass(frozen=True)
class Learnt:
    """What was learnt: observers, and bounds that each name the observer they belong to."""

    observers: tuple[Observer, ...] = ()
    bounds: tuple[Bounds, ...] = ()

    def gaussian(self) -> Observer:
        """The observer that predicts a covariance. Raises SurefootError naming the option."""
        found = [o for o in self.observers if o.loss == "gml"]
        if len(found) == 1:
            return found[0]
        if found:
            raise SurefootError("--observer: two observers were trained with gml; give one")
        if self.observers:
            raise SurefootError(
                "--observer: this one was trained with mse; train one with --loss gml"
            )
        raise SurefootError("needs --observer, one trained with --loss gml")

    def bounded(self, loss: str | None = None) -> tuple[Observer, Bounds]:
        """The observer and its bounds; of two, the `mse` one unless `loss` says otherwise."""
        if not self.observers:
            raise SurefootError("needs --observer and --bounds")
        if not self.bounds:
            raise SurefootError("needs --bounds: calibrate the observer")
        pairs = [(o, b) for o in self.observers for b in self.bounds if b.observer == o.hash]
        if not pairs:
            raise SurefootError("--bounds belong to another observer; calibrate this one")
        wanted = [pair for pair in pairs if loss is None or pair[0].loss == loss]
        if not wanted:
            raise SurefootError(f"needs --bounds of an observer trained with --loss {loss}")
        return min(wanted, key=lambda pair: pair[0].loss != "mse")


@dataclass(frozen=True)
class Result:
    """One filter on one log."""

    filter: str
    log: str
    trajectory: Trajectory
    metrics: Metrics | None  # None where the log has no reference
    step_time: float  # s a sample, the compiled loop alone


def run_filter(name: str, log: Log, robot: Robot, learnt: Learnt | None = None) -> Result:
    """Estimate a log with one filter. Raises SurefootError saying what it lacks.

    The filter's model is the declared one: what the log says of its effects is undone first.
    """
    if name not in FILTERS:
        raise SurefootError(f"--filter {name}: unknown; choose {' | '.join(FILTERS)}")
    log.require("imu")
    log, robot = declared_model(log, robot)
    try:
        run = FILTERS[name](log, robot, learnt or Learnt())
    except SurefootError as error:
        raise SurefootError(f"filter {name}: {error}") from None
    parameters = tuned(robot)
    values = parameters.filters[name]
    if name not in _compiled:
        run(values)  # compiles on a fresh machine: not the filter's own time
        _compiled.add(name)
    started = perf_counter()
    trajectory = run(values)
    elapsed = perf_counter() - started
    trajectory = with_mounting(trajectory, parameters.mounting)
    judged = evaluate(reference(log), trajectory) if log.has("reference") else None
    return Result(name, log.name, trajectory, judged, elapsed / len(log.t))


def declared_model(log: Log, robot: Robot) -> tuple[Log, Robot]:
    """The log and robot with what the log says of its own effects undone and known."""
    declared = [effect(e["name"], e["target"], e["value"]) for e in log.meta.effects]
    return compensate_all(declared, log, robot)


_compiled: set[str] = set()


def run_all(
    log: Log,
    robot: Robot,
    learnt: Learnt,
    names: Sequence[str] | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[list[Result], dict[str, str]]:
    """Every filter that the log and what was learnt allow, and why each other was left out."""
    results: list[Result] = []
    left_out: dict[str, str] = {}
    for name in names or FILTERS:
        if progress:
            progress(name)
        try:
            results.append(run_filter(name, log, robot, learnt))
        except SurefootError as error:
            left_out[name] = str(error).removeprefix(f"filter {name}: ")
    return results, left_out


Run = Callable[[Parameters], Trajectory]
"""A filter on one log, all that does not depend on its parameters done."""


def _predict(observer: Observer, log: Log, robot: Robot) -> Prediction:
    from surefoot.models.observer.predict import predict

    return predict(observer, log, robot)


def _coverage(log: Log, robot: Robot, learnt: Learnt, loss: str | None = None) -> Run:
    """Set-coverage IEKF, bounds of the mse observer."""
    observer, bounds = learnt.bounded(loss)
    seen = _predict(observer, log, robot)
    epsilon = bounds.epsilon_at(robot.R_BI)
    state, covariance = initial_state(log)
    return lambda values: run_coverage(
        log.t, log.gyro, log.accel, seen.rows, seen.v_I, epsilon, bounds.gamma, state, covariance,
        imu_noise(values),
    )  # fmt: skip


def _coverage_gml(log: Log, robot: Robot, learnt: Learnt) -> Run:
    """Set-coverage IEKF on the gml observer's mean: compares update, not network."""
    return _coverage(log, robot, learnt, "gml")


def _coverage_persistent(log: Log, robot: Robot, learnt: Learnt) -> Run:
    """Set-coverage IEKF with the observer's persistent error as states, bounds on window means."""
    observer, bounds = learnt.bounded()
    part = bounds.persistent_at(robot.R_BI)
    seen = _predict(observer, log, robot)
    state, covariance = initial_state(log)
    return lambda values: run_coverage(
        log.t, log.gyro, log.accel, seen.rows, seen.v_I, part.epsilon, bounds.gamma, state,
        covariance, imu_noise(values), persistent=persistent_error(part, values["lasting"]),
    )  # fmt: skip


def _velocity(log: Log, robot: Robot, learnt: Learnt) -> Run:
    """Gaussian-velocity IEKF, covariance predicted by the gml observer."""
    seen = _predict(learnt.gaussian(), log, robot)
    assert seen.covariance is not None
    cov = seen.covariance
    state, covariance = initial_state(log)
    return lambda values: run_velocity(
        log.t, log.gyro, log.accel, seen.rows, seen.v_I, values.get("inflation", 1.0) * cov, state,
        covariance, imu_noise(values),
    )  # fmt: skip


def _velocity_inflated(log: Log, robot: Robot, learnt: Learnt) -> Run:
    """The same, its covariance times a factor chosen on training and calibration courses."""
    return _velocity(log, robot, learnt)


def _velocity_persistent(log: Log, robot: Robot, learnt: Learnt) -> Run:
    """Gaussian-velocity IEKF with the persistent error as states, covariance of the rest."""
    observer, bounds = learnt.bounded()
    part = bounds.persistent_at(robot.R_BI)
    seen = _predict(observer, log, robot)
    state, covariance = initial_state(log)
    return lambda values: run_velocity(
        log.t, log.gyro, log.accel, seen.rows, seen.v_I, part.within, state, covariance,
        imu_noise(values), persistent=persistent_error(part, values["lasting"]),
    )  # fmt: skip


def persistent_error(part: BiasModel, lasting: float) -> PersistentError:
    """What the filter needs of what the calibration found, its deviations times `lasting`."""
    square = lasting**2
    return PersistentError(
        square * part.covariance, part.time_constant, part.window, part.reach, square * part.course
    )


def _leg(log: Log, robot: Robot, _: Learnt, seen: tuple | None = None) -> Run:
    """Contact-aided leg IEKF (Hartley)."""
    log.require("q", "contact")
    dq = log.dq if log.has("dq") else joint_velocity(log, causal=True)
    feet_I = robot.feet_I(log.q)
    rates_I = robot.foot_rates_I(log.q, dq)
    cov = encoder_covariance(robot.feet_jacobian_I(log.q), ENCODER, KINEMATICS)
    state, covariance = initial_state(log)

    def run(values: Parameters) -> Trajectory:
        velocities = (None, None, None) if seen is None else (*seen[:2], values["radar"] * seen[2])
        return run_leg(
            log.t, log.gyro, log.accel, feet_I, log.contact, cov, state, covariance,
            leg_noise(values), robot.foot_radius, rates_I, values.get("slip_gate"), None,
            *velocities,
        )  # fmt: skip

    return run


def _leg_slip(log: Log, robot: Robot, learnt: Learnt) -> Run:
    """Leg IEKF that restarts a contact whose innovation fails a chi-square gate."""
    return _leg(log, robot, learnt)


def _radar_leg(log: Log, robot: Robot, learnt: Learnt) -> Run:
    """Perceptive: a simulated radar's ego velocity with leg_slip; sees gravity through the IEKF."""
    # GaRLILEO (arXiv 2511.13216) ties velocity to gravity by factors of their own; in a
    # right-invariant filter the same velocities make roll and pitch observable already.
    return _leg(log, robot, learnt, radar_velocity(log, robot))


def _imu(log: Log, robot: Robot, _: Learnt) -> Run:
    """IMU alone: the floor."""
    state, covariance = initial_state(log)
    return lambda values: run_imu(log.t, log.gyro, log.accel, state, covariance, imu_noise(values))


# A filter's docstring is what the tables say of it.
FILTERS: dict[str, Callable[[Log, Robot, Learnt], Run]] = {
    "coverage": _coverage,
    "coverage_gml": _coverage_gml,
    "coverage_persistent": _coverage_persistent,
    "velocity": _velocity,
    "velocity_inflated": _velocity_inflated,
    "velocity_persistent": _velocity_persistent,
    "leg": _leg,
    "leg_slip": _leg_slip,
    "radar_leg": _radar_leg,
    "imu": _imu,
}

NEEDS: dict[str, tuple[str, ...]] = {
    "velocity": ("observers",),
    "velocity_inflated": ("observers",),
    "velocity_persistent": ("observers", "persistent"),
    "leg": (),
    "leg_slip": (),
    "radar_leg": (),
    "imu": (),
}
"""What a filter reads besides the log: observers, bounds, or of these the persistent part alone.

Observers and bounds where it is not said. Who does not read bounds is the same at every gamma.
"""
