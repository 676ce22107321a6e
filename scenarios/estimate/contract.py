"""Interface of an estimator, by which it appears in every command, table and figure.

A class with `name`, `description`, `needs`, `parameters` and `start(...) -> Stream`,
registered by the entry point group `surefoot.estimators` of any installed package, is run,
tabulated and plotted like the bundled ones:

    [project.entry-points."surefoot.estimators"]
    gravity_only = "my_package:GravityOnly"

Optional members: those of `surefoot.scenarios.estimate.estimators.Traits`, such as its colour and
whether it is drawn; `bounded_by(learnt) -> (Observer, Bounds)`, whose empirical coverage the tables
then show; and `prepare(log, robot) -> Log`, which computes something from a whole log before the
first sample.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from numbers import Real
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from surefoot.estimator.core import checks
from surefoot.estimator.core.state import NavState
from surefoot.models.calibration.bounds import Bounds
from surefoot.models.observer.observer import Observer
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log
from surefoot.sim.log.schema import group_columns
from surefoot.sim.robot.robot import NO_ROBOT, Robot

Parameters = Mapping[str, float]
"""Value of each parameter of an estimator, by name."""


@dataclass(frozen=True)
class Parameter:
    """One positive parameter of an estimator: default, unit and meaning.

    `declared` marks one that describes a sensor, which `surefoot tune` does not change.
    """

    name: str
    default: float
    unit: str
    meaning: str
    declared: bool = False


@dataclass(frozen=True)
class Needs:
    """Requirements of an estimator.

    Attributes:
        log: groups of a log's columns (`Log.require`).
        learnt: "observers", "bounds", or "persistent" for only the persistent part of bounds, which
            is the same at every gamma.
        robot: whether it needs the declared model.
        feet: whether it needs foot positions, from joint angles and the declared model or from a
            log's own columns.
    """

    log: tuple[str, ...] = ("imu",)
    learnt: tuple[str, ...] = ()
    robot: bool = True
    feet: bool = False

    def check(self, log: Log, robot: Robot | None) -> None:
        """Raise SurefootError where the log lacks a column, or a needed robot is unknown."""
        if "dq" in self.log and log.has("q") and not log.has("dq"):
            remedy = "surefoot.extend.with_velocities(log, causal=True) derives them from q"
            raise SurefootError(f"{log.name}: the log lacks dq (dq_<joint>): {remedy}")
        log.require(*self.log)
        by_joints = self.feet and not log.has("foot")
        if by_joints and not log.has("q"):
            columns = group_columns("foot", (), log.legs)
            raise SurefootError(
                f"{log.name}: the log lacks foot ({columns[0]}, ...) and q (q_<joint>): one of "
                "them says where the feet are"
            )
        if robot is None and (self.robot or by_joints):
            raise SurefootError(f"{log.name}: {NO_ROBOT}")


@dataclass(frozen=True)
class Learnt:
    """Observers, and bounds that each refer to their observer."""

    observers: tuple[Observer, ...] = ()
    bounds: tuple[Bounds, ...] = ()

    def gaussian(self) -> Observer:
        """The observer that predicts a covariance. Raises SurefootError naming the option."""
        found = [one for one in self.observers if one.loss == "gml"]
        self._require_one(found, "trained with loss gml, which predicts a covariance")
        return found[0]

    def bounded(self, loss: str | None = None) -> tuple[Observer, Bounds]:
        """The observer and its bounds; of two, the `mse` one unless `loss` selects another."""
        if not (self.observers and self.bounds):
            raise SurefootError("needs observer and bounds")
        wanted = [one for one in self.observers if loss in (None, one.loss)]
        pairs = [(o, b) for o in wanted for b in self.bounds if b.observer == o.hash]
        if wanted and not pairs:
            raise SurefootError(
                "needs bounds of its observer: those given belong to another observer; calibrate "
                "this one"
            )
        pairs = [pair for pair in pairs if pair[0].loss == "mse"] or pairs
        loss = loss or pairs[0][0].loss
        self._require_one(pairs, f"trained with loss {loss}, with one file of bounds")
        return pairs[0]

    def _require_one(self, found: Sequence[object], what: str) -> None:
        """Raise SurefootError unless one of the observers is what is needed."""
        if len(found) != 1:
            given = ", ".join(one.loss for one in self.observers) or "none"
            raise SurefootError(f"needs observer: one {what}; given: {given}")


@dataclass(frozen=True)
class Beginning:
    """Start of a stream: the state and its covariance (15, 15) at the first sample.

    Attributes:
        state: the state.
        covariance: of its right-invariant error.
        rate: of the samples [Hz].
        joints: names in the order of q.
        derived: columns of the log that were derived, and how (`Meta.derived`); empty on a robot.
        feet: legs in the order of foot_I; empty where the feet follow from q.
    """

    state: NavState
    covariance: np.ndarray
    rate: float
    joints: tuple[str, ...] = ()
    derived: tuple[str, ...] = ()
    feet: tuple[str, ...] = ()


class Sample(NamedTuple):
    """One row of a log, or the current readings of a robot; None where not measured.

    t [s]; gyro (3,) [rad/s] and accel (3,) [m/s^2] in I, means since the last sample; q, dq, tau
    (J,) [rad, rad/s, N m] of the joints and contact (K,) bool of the feet, now; extra: the columns
    `x_<name>` of a log by name; foot_I (K, 3) [m]: positions of the feet now, in I; force (K,) of
    the feet now, in the sensor's own unit.
    """

    t: float
    gyro: np.ndarray
    accel: np.ndarray
    q: np.ndarray | None = None
    dq: np.ndarray | None = None
    tau: np.ndarray | None = None
    contact: np.ndarray | None = None
    extra: Mapping[str, float] | None = None
    foot_I: np.ndarray | None = None
    force: np.ndarray | None = None


class CheckedSample(Sample):
    """A sample that `check_sample` returned, whose readings are not checked again."""

    __slots__ = ()


class Update(NamedTuple):
    """A velocity that the stream used at a sample, for the record of updates.

    v_I (3,) [m/s] in I; for a coverage update its bounds epsilon (3,) [m/s] and pi, the prior mass
    inside them; active, whether the state changed.
    """

    v_I: np.ndarray
    epsilon: np.ndarray | None = None
    pi: float | None = None
    active: bool = True


@runtime_checkable
class Stream(Protocol):
    """A running estimator: one call per sample, in a robot's own loop or along a log.

    A stream may also have `run(log, rows, more) -> Trajectory`, which processes the next rows of a
    log at once and returns the estimates at `rows` of them; `more` tells that others follow. Its
    result must be that of `step`.
    """

    def step(self, sample: Sample) -> Update | None:
        """Process one sample; the first one is at the time of the initial state and predicts
        nothing.
        """
        ...

    @property
    def state(self) -> NavState:
        """The estimate."""
        ...

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (15, 15) of its right-invariant error, in the order of `Trajectory`."""
        ...


