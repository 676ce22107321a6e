"""What an estimator is: the contract that makes one appear in every command, table and figure.

A class with `name`, `label`, `description`, `needs`, `parameters` and `start(...) -> Stream`,
listed under the entry points `surefoot.estimators` of any installed package, is run, tabled and
drawn like the bundled ones:

    [project.entry-points."surefoot.estimators"]
    gravity_only = "my_package:GravityOnly"

Optional, looked up where present: what `surefoot.scenarios.estimate.estimators.Traits` lists,
such as its colour and whether it is drawn; `bounded_by(learnt) -> (Observer, Bounds)`, whose
empirical coverage the tables then show; and `prepare(log, robot) -> Log`, what it computes of a
whole log before the first sample.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

import numpy as np

from surefoot.estimator.core.checks import (
    MOST_ACCEL,
    MOST_ANGLE,
    MOST_GYRO,
    MOST_RATE,
    MOST_REACH,
    MOST_STEP,
    MOST_TORQUE,
    SampleError,
    all_within,
)
from surefoot.estimator.core.state import NavState
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log
from surefoot.sim.log.schema import group_columns
from surefoot.sim.robot.robot import NO_ROBOT, Robot

if TYPE_CHECKING:  # what legs and IMU need comes without a network's library, which is slow to load
    from surefoot.models.calibration.bounds import Bounds
    from surefoot.models.observer.observer import Observer


@dataclass(frozen=True)
class Parameter:
    """One number that tunes an estimator, > 0: its default, unit and meaning; `declared` for one
    that describes a sensor and that `surefoot tune` leaves alone."""

    name: str
    default: float
    unit: str
    meaning: str
    declared: bool = False


@dataclass(frozen=True)
class Needs:
    """What an estimator reads: groups of a log's columns (`Log.require`), and of what was learnt
    "observers", "bounds", or of these "persistent", the persistent part alone, which is the same
    at every gamma. `robot`: the declared model. `feet`: where the feet are, which joint angles and
    the declared model say, or else a log's own columns.
    """

    log: tuple[str, ...] = ("imu",)
    learnt: tuple[str, ...] = ()
    robot: bool = True
    feet: bool = False

    def check(self, log: Log, robot: Robot | None) -> None:
        """Raise SurefootError where the log lacks a column, or where no robot is known."""
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
class Beginning:
    """Where a stream begins: the state and its covariance (15, 15) at the first sample.

    rate [Hz] of the samples; joints, their names in the order of q; derived, which of the log's
    columns were derived and how (`Meta.derived`), empty on a robot; feet, the legs in the order of
    foot_I, empty where the samples have none and q says where they are.
    """

    state: NavState
    covariance: np.ndarray
    rate: float
    joints: tuple[str, ...] = ()
    derived: tuple[str, ...] = ()
    feet: tuple[str, ...] = ()


class Sample(NamedTuple):
    """One row of a log, or what a robot's sensors say now; None where that is not measured.

    t [s]; gyro (3,) [rad/s] and accel (3,) [m/s^2] in I, means since the last sample; q, dq, tau
    (J,) [rad, rad/s, N m] of the joints and contact (K,) bool of the feet, now; extra: the columns
    `x_<name>` of a log by their names; foot_I (K, 3) [m]: where the feet are now, in I.
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


class Update(NamedTuple):
    """A velocity that a sample brought and that the stream used, for the record of updates.

    v_I (3,) [m/s] in I; of a coverage update its bounds epsilon (3,) [m/s] and pi, the prior mass
    inside them; active, whether the state changed.
    """

    v_I: np.ndarray
    epsilon: np.ndarray | None = None
    pi: float | None = None
    active: bool = True


@runtime_checkable
class Stream(Protocol):
    """An estimator at work: one call a sample, in a robot's own loop or along a log.

    A stream may also have `run(log, rows, more) -> Trajectory`, which takes the rows of a log that
    follow those seen so far at once and returns the estimates at `rows` of them; `more` says that
    others follow. It must give the numbers of `step`.
    """

    def step(self, sample: Sample) -> Update | None:
        """Take one sample; the first one is where the state stands and predicts nothing."""
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
    """One way to estimate a robot's motion; see the module for what else it may have.

    name: in commands, tables and files. label: in figures. description: one sentence, which tables
    print. needs: of a log and of what was learnt. parameters: with the defaults that hold where
    `tuned.toml` says nothing else.
    """

    name: str
    label: str
    description: str
    needs: Needs
    parameters: tuple[Parameter, ...]

    def start(
        self, robot: Robot, learnt: Learnt, parameters: Mapping[str, float], beginning: Beginning
    ) -> Stream:
        """A stream that begins here. Raises SurefootError saying what it lacks.

        Args:
            robot: the declared model; None may come where `needs` say that none is needed.
            learnt: observers and bounds.
            parameters: value of each parameter by name.
            beginning: state, covariance and rate of the samples.
        """
        ...


def measured(sample: Sample, *groups: str) -> list[np.ndarray]:
    """Those groups of a sample. Raises SurefootError naming what it lacks."""
    lacking = [group for group in groups if getattr(sample, group) is None]
    if lacking:
        raise SurefootError(f"the sample at {sample.t:g} s lacks {', '.join(lacking)}")
    return [getattr(sample, group) for group in groups]


def check_sample(sample: Sample, before: float) -> None:
    """Raise SampleError, naming what is at fault, for a sample that no robot gives, or that does
    not follow the stamp `before` [s], NaN at the first. A stream that checks it before it takes
    anything in is as it was, and goes on with the next.
    """
    if not np.isfinite(sample.t):
        raise SampleError(f"the sample's t is {sample.t}")
    if not np.isnan(before) and not before < sample.t <= before + MOST_STEP:
        raise SampleError(
            f"the sample at {sample.t:.9g} s does not follow the one at {before:.9g} s, or after "
            f"more than {MOST_STEP:g} s"
        )
    for name, most in LARGEST_READINGS.items():
        value = getattr(sample, name)
        if value is not None and not all_within(np.asarray(value, float).ravel(), most):
            raise SampleError(
                f"the sample at {sample.t:.9g} s: {name} is not finite, or beyond {most:g}"
            )


LARGEST_READINGS = {
    "gyro": MOST_GYRO,
    "accel": MOST_ACCEL,
    "q": MOST_ANGLE,
    "dq": MOST_RATE,
    "tau": MOST_TORQUE,
    "contact": 1.0,
    "foot_I": MOST_REACH,
}
"""Field of a sample -> its largest size."""


def samples(log: Log) -> Iterator[Sample]:
    """The rows of a log one by one, with what it has of each group."""
    t, gyro, accel = log.t, log.gyro, log.accel
    groups = {"q": "q", "dq": "dq", "tau": "tau", "contact": "contact", "foot": "foot_I"}
    others = [getattr(log, name) if log.has(group) else None for group, name in groups.items()]
    names = [name for name in log.frame.columns if str(name).startswith("x_")]
    extra = log.frame.loc[:, names].to_dict(orient="records") if names else None
    for k in range(len(log.frame)):
        q, dq, tau, contact, foot_I = (None if values is None else values[k] for values in others)
        more = {str(name): x for name, x in extra[k].items()} if extra else None
        yield Sample(t[k], gyro[k], accel[k], q, dq, tau, contact, more, foot_I)