class Estimator(Protocol):
    """A method to estimate a robot's motion; see the module for optional members.

    Attributes:
        name: in commands, tables, figures and files.
        description: one sentence, for tables.
        needs: of a log and of what was learnt.
        parameters: with their defaults, which `tuned.toml` may override.
    """

    name: str
    description: str
    needs: Needs
    parameters: tuple[Parameter, ...]

    def start(
        self, robot: Robot, learnt: Learnt, parameters: Parameters, beginning: Beginning
    ) -> Stream:
        """Start a stream. Raises SurefootError saying what is missing.

        Args:
            robot: the declared model; may be None if `needs` does not require one.
            learnt: observers and bounds.
            parameters: value of each parameter by name.
            beginning: state, covariance and rate of the samples.
        """
        ...


def measured(sample: Sample, *groups: str) -> list[np.ndarray]:
    """These groups of a sample. Raises SampleError naming what is missing."""
    lacking = [group for group in groups if getattr(sample, group) is None]
    if lacking:
        raise checks.SampleError(f"the sample at {sample.t:g} s lacks {', '.join(lacking)}")
    return [getattr(sample, group) for group in groups]


LARGEST_READINGS = {
    "gyro": checks.MOST_GYRO,
    "accel": checks.MOST_ACCEL,
    "q": checks.MOST_ANGLE,
    "dq": checks.MOST_RATE,
    "tau": checks.MOST_TORQUE,
    "contact": 1.0,
    "foot_I": checks.MOST_REACH,
    "force": checks.MOST_FORCE,
}
"""Field of a sample -> its largest magnitude."""
GROUPS_OF_FIELDS = {name: name for name in ("q", "dq", "tau", "contact", "force")} | {
    "foot": "foot_I"
}
"""Group of a log's columns -> field of a sample, of what may be missing."""
IMU_SHAPES: Mapping[str, tuple[int, ...]] = {"gyro": (3,), "accel": (3,)}
LATEST_STAMP = 1e10
"""Largest magnitude of a stamp [s], after year 2200 of any epoch; float64 resolves it to 2 us."""


def check_sample(
    sample: Sample,
    before: float,
    shapes: Mapping[str, tuple[int, ...]] = IMU_SHAPES,
    needed: Sequence[str] = tuple(IMU_SHAPES),
) -> CheckedSample:
    """Check a sample and return it with arrays of its own, float64, and contact as bool.

    Raises SampleError, naming the fault, for what is no sample, values that no robot gives, or time
    that does not increase. A stream that checks a sample before using it is unchanged by a bad one,
    and continues with the next.

    Args:
        sample: to check.
        before: stamp of the previous one [s]; NaN for the first.
        shapes: of the fields whose shapes are known.
        needed: fields that must not be None.
    """
    if not isinstance(sample, Sample):
        raise checks.SampleError(f"a sample must be a Sample, is a {type(sample).__name__}")
    t = float(_readings("the sample's t", sample.t, (), LATEST_STAMP))
    where = f"the sample at {t:.9g} s"
    if not np.isnan(before) and not before < t <= before + checks.MOST_STEP:
        raise checks.SampleError(
            f"{where} does not follow the one at {before:.9g} s, or after more than "
            f"{checks.MOST_STEP:g} s"
        )
    measured(sample, *needed)
    if isinstance(sample, CheckedSample):
        return sample
    found: dict[str, np.ndarray] = {}
    for name, most in LARGEST_READINGS.items():
        if (value := getattr(sample, name)) is not None:
            found[name] = _readings(f"{where}: {name}", value, shapes.get(name), most)
    if (contact := found.get("contact")) is not None:
        found["contact"] = contact == 1.0
        if not (found["contact"] | (contact == 0.0)).all():
            raise checks.SampleError(f"{where}: contact must be 0 or 1")
    extra = {} if sample.extra is None else sample.extra
    if not isinstance(extra, Mapping) or not all(isinstance(x, Real) for x in extra.values()):
        raise checks.SampleError(f"{where}: extra must be numbers by name")
    return CheckedSample._make(sample._replace(t=t, **found))


def _readings(what: str, value: object, shape: tuple[int, ...] | None, most: float) -> np.ndarray:
    """A copy of a field's values as float64, of that shape if it is known."""
    try:
        found = checks.real(what, value)
    except SurefootError as error:
        raise checks.SampleError(f"{error}") from None
    if shape is not None and found.shape != shape:
        raise checks.SampleError(f"{what} has shape {found.shape}, not {shape}")
    if not checks.all_within(found.ravel(), most):
        raise checks.SampleError(f"{what} is not finite, or beyond {most:g}")
    return found


def samples(log: Log) -> Iterator[Sample]:
    """The rows of a log one by one, with the groups that it has."""
    t, gyro, accel = log.t, log.gyro, log.accel
    others = {f: getattr(log, f) for g, f in GROUPS_OF_FIELDS.items() if log.has(g)}
    names = [name for name in log.frame.columns if str(name).startswith("x_")]
    extra = log.frame.loc[:, names].to_dict(orient="records") if names else repeat(None)
    for k, more in zip(range(len(log.frame)), extra, strict=False):
        row = {field: values[k] for field, values in others.items()}
        yield Sample(t[k], gyro[k], accel[k], extra=more, **row)
